"""Imperfections of the hall and their effects; randomization within its ranges, and its effects."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from swarm_envs import swap_v1
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.randomization import Randomization
from swarm_envs.hall import Hall
from swarm_envs.motors import FULL_VOLTAGE, BatteryModel, pwm_for_force, rotor_force_g
from swarm_envs.physics import BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.state import SwarmState
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import GRAVITY, LARGE, SMALL, parse_team

STEP = 1 / 240
EXACT = Hall(
    residual_quiet=(0.0, 0.0),
    residual_wake=(0.0, 0.0),
    residual_alone=(0.0, 0.0),
    offset=(0.0, 0.0),
    thrust_error=0.0,
    frame_loss=0.0,
    position_noise_m=0.0,
    attitude_noise_rad=0.0,
    accelerometer_noise=0.0,
    gyro_noise=0.0,
)
"""A hall without anything: the ideal world."""


def hall(**numbers: Any) -> Hall:
    """A hall with these imperfections alone."""
    return Hall(**{**vars(EXACT), **numbers})


def core(world: Any, num_envs: int = 1, team: Any = "SL", **options: Any) -> SwarmCore:
    config = EnvConfig(**{"physics": "batch", "interactions": "none", "world": world, **options})
    made = SwarmCore(SwapTask(parse_team(team), "stacked"), config, num_envs)
    made.reset(list(range(num_envs)))
    return made


def hover(made: SwarmCore, decisions: int, action: float = 0.0) -> None:
    for _ in range(decisions):
        made.step(np.full((*made.world.drones.shape, made.mode.width), action))


def test_a_hall_without_imperfections_is_the_ideal_world():
    different: list[dict[str, Any]] = [{}, {"interactions": "wake"}, {"action": "ctbr"}]
    for options in different:
        flown = [core(world, **options) for world in ("ideal", EXACT)]
        for made in flown:
            hover(made, 40, 0.1)
        for mine, theirs in zip(*(made.physics.state for made in flown), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-12)
        np.testing.assert_allclose(flown[0].rows, flown[1].rows, rtol=0, atol=1e-6)


def accelerations(made: SwarmCore, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Acceleration, residual and modelled force after each of some physics steps (K, E, N, 3)."""
    found: list[tuple[np.ndarray, ...]] = []
    drones = made.world.drones
    for _ in range(steps):
        before = drones["velocity"].copy()
        hover(made, 1)
        change = (drones["velocity"] - before) / STEP
        found.append((change, drones["residual_process"].copy(), drones["force"].copy()))
    return tuple(map(np.array, zip(*found)))  # type: ignore[return-value]


def test_the_residual_has_the_variance_and_correlation_that_it_says():
    made = core(hall(residual_alone=(0.05, 0.05), residual_time_s=0.1), 2000, decision_rate=240)
    _, residual, _ = accelerations(made, 60)
    assert residual.mean() == pytest.approx(0.0, abs=0.03)
    assert (residual**2).mean() == pytest.approx(1.0, abs=0.03)
    for steps in (1, 12, 24, 48):
        correlation = (residual[steps:] * residual[:-steps]).mean()
        assert correlation == pytest.approx(math.exp(-steps * STEP / 0.1), abs=0.04)
    apart = residual.reshape(60, 2000, 6)[-1]
    between = np.corrcoef(apart.T) - np.eye(6)
    assert np.abs(between).max() < 0.08  # drones and axes are independent


def test_the_residual_pushes_and_grows_with_the_modelled_force():
    numbers: Any = {
        "residual_quiet": (0.02, 0.03),
        "residual_wake": (0.1, 0.1),
        "residual_half": (0.05, 0.08),
        "residual_sideways": 0.5,
        "residual_alone": (0.01, 0.04),
    }
    options: Any = {"interactions": "wake", "decision_rate": 240, "action": "rotors", "team": "SLL"}
    plain, shaken = (core(world, 3, **options) for world in (EXACT, hall(**numbers)))
    for made in (plain, shaken):
        below = [[0.0, 0.0, 1.0], [0.02, 0.0, 1.4], [0.4, 0.0, 1.4]]
        made.reset(options={"start": below})
    still, _, _ = accelerations(plain, 1)
    moved, residual, force = accelerations(shaken, 1)
    weight = shaken.world.drones["nominal_mass"] * GRAVITY
    pushed = (moved - still)[0] * shaken.world.drones["mass"][..., None]
    share = np.linalg.norm(force[0], axis=-1) / weight
    assert share.max() > 0.05
    quiet, half = np.array([0.02, 0.03, 0.03]), np.array([0.05, 0.08, 0.08])  # of S, L and L
    size = weight * (quiet + (0.1 - quiet) * share / (share + half))
    size[:, 2] = 0.04 * weight[:, 2]  # nobody is near
    np.testing.assert_allclose(pushed[..., 2], size * residual[0, ..., 2], atol=1e-10)
    np.testing.assert_allclose(pushed[..., 0], 0.5 * size * residual[0, ..., 0], atol=1e-10)


@pytest.mark.parametrize("drones", [4, pytest.param(30, marks=pytest.mark.slow)])
def test_company_is_whoever_is_in_the_interaction_volume(drones, engine):
    """For few drones and for many, also where forces are evaluated every fifth step only."""
    made = (BulletPhysics if engine == "bullet" else BatchPhysics)(
        "S" * drones, 6, "wake", force_rate=48, hall=hall()
    )
    rng, d = np.random.default_rng(5), made.world.drones
    spread = [1.0, 1.0, 1.5] if drones == 4 else [3.0, 3.0, 1.5]
    places = rng.uniform(-0.5, 0.5, d["position"].shape) * spread + [0.0, 0.0, 1.5]
    apart = np.abs(places[:, :, None] - places[:, None])
    near = (apart < [0.35, 0.35, 1.1]).all(axis=-1) & ~np.eye(drones, dtype=bool)
    expected = near.any(axis=-1)
    assert 0.1 < expected.mean() < 0.9
    made.reset(made.state._replace(position=places))
    for _ in range(2):
        made.step(np.zeros((6, drones, 4)))
        np.testing.assert_array_equal(d["has_neighbor"], expected)
        d["position"] += np.arange(drones)[:, None] * [5.0, 0.0, 0.0]  # held all the same
    made.close()


def test_offsets_and_thrust_errors_are_constant_accelerations(engine):
    for world in (hall(offset=(0.05, 0.05)), hall(thrust_error=0.05)):
        made = core(world, physics=engine, action="rotors")
        drones = made.world.drones
        level = 2 * drones["hover_thrust"] / drones["max_rotor_thrust"] - 1
        for _ in range(10):
            made.step(np.repeat(level[..., None], 4, axis=-1))
        error = drones["force_offset"] / (drones["mass"] * GRAVITY) + drones["thrust_gain"] - 1
        assert np.abs(error).min() > 1e-4
        expected = GRAVITY * error * made.time[:, None]
        np.testing.assert_allclose(drones["velocity"][..., 2], expected, rtol=1e-6)


def test_an_offset_does_not_grow_over_single_steps():
    made = core(hall(offset=(0.05, 0.05)))
    drones = made.world.drones
    for _ in range(24):
        made.physics.step(np.repeat(drones["hover_thrust"][..., None], 4, axis=-1))
    acceleration = drones["force_offset"] / drones["mass"]
    np.testing.assert_allclose(drones["velocity"][..., 2], 0.1 * acceleration, rtol=1e-6)


def test_what_is_drawn_for_an_episode_has_the_spread_that_it_says():
    between = replace(SMALL, token="M", mass=0.5 * (SMALL.mass + LARGE.mass))
    made = core(Hall(offset=(0.02, 0.04), thrust_error=0.04), 1000, team=(SMALL, between, LARGE))
    drones = made.world.drones
    offset = drones["force_offset"] / (drones["nominal_mass"] * GRAVITY)
    assert offset.std(axis=0) == pytest.approx([0.02, 0.03, 0.04], rel=0.1)
    assert drones["thrust_gain"].std() == pytest.approx(0.04, rel=0.08)
    assert len(np.unique(made.world.environments["hall_key"])) == 1000
    first = offset.copy()
    made.reset()
    assert not (made.world.drones["force_offset"] == first).any()


def test_a_factor_of_the_hall_scales_what_it_has_drawn():
    plain = core("hall", 200, randomization=Randomization())
    made = core("hall", 200, randomization=Randomization(hall=(0.5, 1.5)))
    drawn, usual = made.world.drones, plain.world.drones
    factor = drawn["residual_quiet"] / usual["residual_quiet"]
    assert 0.5 <= factor.min() < 0.55 and 1.45 < factor.max() <= 1.5
    assert np.ptp(factor, axis=1).max() < 1e-12  # the same for the drones of an environment
    for name in ("residual_more", "residual_alone", "force_offset"):
        np.testing.assert_allclose(drawn[name], factor * usual[name], rtol=1e-12)
    error, before = drawn["thrust_gain"] - 1.0, usual["thrust_gain"] - 1.0
    np.testing.assert_allclose(error, factor * before, rtol=1e-9)
    with pytest.raises(ValueError, match=r"Randomization\.hall is \(0.5, 1.5\), but the world"):
        core("ideal", randomization=Randomization(hall=(0.5, 1.5)))


def test_gains_are_those_of_the_kalman_filter():
    """The steady state by scipy's solution of the Riccati equation."""
    numbers, time = Hall(frame_rate_hz=50.0), 1 / 50.0
    moves = np.array([[1.0, time], [0.0, 1.0]])
    walk = 0.05**2 * np.array([[time**3 / 3, time**2 / 2], [time**2 / 2, time]])
    seen = np.array([[1.0, 0.0]])
    before = solve_discrete_are(moves.T, seen.T, walk, [[0.001**2]])
    gain = before[:, 0] / (before[0, 0] + 0.001**2)
    assert numbers.filter_gains()[:2] == pytest.approx(gain, rel=1e-6)
    assert hall(position_noise_m=0.1).filter_gains() == (0.0, 0.0, 0.0)  # nothing drifts


def test_the_thrust_error_is_that_of_the_published_polynomials():
    """Psi1 of psi2's signal over the force asked for: Table I, the small vehicle."""
    force = SMALL.mass * 1000 / 4 * np.linspace(0.5, 1.5, 41)[:, None]
    volts = np.linspace(3.4, 4.0, 31) / FULL_VOLTAGE
    given = rotor_force_g(SMALL, pwm_for_force(SMALL, force, volts), volts) / force
    assert given.std() == pytest.approx(Hall().thrust_error, abs=5e-4)


def reference_errors(
    numbers: Hall, position: np.ndarray, velocity: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (K, R) of a filter in plain numpy that keeps the state, not its error, on one axis.

    Position and velocity (K, R) are the truth of R drones at each physics step. The frames are
    those of a camera: taken at their own times, of the position then.
    """
    count, runs = position.shape
    kp, kv, _ = numbers.filter_gains()
    p, v = position[0], velocity[0]
    period, time, phase = 1 / numbers.frame_rate_hz, STEP * np.arange(count), rng.uniform(size=runs)
    due = np.floor((time[:, None] - numbers.frame_delay_s) / period - phase)
    noise = numbers.accelerometer_noise / math.sqrt(STEP)
    errors = np.zeros((2, count, runs))
    for k in range(1, count):
        measured = (velocity[k] - velocity[k - 1]) / STEP
        v = v + STEP * (measured + noise * rng.standard_normal(runs))
        p = p + STEP * v
        taken = np.maximum((due[k] + phase) * period / STEP, 0.0)
        before = np.minimum(taken.astype(int), count - 2)
        here, there = (position[before + k, np.arange(runs)] for k in (0, 1))
        seen = here + (taken - before) * (there - here)
        frame = seen + numbers.position_noise_m * rng.standard_normal(runs)
        arrived = (due[k] > due[k - 1]) & (rng.uniform(size=runs) >= numbers.frame_loss)
        missed = np.where(arrived, frame - p, 0.0)
        p, v = p + kp * missed, v + kv * missed
        errors[:, k] = p - position[k], v - velocity[k]
    return errors[0], errors[1]


@pytest.mark.parametrize("given", [{}, {"frame_loss": 0.6}, {"frame_delay_s": 0.02}])
def test_the_estimate_errs_as_a_filter_in_plain_numpy(given):
    """A drone that speeds up to 0.4 m/s, in many environments."""
    usual = {name: getattr(Hall(), name) for name in ("accelerometer_noise", "gyro_noise")}
    numbers = hall(**usual, frame_rate_hz=60.0, position_noise_m=0.005, **given)
    made = core(numbers, 600, team="S", decision_rate=240)
    truth, errors = [], []
    for k in range(180):
        hover(made, 1, 0.2 if k < 100 else 0.0)
        d = made.world.drones[:, 0]
        truth.append((d["position"][:, 0].copy(), d["velocity"][:, 0].copy()))
        errors.append((d["position_error"][:, 0].copy(), d["velocity_error"][:, 0].copy()))
    position, velocity = np.array(truth).transpose(1, 0, 2)
    assert velocity[-1].mean() > 0.4
    mine = np.array(errors)
    theirs = reference_errors(numbers, position, velocity, np.random.default_rng(1))
    for k, quantity in enumerate(theirs):
        spread = quantity[120:].std()
        assert mine[120:, k].std() == pytest.approx(spread, rel=0.1)
        assert mine[120:, k].mean() == pytest.approx(quantity[120:].mean(), abs=0.15 * spread)


def test_attitude_errs_by_what_gyroscope_and_frames_say():
    """Against the steady state of the scalar Kalman filter, P = sqrt(q r) for dense frames."""
    numbers = hall(gyro_noise=0.01, attitude_noise_rad=0.02, frame_rate_hz=240.0)
    made = core(numbers, 400)
    hover(made, 20)
    errors = made.world.drones["attitude_error"]
    drift, noise = 0.01**2 * STEP, 0.02**2
    before = 0.5 * (drift + math.sqrt(drift**2 + 4 * drift * noise))  # Riccati's equation
    assert errors.std() == pytest.approx(math.sqrt(before - drift), rel=0.1)
    rates = made.world.drones["gyro_error"]
    assert rates.std() == pytest.approx(0.01 / math.sqrt(STEP), rel=0.05)


@pytest.mark.parametrize("action", ["setpoint", "acceleration"])
def test_the_controller_flies_by_the_estimate_and_judges_by_the_truth(action):
    """Without noise a filter corrects nothing: an error that is put in stays."""
    made = core(EXACT, team="S", action=action)
    d = made.world.drones
    start = d["position"].copy()
    d["position_error"] = [0.1, -0.1, 0.05]
    command = np.zeros((1, 1, made.mode.width))
    command[..., :3] = start if action == "setpoint" else 0.0
    for _ in range(48 * 6):
        made.step(command)
    np.testing.assert_allclose(d["position"], start - [0.1, -0.1, 0.05], atol=3e-3)
    np.testing.assert_allclose(made.rows[..., :3], start, atol=3e-3)
    away = np.linalg.norm(d["position"] - d["goal"], axis=-1)
    np.testing.assert_allclose(d["distance"], away, atol=1e-12)


def test_contacts_are_those_of_the_truth():
    made = core(hall(position_noise_m=1.0, accelerometer_noise=1e-3), team="SS")
    made.world.drones["position_error"][0, 0] = made.world.drones["position"][0, 1]
    made.world.drones["position_error"][0, 0] -= made.world.drones["position"][0, 0]
    hover(made, 1)
    assert not made.physics.contact.any()
    assert np.linalg.norm(made.rows[0, 0, :3] - made.rows[0, 1, :3]) < 0.05


def flight(made: SwarmCore, decisions: int = 30) -> bytes:
    """Return states and observations under actions of a generator of its own."""
    rng, seen = np.random.default_rng(3), []
    shape = (made.num_drones, made.mode.width)
    for _ in range(decisions):
        one = rng.uniform(-0.3, 0.3, shape)
        made.step(np.repeat(one[None], made.num_envs, axis=0))
        seen.append(made.rows[0].tobytes() + made.world.drones[0].tobytes())
    return b"".join(seen)


def test_same_seed_same_bytes_for_any_number_of_environments_and_threads():
    alone = flight(core("hall", 1))
    assert alone == flight(core("hall", 70))
    assert alone == flight(core("hall", 70, threads=2))
    assert alone != flight(core("ideal", 1))


def test_a_snapshot_goes_on_byte_for_byte(engine):
    first = core("hall", 2, physics=engine)
    flight(first, 7)
    kept = first.get_state()
    expected = flight(first)
    other = core("hall", 2, physics=engine)
    other.set_state(kept)
    assert flight(other) == expected
    with pytest.raises(ValueError, match="world is 'hall', but here it is 'ideal'"):
        core("ideal", 2, physics=engine).set_state(kept)


@pytest.mark.skipif(not bullet_available(), reason="pybullet is not installed")
@pytest.mark.parametrize("gusts", [0.0, 0.5])
def test_engines_fly_the_same_hall(gusts):
    ranges = Randomization(gust_acceleration=gusts) if gusts else None
    options: Any = {"interactions": "wake", "team": "LSS", "randomization": ranges}
    batch, bullet = (core("hall", 2, physics=name, **options) for name in ("batch", "bullet"))
    rng = np.random.default_rng(0)
    for _ in range(60):
        actions = rng.uniform(-0.3, 0.3, (2, 3, 3))
        for made in (batch, bullet):
            made.step(actions)
        assert not batch.physics.contact.any()
    for name in ("position", "quaternion", "position_error", "attitude_error", "residual_process"):
        ours, theirs = batch.world.drones[name], bullet.world.drones[name]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    np.testing.assert_allclose(batch.rows, bullet.rows, rtol=0, atol=1e-6)  # float32


def test_the_option_is_read_by_name_and_by_numbers():
    worlds: list[tuple[Any, Any]] = [("ideal", None), ("hall", Hall()), (EXACT, EXACT)]
    for world, expected in worlds:
        env = swap_v1.parallel_env(world=world, physics="batch", interactions="none")
        assert env.core.physics.hall == expected
    with pytest.raises(ValueError, match="world"):
        swap_v1.parallel_env(world="attic")
    with pytest.raises(ValueError, match="but the hall has its own noise"):
        EnvConfig(world="hall", randomization=Randomization(position_noise_m=0.01))


MANY = 400


def randomized(ranges: Randomization | None, num_envs: int = MANY, **options: Any) -> SwarmCore:
    given = {"interactions": "learned", "randomization": ranges, **options}
    return core("ideal", num_envs, **given)


@pytest.mark.parametrize(
    ("option", "field"),
    [("mass", "mass"), ("motor_rate", "motor_rate"), ("thrust", "max_rotor_thrust")],
)
def test_factors_fill_their_range_and_nothing_else_moves(option, field):
    ranges = Randomization(**{option: (0.8, 1.3)})  # type: ignore[arg-type]  # by name
    made, usual = randomized(ranges), randomized(None)
    mine, theirs = made.physics.parameters, usual.physics.parameters
    factor = getattr(mine, field) / getattr(theirs, field)
    assert 0.8 <= factor.min() < 0.81 and 1.29 < factor.max() <= 1.3
    assert abs(np.corrcoef(factor.T)[0, 1]) < 0.2  # drones differ within an environment
    for name in mine._fields:
        assert name == field or np.array_equal(getattr(mine, name), getattr(theirs, name))
    assert np.array_equal(made.world.drones["nominal_mass"], theirs.mass)
    assert np.array_equal(made.world.drones["start"], usual.world.drones["start"])


def test_inertia_keeps_its_shape():
    made = randomized(Randomization(inertia=(0.5, 2.0)))
    factor = made.physics.parameters.inertia[:, 0] / np.array(SMALL.inertia)
    assert np.ptp(factor, axis=1).max() < 1e-12 < np.ptp(factor, axis=0).max()


def test_every_episode_is_drawn_anew_and_a_seed_repeats_it():
    made = randomized(Randomization(mass=(0.9, 1.1)), 2)
    first = made.physics.parameters.mass.copy()
    made.reset()
    assert not (made.physics.parameters.mass == first).any()
    made.reset(mask=np.array([True, False]), seeds=[0, None])
    assert np.array_equal(made.physics.parameters.mass[0], first[0])


def pushed(engine: str, ranges: Randomization, yaw: float, steps: int) -> SwarmState:
    """The state of a lone drone that began level, after rotor commands about its nominal hover."""
    options: dict[str, Any] = {"interactions": "none", "action": "rotors"}
    env = swap_v1.parallel_env(num_drones=1, physics=engine, randomization=ranges, **options)
    env.reset(seed=0, options={"start": [[0.0, 0.0, 1.5]]})
    level = 2 * SMALL.hover_rotor_thrust / SMALL.max_rotor_thrust - 1
    for _ in range(steps):
        env.step({"drone_0": level + yaw * np.array([-1.0, 1.0, -1.0, 1.0])})
    state = env.view.state.copy()
    env.close()
    return state


def test_a_heavier_drone_sags_on_both_engines(engine):
    """Open loop at the nominal hover thrust, it falls with g (1 - m / m')."""
    state = pushed(engine, Randomization(mass=(1.1, 1.1)), yaw=0.0, steps=12)
    assert state.velocity[0, 2] == pytest.approx(GRAVITY * (1 / 1.1 - 1) * 0.25, rel=1e-6)


def test_a_smaller_inertia_turns_faster_on_both_engines(engine):
    """The yaw rate after a yaw torque is inversely proportional to the moment of inertia."""
    ranges = (Randomization(inertia=(factor, factor)) for factor in (1.0, 0.5))
    slow, fast = (pushed(engine, each, 0.02, 1).angular_velocity[0, 2] for each in ranges)
    assert fast == pytest.approx(2 * slow, rel=1e-9)


def test_scaled_forces_scale():
    made, usual = randomized(Randomization(force_scale=(0.5, 2.0))), randomized(None)
    scale = made.world.environments["force_scale"]
    assert 0.5 <= scale.min() < 0.52 and 1.95 < scale.max() <= 2.0
    for one in (made, usual):
        one.physics.step(one.physics.state.rotor_thrust)
    expected = usual.physics.force * scale[:, None, None]
    np.testing.assert_allclose(made.physics.force, expected, atol=1e-15)


def test_gusts_push_all_drones_alike_with_the_spread_asked_for():
    ranges = Randomization(gust_acceleration=0.8, gust_time_s=0.2)
    made = randomized(ranges, interactions="none")
    samples = []
    for _ in range(40):
        made.physics.fly(5, made.running)
        samples.append(made.world.environments["gust"].copy())
    spread = np.array(samples[20:]).std()
    assert spread == pytest.approx(0.8, rel=0.05)
    lag = np.mean(samples[-1] * samples[-6]) / spread**2  # 25 physics steps apart
    assert lag == pytest.approx(np.exp(-25 / 240 / 0.2), abs=0.1)


def test_without_a_controller_a_gust_accelerates_every_type_by_itself():
    ranges = Randomization(gust_acceleration=2.0, gust_time_s=100.0)
    made = randomized(ranges, 1, interactions="none", action="rotors")
    still = randomized(None, 1, interactions="none", action="rotors")
    for one in (made, still):
        one.physics.fly(24, one.running)
    gained = made.physics.state.velocity - still.physics.state.velocity
    np.testing.assert_allclose(gained[0, 0], gained[0, 1], rtol=1e-9)
    assert np.linalg.norm(gained) > 1e-3


def test_noise_is_seen_but_not_flown():
    ranges = Randomization(position_noise_m=0.02, velocity_noise=0.1, body_rate_noise=0.3)
    made, usual = randomized(ranges), randomized(None)
    for _ in range(5):
        rows = made.step(np.zeros((MANY, 2, 3))).observations
        clean = usual.step(np.zeros((MANY, 2, 3))).observations
    assert np.array_equal(made.physics.state.position, usual.physics.state.position)
    error = rows - clean
    assert error[..., 0:3].std() == pytest.approx(0.02, rel=0.05)
    assert error[..., 3:6].std() * 2.0 == pytest.approx(0.1, rel=0.05)
    assert error[..., 15:18].std() * 10.0 == pytest.approx(0.3, rel=0.05)
    assert np.array_equal(rows[..., 6:15], clean[..., 6:15])  # attitude: no noise asked for
    assert np.array_equal(made.team_state(), usual.team_state())


def test_noisy_attitudes_turn_by_the_angle_asked_for():
    made, usual = randomized(Randomization(attitude_noise_rad=0.05)), randomized(None)
    a = made.rows[..., 6:15].reshape(-1, 3, 3).astype(np.float64)
    b = usual.rows[..., 6:15].reshape(-1, 3, 3).astype(np.float64)
    turn = a @ b.transpose(0, 2, 1)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(0.05 * np.sqrt(3), rel=0.05)


def test_batteries_start_where_they_are_drawn_and_limit_from_the_first_step():
    ranges = Randomization(battery=(0.05, 0.1))
    made = randomized(ranges, battery=BatteryModel())
    charge = made.physics.state.battery
    assert 0.05 <= charge.min() < charge.max() <= 0.1
    assert (made.world.drones["rotor_limit"] < made.physics.parameters.max_rotor_thrust).all()


def test_what_could_not_fly_is_refused():
    weak = Randomization(thrust=(0.5, 1.0), mass=(1.0, 1.2))
    with pytest.raises(ValueError, match=r"can leave 'S' with a thrust-to-weight ratio of 0.8\d"):
        swap_v1.parallel_env(num_drones=2, physics="batch", randomization=weak)
    with pytest.raises(ValueError, match="ideal batteries never empty; give battery="):
        swap_v1.parallel_env(physics="batch", randomization=Randomization(battery=(0.5, 1.0)))
