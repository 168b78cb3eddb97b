"""Collection of flights: motions, sensors, labels against what really acted, files, the command."""

import dataclasses
import json
import sys

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.hall import Hall
from swarm_envs.interactions import load
from swarm_envs.reference import rotate
from swarm_envs.training.collection import (
    CollectionConfig,
    SensorNoise,
    collect,
    interaction_force,
    interaction_rows,
)
from swarm_envs.training.collection.collect import (
    FlightBatch,
    flight_generator,
    make_motion,
    read_batch,
)
from swarm_envs.training.collection.flight import fly_motion
from swarm_envs.training.collection.log import (
    LOG_RATE,
    FlightLog,
    lagged_thrust,
    thrust_direction,
    with_noise,
)
from swarm_envs.training.collection.motion import (
    MotionRanges,
    MotionTarget,
    Potential,
    RandomWalk,
    repulsion,
)
from swarm_envs.training.collection.table import SCENARIOS, CollectedFlight, scenario_counts
from swarm_envs.training.flight_logs import LogOptions, read_data
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, SMALL, parse_team
from tests.helpers.interrupts import calls_of
from tests.helpers.real_logs import to_table, write_table

SHORT = CollectionConfig(("S", "SL"), walks=2, low_walks=1, swaps=1, low_swaps=0, duration_s=3.0)


def noiseless(
    team, kind, duration_s, ranges=SHORT.motion, count=1, feedforward=None, interactions="learned"
):
    config = dataclasses.replace(SHORT, motion=ranges, duration_s=duration_s)
    batch = FlightBatch(team, kind, count)
    rngs = [flight_generator(config, name) for name in batch.names]
    motion = make_motion(config, batch, rngs)
    return fly_motion(parse_team(team), motion, interactions, duration_s, feedforward)


def test_noisy_labels_are_unbiased_and_smoothing_calms_them():
    (log,) = noiseless("SL", "walk", 8.0)
    team = parse_team("SL")
    noisy = with_noise(log, SensorNoise(), np.random.default_rng(0))
    exact = interaction_force(log, team, 0.0)
    error = {s: (interaction_force(noisy, team, s) - exact)[20:-20] for s in (0.0, 0.1)}
    assert np.abs(error[0.1].mean(axis=0)).max() < 0.15
    rough, calm = (np.sqrt((error[s] ** 2).mean(axis=0)) for s in (0.0, 0.1))
    assert (calm < rough / 5).all()


def test_a_flight_shorter_than_the_window_has_no_known_label():
    for count in range(20):
        log = FlightLog(*(np.ones((count, 1, width)) for width in (3, 3, 4, 3, 3, 4)))
        force = interaction_force(log, (SMALL,))
        assert force.shape == (count, 1, 3)
        assert np.isfinite(force[:, 0, 2]).sum() == max(0, count - 4 - 12)


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
        return fly_motion(team, RandomWalk(team, rngs, ranges, False, 2.0), "learned", 2.0)

    for together, alone in zip(walk([0, 1]), [*walk([0]), *walk([1])], strict=True):
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.fixture(scope="module")
def collection(tmp_path_factory):
    out = tmp_path_factory.mktemp("flights")
    return out, collect(SHORT, out, progress=False)


def test_a_folder_of_another_configuration_is_refused(collection):
    out, _ = collection
    for change in ({"seed": 1}, {"interactions": "wake"}):
        said = r": config.(seed is 0|interactions is learned) there, "
        with pytest.raises(ValueError, match=said):
            collect(dataclasses.replace(SHORT, **change), out, progress=False)


def test_manifest_and_files_agree(collection):
    out, flights = collection
    manifest = json.loads((out / "manifest.json").read_text())
    assert {entry["name"] for entry in manifest["flights"]} == {f.stem for f in out.glob("*.npz")}
    read = [flight for batch in SHORT.batches() for flight in read_batch(SHORT, out, batch)]
    for entry, flight in zip(manifest["flights"], read, strict=True):
        assert entry["seconds"] == pytest.approx(len(flight.log.position) / LOG_RATE, abs=1e-3)
        assert (entry["team"], entry["validation"]) == (flight.team, flight.validation)
    assert sum(flight.validation for flight in flights) == 2  # of two walks, by two teams


def test_of_single_flights_the_last_is_held_out(tmp_path):
    alone = dataclasses.replace(SHORT, walks=1, low_walks=0, swaps=0, duration_s=3.0)
    flown = collect(alone, tmp_path, progress=False)
    assert [flight.validation for flight in flown] == [False, True]


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


class GoTo:
    """A motion that ends at these places: `start` (E, N, 3), times `scale`."""

    def __init__(self, start, scale):
        self.start, self.scale = np.array(start), scale

    def target(self, time, position):
        still = np.zeros(self.start.shape)
        return MotionTarget(self.start * self.scale, still, still)


def test_in_the_hall_logs_have_an_estimate_and_forces_that_no_model_knows():
    rngs, hall = [np.random.default_rng(seed) for seed in range(64)], Hall()
    hover, team = GoTo(np.tile([0.0, 0.0, 1.0], (64, 1, 1)), 1.0), parse_team("S")
    (still,) = fly_motion(team, GoTo([[[0.0, 0.0, 1.0]]], 1.0), "none", 1.0)
    assert (still.position == [0.0, 0.0, 1.0]).all()
    logs = fly_motion(team, hover, "none", 4.0, hall=hall, rngs=rngs)
    force = np.array([interaction_force(log, team, label="imu")[:, 0, 2] for log in logs])
    force = force[:, 120:]
    # Offset and thrust curve are 1.8 and 1.4 % of the weight; the force of lone drones is 1.1 %.
    assert force.mean(axis=1).std() == pytest.approx(34.0 * np.hypot(0.018, 0.014), rel=0.25)
    assert force.std(axis=1).mean() == pytest.approx(34.0 * 0.011, rel=0.25)
    jumps = np.array([np.diff(log.position[:, 0], n=2, axis=0) for log in logs])
    assert 1e-5 < jumps.std() < 1e-3  # of an estimate, m


def test_a_log_is_cut_before_the_first_contact():
    meet = GoTo([[[0.0, 0.0, 1.0], [0.4, 0.0, 1.0]]], [0.0, 1.0, 1.0])
    (log,) = fly_motion(parse_team("SS"), meet, "none", 4.0)
    assert isinstance(log, FlightLog) and 10 < len(log.position) < 4.0 * LOG_RATE
    distance = np.linalg.norm(log.position[:, 0] - log.position[:, 1], axis=1)
    assert distance.min() >= 2 * SMALL.radius
    assert distance[-1] < 2 * SMALL.radius + 0.03


CONFIG = CollectionConfig(
    teams=("S", "SL"), walks=2, low_walks=0, swaps=2, low_swaps=0, duration_s=6.0, label="imu"
)


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    return collect(CONFIG, tmp_path_factory.mktemp("npz"), progress=False)


def labels_of(rows, flights, vehicles):
    """Labels by the names of flight and vehicle, and the time step."""
    keys = zip(rows.flight.tolist(), rows.vehicle.tolist(), rows.step.tolist(), strict=True)
    return {
        (flights[flight], vehicles[vehicle], step): label
        for (flight, vehicle, step), label in zip(keys, rows.force_g, strict=True)
    }


@pytest.mark.parametrize("label", ["imu", "differentiated"])
def test_flights_give_the_same_forces_as_logs_of_real_vehicles(
    flights, label, tmp_path, monkeypatch
):
    for flight in flights:
        table = to_table(flight.log, parse_team(flight.team), 120)
        if label == "differentiated":
            table = dataclasses.replace(table, acceleration=None)
        write_table(tmp_path / f"{flight.name}.csv", table)
    monkeypatch.setattr("swarm_envs.training.interaction_rows.hold_out.GUARD_S", 0.0)
    logged, _ = read_data(tmp_path, LogOptions(keep_every=4, rate_hz=120.0))
    names, ours = [flight.name for flight in flights], interaction_rows(flights, label)
    a = labels_of(logged, sorted(names), logged.vehicle_names)
    b = labels_of(ours, names, {1: "S1", 101: "L1"})
    both = sorted(a.keys() & b.keys())
    assert len(both) > 0.85 * len(b)
    error = np.array([np.abs(a[key] - b[key]).max() for key in both])
    # A signal cannot say a command beyond the range of psi1: its rows differ, and some after it.
    assert np.quantile(error, 0.9) < 1e-4


def test_killed_and_called_again_the_folder_is_the_same_to_the_byte(tmp_path):
    config = dataclasses.replace(CONFIG, duration_s=1.5)
    whole = tmp_path / "whole"
    collect(config, whole, progress=False)
    cut, module = tmp_path / "cut", sys.modules[collect.__module__]
    with calls_of(module, "save_log", killed_at=4) as calls, pytest.raises(KeyboardInterrupt):
        collect(config, cut, progress=False)
    saved = cut / calls[0][0].name
    first = saved.stat().st_mtime_ns
    collect(config, cut, progress=False)
    assert saved.stat().st_mtime_ns == first  # not flown again
    for file in whole.iterdir():
        assert (cut / file.name).read_bytes() == file.read_bytes()


def test_the_command_covers_table_ii_and_says_so(tmp_path, capsys):
    out, numbers = tmp_path / "out", tmp_path / "numbers.json"
    words = "--duration-s 3 --walks 1 --low-walks 0 --swaps 1 --low-swaps 0"
    assert main(["collect", "--out", str(out), "--json", str(numbers), *words.split()]) == 0
    said = capsys.readouterr()
    assert "all twelve scenarios of Table II have rows" in said.out
    assert "simulated time: 100%" in said.err
    summary = json.loads(numbers.read_text())
    assert list(summary["scenarios"]) == list(SCENARIOS)
    assert sum(s["rows"] for s in summary["scenarios"].values()) == summary["rows"]
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["log_rate"] == 120 and manifest["config"]["noise"]["velocity"] == 0.01
    for name, scenario in summary["scenarios"].items():
        assert scenario["flights"] >= 1 and f"\n{name} " in said.out


def test_the_command_says_which_scenarios_are_missing(tmp_path, capsys):
    words = "--teams S SL --duration-s 3 --walks 1 --low-walks 0 --swaps 0 --low-swaps 0"
    assert main(["collect", "--out", str(tmp_path), *words.split(), "--no-progress"]) == 0
    assert "no rows of these scenarios of Table II: S2S, SS2S" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"teams": ("SX",)}, "token 'X'"),
        ({"teams": ("S", "S")}, "given once"),
        ({"label": "truth"}, "unknown label 'truth'"),
    ],
)
def test_a_collection_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(CollectionConfig(), **change)


def test_a_collection_of_no_flight_is_refused_with_exit_code_2(tmp_path, refused):
    words = ["--teams", "S", "L", "--walks", "0", "--low-walks", "0"]
    assert "no flight" in refused("collect", "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("team", "kind", "label", "bound"),
    [
        ("SL", "swap", "imu", 0.25),
        ("SSL", "walk", "imu", 0.25),
        ("L", "low-walk", "imu", 0.25),
        ("SL", "walk", "differentiated", 0.3),
        ("SSL", "low-walk", "differentiated", 0.3),
        ("SL", "low-swap", "differentiated", 0.3),
        ("L", "low-walk", "differentiated", 0.3),
    ],
)
def test_labels_are_the_force_that_acted(team, kind, label, bound):
    (log,) = noiseless(team, kind, 6.0)
    acted = load("learned").forces(log.position, log.velocity, team) / GRAM_FORCE
    assert np.abs(acted[..., 2]).max() > 1.5  # there is something to find
    force = interaction_force(log, parse_team(team), 0.0, label=label)
    error = (force - acted)[5:-2]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2, axis=(0, 1))).max() < bound


def test_an_accelerometer_reads_one_g_in_hover_and_turns_with_the_body():
    (log,) = noiseless("S", "walk", 6.0, interactions="none")
    assert log.specific_force[:12, 0].mean(axis=0) == pytest.approx([0, 0, GRAVITY], abs=0.5)
    # Without air only the rotors push: along the body's z axis alone.
    thrust = lagged_thrust(log.commands, (SMALL,), 1 / 120)
    assert np.abs(log.specific_force[..., :2]).max() < 0.1
    pull = log.specific_force[..., 2] * SMALL.mass
    assert np.sqrt(np.mean((pull - thrust) ** 2)) < 0.01 * SMALL.mass * GRAVITY
    along = thrust_direction(log.quaternion) * log.specific_force[..., 2:]
    assert np.abs(rotate(log.quaternion, log.specific_force) - along).max() < 0.1


def test_noise_and_biases_have_the_stated_size():
    (log,) = noiseless("SL", "walk", 6.0)
    noise = SensorNoise(1e-3, 0.02, 5e-3, 0.3, 0.1)
    rng = np.random.default_rng(0)
    noisy = [with_noise(log, noise, rng) for _ in range(60)]
    for name, size in (("position", 1e-3), ("velocity", 0.02)):
        errors = [getattr(one, name) - getattr(log, name) for one in noisy[:9]]
        assert np.std(errors) == pytest.approx(size, rel=0.1)
    read = np.stack([one.specific_force - log.specific_force for one in noisy])
    bias = read.mean(axis=1)  # (flights, drones, 3)
    assert np.std(read - bias[:, None]) == pytest.approx(0.3, rel=0.02)
    assert np.std(bias) == pytest.approx(0.1, rel=0.15)
    assert np.abs(bias.mean(axis=0)).max() < 0.06  # drawn again for every flight
    cosine = np.stack([np.abs((one.quaternion * log.quaternion).sum(axis=-1)) for one in noisy])
    turned = np.mean(4.0 * np.arccos(np.minimum(cosine, 1.0)) ** 2)
    assert np.sqrt(turned / 3) == pytest.approx(5e-3, rel=0.15)
    np.testing.assert_allclose(np.linalg.norm(noisy[0].quaternion, axis=-1), 1.0)
    np.testing.assert_array_equal(noisy[0].commands, log.commands)


def test_a_pilot_that_knows_the_force_flies_closer_to_its_set_point():
    errors = {}
    for believed in (None, load("learned")):
        flown = noiseless("SL", "swap", 6.0, count=4, feedforward=believed)
        falls = [np.abs(log.position - log.setpoint)[..., 2].max() for log in flown]
        errors[believed is None] = max(falls)
    assert errors[False] < 0.5 * errors[True]


def test_scenarios_are_counted_by_hand():
    (log,) = noiseless("SS", "swap", 1.0)
    log = log._replace(position=np.zeros((120, 3, 3)))
    found = scenario_counts([CollectedFlight("a", "SSL", log, False)])
    assert list(found) == ["SL2S", "SS2L"]
    assert found["SL2S"] == {"flights": 1, "drone_seconds": 2.0}
    assert found["SS2L"] == {"flights": 1, "drone_seconds": 1.0}
    assert len(set(SCENARIOS)) == 12
