"""The compiled tracking loop against the plain one, its memory, and its configuration."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.numpy_controller import (
    NumpyTrackingController,
    TrackingTarget,
)
from swarm_envs.control.config import (
    MID,
    SOFT,
    STIFF,
    ControllerConfig,
    PositionGains,
    gains,
    low_pass_blend,
)
from swarm_envs.control.tracking import TrackingController
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.step import SETPOINTS
from swarm_envs.state import FloatArray, Setpoint, SwarmState, hover_state
from swarm_envs.vehicles import GRAVITY, LARGE, SMALL, parse_team

TEAM = parse_team("SLS*L")
MEMORY = (
    *("velocity_integral", "rate_integral", "desired_thrust", "thrust_rate", "rate_error"),
    *("rate_error_rate", "desired_attitude", "desired_rate", "started"),
)
"""What the loop remembers from step to step."""


def memory(controller: TrackingController) -> dict[str, FloatArray]:
    drones = controller._loop.world.drones
    return {name: drones[name].copy() for name in MEMORY}


class _RandomFlight:
    """Smooth random states and set-points with noise on top, for two environments of a team."""

    def __init__(self, seed: int, wildness: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.wildness = wildness
        self.shape = (2, len(TEAM))
        self.state = hover_state(TEAM, self.rng.normal(size=(*self.shape, 3)))
        self.setpoint = Setpoint.hold(self.state.position.copy())
        self.walk = np.zeros((*self.shape, 3))

    def advance(self) -> tuple[SwarmState, Setpoint, FloatArray]:
        rng, shape, wild = self.rng, self.shape, self.wildness
        self.walk += 0.05 * (wild * rng.normal(size=self.walk.shape) - self.walk)
        s, sp = self.state, self.setpoint
        s.velocity[...] = self.walk + 0.03 * rng.normal(size=self.walk.shape)
        s.position[...] += s.velocity / 240
        s.angular_velocity[...] = 2 * wild * rng.normal(size=self.walk.shape)
        step = np.concatenate([s.angular_velocity / 480, np.ones((*shape, 1))], axis=-1)
        s.quaternion[...] = _multiply(step, s.quaternion)
        s.quaternion[...] /= np.linalg.norm(s.quaternion, axis=-1, keepdims=True)
        s.quaternion[...] *= rng.choice([-1.0, 1.0], size=(*shape, 1))
        sp.velocity[...] = 0.1 * wild * rng.normal(size=self.walk.shape)
        sp.acceleration[...] = wild * rng.normal(size=self.walk.shape)
        sp.yaw_rate[...] = wild * rng.normal(size=shape)
        sp.yaw[...] += sp.yaw_rate / 240 + (rng.uniform(size=shape) < 0.01) * rng.normal(size=shape)
        return s, sp, 0.03 * wild * rng.normal(size=self.walk.shape)


def _multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    va, wa, vb, wb = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = wa * vb + wb * va + np.cross(va, vb)
    scalar = wa * wb - np.sum(va * vb, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


@pytest.mark.parametrize("lag_compensation", [True, False])
@pytest.mark.parametrize(("wildness", "stiffness"), [(0.03, MID), (1.0, STIFF)])
def test_compiled_agrees_with_plain(
    lag_compensation: bool, wildness: float, stiffness: PositionGains
) -> None:
    config = ControllerConfig(gains=stiffness, lag_compensation=lag_compensation)
    compiled = TrackingController(TEAM, num_envs=2, config=config)
    plain = [[NumpyTrackingController(v, config) for v in TEAM] for _ in range(2)]
    flight = _RandomFlight(7, wildness)
    limits = np.array([v.max_rotor_thrust for v in TEAM])[:, None]
    saturated = unsaturated = 0
    for _ in range(300):
        state, setpoint, force = flight.advance()
        commands = compiled.commands(state, setpoint, force)
        expected = np.empty_like(commands)
        for e in range(2):
            for i in range(len(TEAM)):
                target = TrackingTarget(
                    setpoint.position[e, i],
                    setpoint.velocity[e, i],
                    setpoint.acceleration[e, i],
                    float(setpoint.yaw[e, i]),
                    float(setpoint.yaw_rate[e, i]),
                )
                expected[e, i] = plain[e][i].commands(
                    state.position[e, i],
                    state.velocity[e, i],
                    state.quaternion[e, i],
                    state.angular_velocity[e, i],
                    target,
                    force[e, i],
                )
        np.testing.assert_allclose(commands, expected, rtol=0, atol=1e-9)
        at_limit = ((commands <= 0) | (commands >= limits)).any(axis=-1)
        saturated += int(at_limit.sum())
        unsaturated += int((~at_limit).sum())
    assert saturated > 500 if wildness == 1.0 else unsaturated > 500


def test_reset_forgets_only_the_masked_environments() -> None:
    one, fresh = (TrackingController(TEAM, num_envs=2) for _ in range(2))
    flight = _RandomFlight(3, 1.0)
    for _ in range(20):
        one.commands(*flight.advance())
    untouched = memory(one)
    assert all(part[e].any() for part in untouched.values() for e in range(2))
    one.reset(np.array([False, True]))
    for name, mine in memory(one).items():
        np.testing.assert_array_equal(mine[0], untouched[name][0])
        assert not mine[1].any()
    arguments = flight.advance()
    a, b = one.commands(*arguments), fresh.commands(*arguments)
    np.testing.assert_array_equal(a[1], b[1])
    assert not np.array_equal(a[0], b[0])
    one.reset()
    assert not any(part.any() for part in memory(one).values())


def test_a_first_step_has_no_kick_from_derivatives() -> None:
    state = hover_state(TEAM, np.ones((4, 3)))
    setpoint = Setpoint.hold(state.position.copy())
    setpoint.velocity[..., 0] = 0.3
    setpoint.yaw[...] = 1.0
    on = TrackingController(TEAM, config=ControllerConfig(lag_compensation=True))
    off = TrackingController(TEAM, config=ControllerConfig(lag_compensation=False))
    np.testing.assert_array_equal(on.commands(state, setpoint), off.commands(state, setpoint))


def test_hover_at_the_setpoint_commands_exactly_the_weight() -> None:
    controller = TrackingController(TEAM)
    state = hover_state(TEAM, np.ones((4, 3)))
    commands = controller.commands(state, Setpoint.hold(state.position.copy()))
    np.testing.assert_allclose(commands, state.rotor_thrust, rtol=1e-14)


@pytest.mark.parametrize(("height", "lift"), [(50.0, 0.0), (0.0, 1.0)])
def test_the_desired_force_never_points_down(height: float, lift: float) -> None:
    """Neither far above the set-point nor under a believed force of three times the weight."""
    state = hover_state(parse_team("S"), [[0.0, 0.0, height]])
    controller = TrackingController(parse_team("S"))
    force = np.array([[[0.0, 0.0, lift]]])
    commands = controller.commands(state, Setpoint.hold(np.zeros((1, 1, 3))), force)
    assert commands.sum() == pytest.approx(0.2 * SMALL.mass * GRAVITY, rel=1e-12)


def test_feedforward_is_subtracted_from_the_thrust() -> None:
    state = hover_state(TEAM, np.ones((4, 3)))
    force = np.zeros((1, 4, 3))
    force[..., 2] = -0.05
    commands = TrackingController(TEAM).commands(state, Setpoint.hold(state.position.copy()), force)
    weight = np.array([v.mass * GRAVITY for v in TEAM])
    np.testing.assert_allclose(commands.sum(-1)[0], weight + 0.05, rtol=1e-12)


def test_the_configured_model_is_asked_for_the_feedforward() -> None:
    class Push:
        """A model that pushes every drone down."""

        name = "push"
        types = ("S", "L")

        def forces(self, position: FloatArray, velocity: FloatArray, team: object) -> FloatArray:
            return np.zeros_like(position) - [0.0, 0.0, 0.05]

    state = hover_state(TEAM, np.ones((4, 3)))
    setpoint = Setpoint.hold(state.position.copy())
    config = ControllerConfig(feedforward=Push())  # type: ignore[arg-type]
    believed = TrackingController(TEAM, config=config).commands(state, setpoint)
    force = np.zeros((1, 4, 3)) - [0.0, 0.0, 0.05]
    given = TrackingController(TEAM).commands(state, setpoint, force)
    np.testing.assert_array_equal(believed, given)


def test_batched_is_the_single_one_to_the_last_bit() -> None:
    both = TrackingController(TEAM, num_envs=2)
    alone = TrackingController(TEAM)
    flight = _RandomFlight(5, 1.0)
    for _ in range(50):
        state, setpoint, force = flight.advance()
        second = SwarmState(*(part[1:] for part in state))
        goal = Setpoint(*(part[1:] for part in setpoint))
        many = both.commands(state, setpoint, force)
        np.testing.assert_array_equal(many[1:], alone.commands(second, goal, force[1:]))


def test_extrapolation_follows_the_cubic_exactly_in_one_environment() -> None:
    rng = np.random.default_rng(0)
    start = Setpoint(*(rng.normal(size=(2, 3, 3)) for _ in range(4)), *rng.normal(size=(2, 2, 3)))
    physics = BatchPhysics("SLS", 2, "none", level=SETPOINTS)
    physics.settings["step"] = 0.1
    drones = physics.world.drones
    moved = Setpoint(*(drones[f"setpoint_{name}"] for name in Setpoint._fields))
    moved.assign(start)
    physics.fly(5, np.array([False, True]))
    t, (p, v, a, j, yaw, yaw_rate) = 0.5, start
    expected = (
        p + v * t + a * t**2 / 2 + j * t**3 / 6,
        v + a * t + j * t**2 / 2,
        a + j * t,
        j,
        yaw + yaw_rate * t,
        yaw_rate,
    )
    for mine, initial, cubic in zip(moved, start, expected, strict=True):
        np.testing.assert_array_equal(mine[0], initial[0])
        np.testing.assert_allclose(mine[1], cubic[1], rtol=0, atol=1e-14)


def test_low_pass_has_its_cutoff() -> None:
    """The discrete filter's step response is the continuous one's at the samples."""
    blend, value = low_pass_blend(20.0, 1 / 240), 0.0
    for k in range(1, 20):
        value += blend * (1.0 - value)
        assert value == pytest.approx(1 - np.exp(-2 * np.pi * 20.0 * k / 240), rel=1e-12)


def test_compiled_gains_hold_the_configuration() -> None:
    config = ControllerConfig(gains=SOFT, lag_compensation=False, rate_yaw=7.0)
    settings = BatchPhysics("S", interactions="none", level=SETPOINTS, controller=config).settings
    for name, value in gains(config).items():
        assert settings[name].tolist() == [value]
    s = settings[0]
    assert (s.position_gain, s.velocity_gain, s.integral_gain) == (1.0, 2.0, 0.5)
    assert (s.lead, s.rate_yaw, s.step) == (0.0, 7.0, 1 / 240)
    with pytest.raises(ValueError, match="dt is 0"):
        gains(ControllerConfig(), dt=0.0)


def test_refused_calls_leave_the_memory_alone() -> None:
    controller = TrackingController((SMALL, LARGE))
    state = hover_state((SMALL, LARGE), np.ones((2, 3)))
    setpoint = Setpoint.hold(state.position.copy())
    controller.commands(state, setpoint)
    before = memory(controller)
    bad = setpoint.copy()
    bad.velocity[0, 1, 2] = np.nan
    with pytest.raises(ValueError, match=r"Setpoint\.velocity is nan at index \(0, 1, 2\)"):
        controller.commands(state, bad)
    with pytest.raises(ValueError, match=r"feedforward has shape \(2, 3\)"):
        controller.commands(state, setpoint, np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"SwarmState\.position has shape \(1, 1, 3\)"):
        controller.commands(hover_state((SMALL,), np.ones((1, 3))), setpoint)
    for name, mine in memory(controller).items():
        np.testing.assert_array_equal(mine, before[name])
    with pytest.raises(ValueError, match="num_envs is 0"):
        TrackingController(TEAM, num_envs=0)
