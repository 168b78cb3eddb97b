"""Sensors, labels and vehicles of a collection: what is logged, and what a label may know."""

import dataclasses

import numpy as np
import pytest

from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics import BatchPhysics
from swarm_envs.training.collection import (
    CalibrationErrors,
    CollectionConfig,
    SensorNoise,
    collect,
    interaction_force,
    interaction_rows,
)
from swarm_envs.training.collection.collect import (
    FlightBatch,
    flight_generator,
    fly_flights,
    make_motion,
)
from swarm_envs.training.collection.flight import fly_motion, vehicle_ids, vehicle_names
from swarm_envs.training.collection.log import (
    NO_NOISE,
    lagged_thrust,
    resampled,
    rotate,
    rotate_to_body,
    thrust_direction,
    with_noise,
    world_acceleration,
)
from swarm_envs.training.collection.table import SCENARIOS, CollectedFlight, scenario_counts
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, SMALL, parse_team

EXACT = CollectionConfig(noise=NO_NOISE, duration_s=6.0)


def logs(team="SL", kind="swap", count=1, config=EXACT):
    return fly_flights(config, FlightBatch(team, kind, count), load(config.interactions))


@pytest.mark.parametrize(
    ("team", "kind", "rate", "label", "bound"),
    [
        ("SL", "swap", 120, "imu", 0.25),
        ("SSL", "walk", 100, "imu", 0.25),
        ("L", "low-walk", 100, "imu", 0.25),
        ("SL", "walk", 120, "differentiated", 0.3),
        ("SSL", "low-walk", 120, "differentiated", 0.3),
        ("SL", "low-swap", 120, "differentiated", 0.3),
        ("L", "low-walk", 120, "differentiated", 0.3),
    ],
)
def test_labels_are_the_force_that_acted(team, kind, rate, label, bound):
    (log,) = logs(team, kind, config=dataclasses.replace(EXACT, log_rate=rate))
    acted = load("learned").forces(log.position, log.velocity, team) / GRAM_FORCE
    assert np.abs(acted[..., 2]).max() > 1.5  # there is something to find
    force = interaction_force(log, parse_team(team), 0.0, rate, label)
    error = (force - acted)[5:-2]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2, axis=(0, 1))).max() < bound


def test_a_label_knows_the_log_alone(tmp_path, monkeypatch):
    """With every truth of the simulator spoilt as soon as a step is made, the rows are the same."""
    config = CollectionConfig(
        teams=("SL",), walks=2, low_walks=0, swaps=2, low_swaps=0, duration_s=3.0
    )
    expected = interaction_rows(collect(config, tmp_path / "a", progress=False))
    step = BatchPhysics.step

    def spoilt(self, commands, external_force=None):
        state = step(self, commands, external_force)
        self.force[...] = np.nan
        return state._replace(rotor_thrust=np.full(state.rotor_thrust.shape, 9.0))

    monkeypatch.setattr(BatchPhysics, "step", spoilt)
    flights = collect(config, tmp_path / "b", progress=False)

    def forbidden(*_):
        raise AssertionError("a label asked the simulator for the force")

    monkeypatch.setattr(InteractionModel, "forces", forbidden)
    rows = interaction_rows(flights)
    np.testing.assert_array_equal(rows.force_g, expected.force_g)
    for label in ("differentiated", "imu"):
        assert np.isfinite(interaction_rows(flights, label).force_g).all()


def test_an_accelerometer_reads_one_g_in_hover_and_turns_with_the_body():
    (log,) = logs("S", "walk", config=dataclasses.replace(EXACT, interactions="none"))
    assert log.specific_force[:12, 0].mean(axis=0) == pytest.approx([0, 0, GRAVITY], abs=0.5)
    # Without air only the rotors push: along the body's z axis alone.
    thrust = lagged_thrust(log.commands, (SMALL,), 1 / 120)
    assert np.abs(log.specific_force[..., :2]).max() < 0.1
    pull = log.specific_force[..., 2] * SMALL.mass
    assert np.sqrt(np.mean((pull - thrust) ** 2)) < 0.01 * SMALL.mass * GRAVITY
    along = thrust_direction(log.quaternion) * log.specific_force[..., 2:]
    assert np.abs(world_acceleration(log) - along).max() < 0.1
    back = rotate_to_body(log.quaternion, rotate(log.quaternion, log.velocity))
    np.testing.assert_allclose(back, log.velocity, atol=1e-12)


def test_accelerometers_have_white_noise_and_a_bias_of_their_own():
    (log,) = logs("SL", "walk")
    noise = SensorNoise(accelerometer=0.3, accelerometer_bias=0.1)
    rng = np.random.default_rng(0)
    errors = np.stack(
        [with_noise(log, noise, rng).specific_force - log.specific_force for _ in range(60)]
    )
    bias = errors.mean(axis=1)  # (flights, drones, 3)
    assert np.std(errors - bias[:, None]) == pytest.approx(0.3, rel=0.02)
    assert np.std(bias) == pytest.approx(0.1, rel=0.15)
    assert np.abs(bias.mean(axis=0)).max() < 0.06  # drawn anew for every flight


def test_askew_markers_lean_every_attitude_of_a_drone_alike():
    (log,) = logs("SL", "walk")
    noise = dataclasses.replace(NO_NOISE, attitude_bias_rad=0.02)
    lean = thrust_direction(with_noise(log, noise, np.random.default_rng(4)).quaternion)
    turned = np.linalg.norm(lean - thrust_direction(log.quaternion), axis=-1)
    assert (turned.std(axis=0) < 0.4 * turned.mean(axis=0)).all()
    assert (turned.mean(axis=0) > 2e-3).all()


def test_logs_at_100_hz_lie_between_those_at_120():
    (fast,) = logs("SL", "walk")
    slow = resampled(fast, 100)
    assert len(slow.position) == 600 and len(fast.position) == 720
    for name in fast._fields:  # every 0.05 s both have an entry
        a, b = getattr(fast, name)[::6], getattr(slow, name)[::5]
        np.testing.assert_allclose(a[: len(b)], b[: len(a)], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(slow.quaternion, axis=-1), 1.0)
    assert resampled(fast, 120) is fast


def test_a_vehicle_that_is_off_is_off_alike_in_all_its_flights():
    """Mean label of a lone drone aloft: weight of the type less commanded thrust, by hand."""
    errors = CalibrationErrors(mass=0.05, thrust=0.04)
    config = dataclasses.replace(EXACT, errors=errors, interactions="none", duration_s=12.0)
    rngs = [np.random.default_rng(0)]
    for team in ("S", "SL"):
        vehicles = errors.draw(parse_team(team), config.seed, rngs)
        mass, thrust = vehicles.mass_factor[0, 0], vehicles.thrust_factor[0, 0]
        assert abs(mass - 1.0) > 0.005 or abs(thrust - 1.0) > 0.005
        (log,) = logs(team, "walk", config=config)
        label = interaction_force(log, parse_team(team))[20:-20, 0, 2].mean()
        expected = 1e3 * SMALL.mass * (1.0 - mass / thrust)
        assert label == pytest.approx(expected, abs=0.15)
    again = errors.draw(parse_team("S"), config.seed + 1, rngs)
    assert again.mass_factor[0, 0] != mass


def test_drift_of_thrust_differs_between_flights():
    errors = CalibrationErrors(thrust_per_flight=0.02)
    rngs = [np.random.default_rng(k) for k in range(500)]
    thrust = errors.draw(parse_team("SS"), 0, rngs).thrust_factor
    assert np.std(thrust) == pytest.approx(0.02, rel=0.1)
    assert (errors.draw(parse_team("SS"), 0, rngs).mass_factor == 1.0).all()


def test_teams_are_put_together_from_one_fleet():
    assert vehicle_names(parse_team("SSLS*")) == ("S1", "S2", "L1", "S*1")
    assert vehicle_ids(parse_team("SSL")) == (1, 2, 101)
    assert len(set(vehicle_ids(parse_team("SSSLLLS*S*")))) == 8


def test_a_pilot_that_knows_the_force_flies_closer_to_its_set_point():
    """A pilot that knows the force holds its height in a wake in which another falls."""
    errors = {}
    for believed in (None, load("learned")):
        batch = FlightBatch("SL", "swap", 4)
        rngs = [flight_generator(EXACT, name) for name in batch.names]
        motion = make_motion(EXACT, batch, rngs)
        flown = fly_motion(parse_team("SL"), motion, "learned", 6.0, believed)
        errors[believed is None] = max(
            float(np.abs(log.position - log.setpoint)[..., 2].max()) for log in flown
        )
    assert errors[False] < 0.5 * errors[True]


def test_scenarios_are_counted_by_hand():
    (log,) = logs("SS", "swap")
    position = np.zeros((120, 3, 3))
    position[:, 1, 2], position[:60, 2, 0], position[60:, 2, 0] = 0.5, 0.2, 5.0
    flights = [CollectedFlight("a", "SSL", log._replace(position=position), False)]
    found = scenario_counts(flights)
    assert list(found) == ["SL2S", "SS2L"]
    assert found["SL2S"] == (1, 2.0, 2.0)  # the two small ones stay together
    assert found["SS2L"] == (1, 1.0, 0.5)
    assert len(set(SCENARIOS)) == 12
