"""The compiled tracking loop against the plain one, its memory, and its configuration."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.control.config import (
    MID,
    STIFF,
    ControllerConfig,
    low_pass_blend,
)
from swarm_envs.control.tracking import TrackingController
from swarm_envs.state import FloatArray, Setpoint, hover_state
from swarm_envs.vehicles import GRAVITY, LARGE, SMALL, parse_team
from tests.helpers.numpy_controller import (
    NumpyTrackingController,
    TrackingTarget,
)
from tests.helpers.random_flights import RandomFlight

TEAM = parse_team("SLS*L")
MEMORY = (
    *("velocity_integral", "rate_integral", "desired_thrust", "thrust_rate", "rate_error"),
    *("rate_error_rate", "desired_attitude", "desired_rate", "started"),
)
"""What the loop remembers from step to step."""


def memory(controller: TrackingController) -> dict[str, FloatArray]:
    drones = controller._loop.world.drones
    return {name: drones[name].copy() for name in MEMORY}


@pytest.mark.parametrize("lag_compensation", [True, False])
@pytest.mark.parametrize(("wildness", "stiffness"), [(0.03, MID), (1.0, STIFF)])
def test_compiled_agrees_with_plain(lag_compensation, wildness, stiffness):
    config = ControllerConfig(gains=stiffness, lag_compensation=lag_compensation)
    compiled = TrackingController(TEAM, num_envs=2, config=config)
    plain = [[NumpyTrackingController(v, config) for v in TEAM] for _ in range(2)]
    flight = RandomFlight(TEAM, 7, wildness)
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
