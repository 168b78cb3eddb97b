"""The compiled tracking loop against the equations, its memory, and its configuration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.control.config import (
    STIFF,
    ControllerConfig,
    Indi,
    MomentumObserver,
    NeuralFly,
    low_pass_blend,
)
from swarm_envs.control.tracking import TrackingController
from swarm_envs.reference import State, followed, held, hovering, multiply
from swarm_envs.reference_numbers import bodies_of, gains_of
from swarm_envs.state import FloatArray, Setpoint, SwarmState, hover_state
from swarm_envs.vehicles import GRAVITY, LARGE, SMALL, Team, parse_team
from tests.helpers.plain_adaptation import PlainAdaptation

TEAM = parse_team("SLS*L")
ADAPTATIONS = (MomentumObserver(), Indi(), NeuralFly())
QUICK = (MomentumObserver(20.0), Indi(20.0), NeuralFly(force_drift=10.0, cutoff_hz=20.0))
"""They reach the limit of one weight in wild flights."""
MEMORY = (
    *("velocity_integral", "rate_integral", "desired_thrust", "thrust_rate", "rate_error"),
    *("rate_error_rate", "desired_attitude", "desired_rate", "started"),
    *("adaptive_force", "adaptive_coefficients", "adaptive_covariance", "last_velocity"),
)
"""Memory of the loop from step to step."""


class RandomFlight:
    """Smooth random states and set-points with noise on top, for two environments of a team."""

    def __init__(self, team: Team, seed: int, wildness: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.wildness = wildness
        self.shape = (2, len(team))
        self.state = hover_state(team, self.rng.normal(size=(*self.shape, 3)))
        self.setpoint = Setpoint.hold(self.state.position.copy())
        self.walk = np.zeros((*self.shape, 3))

    def advance(self) -> tuple[SwarmState, Setpoint, FloatArray]:
        """State, set-point and believed force (2, N, 3), N, one step later."""
        rng, shape, wild = self.rng, self.shape, self.wildness
        self.walk += 0.05 * (wild * rng.normal(size=self.walk.shape) - self.walk)
        s, sp = self.state, self.setpoint
        s.velocity[...] = self.walk + 0.03 * rng.normal(size=self.walk.shape)
        s.position[...] += s.velocity / 240
        s.angular_velocity[...] = 2 * wild * rng.normal(size=self.walk.shape)
        step = np.concatenate([s.angular_velocity / 480, np.ones((*shape, 1))], axis=-1)
        s.quaternion[...] = multiply(step, s.quaternion)
        s.quaternion[...] /= np.linalg.norm(s.quaternion, axis=-1, keepdims=True)
        s.quaternion[...] *= rng.choice([-1.0, 1.0], size=(*shape, 1))
        sp.velocity[...] = 0.1 * wild * rng.normal(size=self.walk.shape)
        sp.acceleration[...] = wild * rng.normal(size=self.walk.shape)
        sp.yaw_rate[...] = wild * rng.normal(size=shape)
        sp.yaw[...] += sp.yaw_rate / 240 + (rng.uniform(size=shape) < 0.01) * rng.normal(size=shape)
        return s, sp, 0.03 * wild * rng.normal(size=self.walk.shape)


def memory(controller: TrackingController) -> dict[str, FloatArray]:
    drones = controller._loop.world.drones
    return {name: drones[name].copy() for name in MEMORY}


CONFIGS = {
    **{f"{lag}, calm": (0.03, ControllerConfig(lag_compensation=lag)) for lag in (True, False)},
    **{f"{lag}, wild": (1.0, ControllerConfig(STIFF, None, lag)) for lag in (True, False)},
    **{
        f"adaptive, {wildness}, {type(law).__name__}": (wildness, ControllerConfig(adaptation=law))
        for wildness, laws in ((0.03, ADAPTATIONS), (3.0, QUICK))
        for law in laws
    },
}


@pytest.mark.parametrize(("wildness", "config"), CONFIGS.values(), ids=CONFIGS)
def test_compiled_agrees_with_the_equations(wildness: float, config: ControllerConfig) -> None:
    compiled, body = TrackingController(TEAM, 2, config), bodies_of(TEAM)
    gains = gains_of(replace(config, adaptation=None))
    places = list(np.ndindex(2, len(TEAM))) if config.adaptation else []
    adaptive = {at: PlainAdaptation(TEAM[at[1]], config) for at in places}
    drones, memory = compiled._loop.world.drones, hovering(np.zeros((2, len(TEAM), 3)), body)
    flight, commands = RandomFlight(TEAM, 7, wildness), drones["commands"].copy()
    limits = np.array([v.max_rotor_thrust for v in TEAM])[:, None]
    saturated = limited = 0
    for _ in range(150):
        state, setpoint, force = flight.advance()
        last, commands = commands, compiled.commands(state, setpoint, force)
        more = np.zeros_like(force)
        for at in places:
            p, v, q = (array[at] for array in state[:3])
            aims = setpoint.position[at].copy(), setpoint.velocity[at].copy()
            more[at] = adaptive[at].force(p, v, q, last[at], force[at], aims)
            limited += int((abs(more[at]) >= 0.999 * TEAM[at[1]].mass * GRAVITY).any())
        if places:
            np.testing.assert_allclose(drones["adaptive_force"], more, rtol=0, atol=1e-9)
        memory = State._make([*(array.copy() for array in state[:5]), *memory[5:]])
        memory, asked = followed(memory, setpoint, force + more, body, gains)
        memory, expected = held(memory, asked, body, gains)
        np.testing.assert_allclose(commands, expected, rtol=0, atol=1e-9)
        saturated += int(((commands <= 0) | (commands >= limits)).any(axis=-1).sum())
    assert (limited > 0) == (wildness == 3.0)
    if not places:
        assert saturated > 250 if wildness == 1.0 else saturated < 150 * 2 * len(TEAM) - 250


def test_a_set_point_moves_on_by_its_derivatives_until_the_next_step() -> None:
    controller, rng, shape = TrackingController(TEAM), np.random.default_rng(5), (1, len(TEAM), 3)
    state = hover_state(TEAM, rng.normal(size=shape[1:]))
    moments = {name: rng.normal(size=shape) for name in ("velocity", "acceleration", "jerk")}
    turn = {"yaw": rng.normal(size=shape[:2]), "yaw_rate": rng.normal(size=shape[:2])}
    controller.commands(state, Setpoint.hold(state.position.copy())._replace(**moments, **turn))
    v, a, j, t = *moments.values(), 1.0 / 240.0
    expected = {
        "position": state.position + v * t + a * t**2 / 2 + j * t**3 / 6,
        "velocity": v + a * t + j * t**2 / 2,
        "acceleration": a + j * t,
        "jerk": j,
        "yaw": turn["yaw"] + turn["yaw_rate"] * t,
    }
    for name, value in expected.items():
        moved = controller._loop.world.drones[f"setpoint_{name}"]
        np.testing.assert_allclose(moved, value, rtol=0, atol=1e-14)


def test_reset_forgets_only_the_masked_environments() -> None:
    config = ControllerConfig(adaptation=NeuralFly())
    one, fresh = (TrackingController(TEAM, 2, config) for _ in range(2))
    flight = RandomFlight(TEAM, 3, 1.0)
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


@pytest.mark.parametrize(("height", "lift"), [(50.0, 0.0), (0.0, 1.0)])
def test_the_desired_force_never_points_down(height: float, lift: float) -> None:
    """Neither far above the set-point nor under a believed force of three times the weight."""
    state = hover_state(parse_team("S"), [[0.0, 0.0, height]])
    controller = TrackingController(parse_team("S"))
    force = np.array([[[0.0, 0.0, lift]]])
    commands = controller.commands(state, Setpoint.hold(np.zeros((1, 1, 3))), force)
    assert commands.sum() == pytest.approx(0.2 * SMALL.mass * GRAVITY, rel=1e-12)


def test_low_pass_has_its_cutoff() -> None:
    """The discrete filter's step response is the continuous one's at the samples."""
    blend, value = low_pass_blend(20.0, 1 / 240), 0.0
    for k in range(1, 20):
        value += blend * (1.0 - value)
        assert value == pytest.approx(1 - np.exp(-2 * np.pi * 20.0 * k / 240), rel=1e-12)


def test_bad_calls_are_refused() -> None:
    controller = TrackingController((SMALL, LARGE))
    state = hover_state((SMALL, LARGE), np.ones((2, 3)))
    setpoint = Setpoint.hold(state.position.copy())
    bad = setpoint.copy()
    bad.velocity[0, 1, 2] = np.nan
    with pytest.raises(ValueError, match=r"Setpoint\.velocity is nan at index \(0, 1, 2\)"):
        controller.commands(state, bad)
    with pytest.raises(ValueError, match=r"feedforward has shape \(2, 3\)"):
        controller.commands(state, setpoint, np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"SwarmState\.position has shape \(1, 1, 3\)"):
        controller.commands(hover_state((SMALL,), np.ones((1, 3))), setpoint)
    assert not any(part.any() for part in memory(controller).values())
    with pytest.raises(ValueError, match="num_envs is 0"):
        TrackingController(TEAM, num_envs=0)
