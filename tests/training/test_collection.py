"""Collection of flights: labels against what really acted, repulsion, resumption, determinism."""

import dataclasses
import json

import numpy as np
import pytest

from swarm_envs.training.collection import (
    CollectionConfig,
    FlightLog,
    SensorNoise,
    collect,
    interaction_force,
    interaction_rows,
    read_flights,
)
from swarm_envs.training.collection.collect import FlightBatch, flight_generator, make_motion
from swarm_envs.training.collection.flight import fly_motion
from swarm_envs.training.collection.log import (
    LOG_RATE,
    derivative,
    hann_average,
    lagged_thrust,
    with_noise,
)
from swarm_envs.training.collection.motion import MotionRanges, Potential, RandomWalk, repulsion
from swarm_envs.vehicles import LARGE, SMALL, parse_team

SHORT = CollectionConfig(
    teams=("S", "SL"), walks=2, low_walks=1, swaps=1, low_swaps=0, duration_s=3.0
)


def noiseless(team, kind, duration_s, motion=SHORT.motion, count=1):
    config = dataclasses.replace(SHORT, motion=motion, duration_s=duration_s)
    batch = FlightBatch(team, kind, count)
    rngs = [flight_generator(config, name) for name in batch.names]
    return fly_motion(parse_team(team), make_motion(config, batch, rngs), "learned", duration_s)


def test_noisy_labels_are_unbiased_and_smoothing_calms_them():
    (log,) = noiseless("SL", "walk", 8.0)
    team = parse_team("SL")
    noisy = with_noise(log, SensorNoise(), np.random.default_rng(0))
    exact = interaction_force(log, team, 0.0)
    error = {s: (interaction_force(noisy, team, s) - exact)[20:-20] for s in (0.0, 0.1)}
    assert np.abs(error[0.1].mean(axis=0)).max() < 0.15
    rough, calm = (np.sqrt((error[s] ** 2).mean(axis=0)) for s in (0.0, 0.1))
    assert (calm < rough / 5).all()


def test_derivative_and_smoothing_of_polynomials():
    t = np.arange(60, dtype=np.float64) * 0.01
    value = derivative(3.0 * t**4 - t, 0.01)
    assert np.isnan(value[[0, 1, -2, -1]]).all()
    np.testing.assert_allclose(value[2:-2], (12.0 * t**3 - 1.0)[2:-2], atol=1e-9)
    calm = hann_average(t, 13)
    np.testing.assert_allclose(calm[6:-6], t[6:-6])
    assert np.isnan(calm[:6]).all() and np.isnan(calm[-6:]).all()


def test_a_flight_shorter_than_the_window_has_no_known_label():
    for count in range(20):
        log = FlightLog(*(np.ones((count, 1, width)) for width in (3, 3, 4, 3, 3, 4)))
        force = interaction_force(log, (SMALL,))
        assert force.shape == (count, 1, 3)
        assert np.isfinite(force[:, 0, 2]).sum() == max(0, count - 4 - 12)


def test_thrust_follows_a_step_of_the_command_with_the_motors_rate():
    count = 120
    commands = np.full((count, 1, 4), 0.15)
    thrust = lagged_thrust(commands, (LARGE,), 1 / LOG_RATE)[:, 0]
    hover = 4 * LARGE.hover_rotor_thrust
    time = np.arange(count) / LOG_RATE
    np.testing.assert_allclose(thrust, 0.6 + (hover - 0.6) * np.exp(-16.0 * time))


def test_noise_has_the_stated_size_and_attitudes_stay_unit():
    (log,) = noiseless("S", "walk", 6.0)
    noise = SensorNoise(1e-3, 0.02, 5e-3)
    noisy = with_noise(log, noise, np.random.default_rng(1))
    assert np.std(noisy.position - log.position) == pytest.approx(1e-3, rel=0.1)
    assert np.std(noisy.velocity - log.velocity) == pytest.approx(0.02, rel=0.1)
    cosine = np.abs((noisy.quaternion * log.quaternion).sum(axis=-1))
    angle = 2 * np.arccos(np.minimum(cosine, 1.0))
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(np.sqrt(3) * 5e-3, rel=0.1)
    np.testing.assert_allclose(np.linalg.norm(noisy.quaternion, axis=-1), 1.0)
    np.testing.assert_array_equal(noisy.commands, log.commands)


def test_repulsion_is_the_slope_of_its_potential():
    c, step = np.linspace(0.03, 0.14, 20), 1e-6

    def potential(clearance):
        return 0.5 * 3e-3 * (1 / clearance - 1 / 0.15) ** 2

    slope = (potential(c - step) - potential(c + step)) / (2 * step)
    free = Potential(0.15, 3e-3, np.inf)
    np.testing.assert_allclose([repulsion(x, free) for x in c], slope, rtol=1e-5)
    limited = free._replace(limit=8.0)
    assert [repulsion(x, limited) for x in (0.15, 1.0)] == [0.0, 0.0]
    assert [repulsion(x, limited) for x in (-0.1, 0.0)] == [8.0, 8.0]


def test_repulsion_keeps_random_walks_apart():
    flown = {}
    for strength in (0.0, MotionRanges.strength):
        ranges = MotionRanges(strength=strength)
        logs = noiseless("SSL", "low-walk", 10.0, ranges, count=6)
        flown[strength] = sum(len(log.position) for log in logs) / (6 * 10.0 * LOG_RATE)
    assert flown[0.0] < 0.5  # without it they soon touch
    assert flown[MotionRanges.strength] > 0.8


def test_walks_pass_over_and_under_each_other_near_and_far():
    logs = noiseless("SS", "walk", 15.0, count=6)
    apart = np.concatenate([log.position[:, 1] - log.position[:, 0] for log in logs])
    assert (np.abs(apart[:, :2]) < 0.35).all(axis=1).mean() > 0.5
    above = np.hypot(apart[:, 0], apart[:, 1]) < 0.08
    for sign in (-1, 1):
        heights = sign * apart[above, 2]
        assert (heights > 0.6).any() and ((heights > 0.12) & (heights < 0.25)).any()
    assert (np.abs(apart[:, 2]) < 0.05).any()


def test_low_walks_come_down_to_the_ground():
    (log,) = noiseless("S", "low-walk", 15.0)
    assert SMALL.radius < log.position[:, 0, 2].min() < 0.11


def test_walks_are_the_same_alone_and_in_a_batch():
    ranges, team = MotionRanges(), parse_team("SL")

    def walk(seeds):
        rngs = [np.random.default_rng(seed) for seed in seeds]
        return fly_motion(team, RandomWalk(team, rngs, ranges, False, 2.0, 1 / 240), "learned", 2.0)

    for together, alone in zip(walk([0, 1]), [*walk([0]), *walk([1])], strict=True):
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.fixture(scope="module")
def collection(tmp_path_factory):
    out = tmp_path_factory.mktemp("flights")
    return out, collect(SHORT, out, progress=False)


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_the_same_seed_gives_the_same_files_and_another_does_not(collection, tmp_path):
    out, flights = collection
    collect(SHORT, tmp_path / "again", progress=False)
    assert contents(tmp_path / "again") == contents(out)
    other = collect(dataclasses.replace(SHORT, seed=1), tmp_path / "other", progress=False)
    assert not np.array_equal(other[0].log.position, flights[0].log.position)


def test_a_folder_of_another_configuration_is_refused(collection):
    out, _ = collection
    with pytest.raises(ValueError, match=r": config.(seed is 0|interactions is learned) there, "):
        collect(dataclasses.replace(SHORT, seed=1), out, progress=False)
    with pytest.raises(ValueError, match=r": config.(seed is 0|interactions is learned) there, "):
        collect(dataclasses.replace(SHORT, interactions="wake"), out, progress=False)


def test_manifest_and_files_agree(collection):
    out, flights = collection
    manifest = json.loads((out / "manifest.json").read_text())
    assert {entry["name"] for entry in manifest["flights"]} == {f.stem for f in out.glob("*.npz")}
    for entry, flight in zip(manifest["flights"], read_flights(SHORT, out), strict=True):
        assert entry["seconds"] == pytest.approx(len(flight.log.position) / LOG_RATE, abs=1e-3)
        assert (entry["team"], entry["validation"]) == (flight.team, flight.validation)
    assert sum(flight.validation for flight in flights) == 2  # of two walks, by two teams


def test_rows_say_what_the_logs_say(collection):
    _, flights = collection
    rows = interaction_rows(flights)
    assert set(rows.scenario_names) == {"Ge2S", "S2L", "L2S"}
    index = next(i for i, flight in enumerate(flights) if flight.name == "SL-swap-000")
    large = np.flatnonzero((rows.flight == index) & (rows.ego_type == 1))
    assert len(large) > 5
    log, step = flights[index].log, rows.step[large]
    np.testing.assert_array_equal(rows.position[large], log.position[step, 1])
    offset = log.position[step, 0] - log.position[step, 1]
    np.testing.assert_array_equal(rows.neighbor[large, 0, :3], offset)
    assert (np.abs(offset) <= [0.35, 0.35, 1.1]).all()
    assert (rows.neighbor_type[large] == 0).all()
    force = interaction_force(log, parse_team("SL"))
    np.testing.assert_array_equal(rows.force_g[large], force[step, 1])
    alone = rows.neighbor_type[rows.scenario == rows.scenario_names.index("Ge2S")]
    assert (alone == -1).all()
    with pytest.raises(ValueError, match="no row"):
        interaction_rows([])


def test_a_log_is_cut_before_the_first_contact():
    class Collide:
        start = np.array([[[0.0, 0.0, 1.0], [0.4, 0.0, 1.0]]])

        def target(self, time, position):
            from swarm_envs.training.collection.motion import MotionTarget

            still = np.zeros((1, 2, 3))
            return MotionTarget(self.start * [0.0, 1.0, 1.0], still, still)

    (log,) = fly_motion(parse_team("SS"), Collide(), "none", 4.0)
    assert isinstance(log, FlightLog) and 10 < len(log.position) < 4.0 * LOG_RATE
    distance = np.linalg.norm(log.position[:, 0] - log.position[:, 1], axis=1)
    assert distance.min() >= 2 * SMALL.radius
    assert distance[-1] < 2 * SMALL.radius + 0.03
