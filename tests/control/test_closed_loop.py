"""The tracking loop in flight, on the compiled engine.

Expected numbers are those of an independent prototype of the same loop: rise and overshoot of a
step, worst height error under a wake, overshoot after a long push.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.control.config import GAINS, INTEGRAL_LIMIT, ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics import BatchPhysics
from swarm_envs.state import FloatArray, Setpoint, hover_state
from swarm_envs.trajectories import Reference, ramped_line
from swarm_envs.vehicles import GRAM_FORCE, Team, parse_team

DT = 1.0 / 240.0
WAKE = load("wake")


class Flight(NamedTuple):
    """One row per step."""

    error: FloatArray  # (T, N, 3) position minus reference, m
    rotation: FloatArray  # (T, N, 3, 3) body to world
    commands: FloatArray  # (T, N, 4) N


def fly(
    team: Team,
    reference: Callable[[float], Reference],
    seconds: float,
    *,
    config: ControllerConfig | None = None,
    push: Callable[[float], float] = lambda t: 0.0,
    interactions: str | InteractionModel = "none",
    yaw: Callable[[float], tuple[float, float]] = lambda t: (0.0, 0.0),
    tilt: float = 0.0,
    actual: Team | None = None,
) -> Flight:
    """Fly a team along a reference from hover, tilted about x by an angle, rad, at first."""
    controller = TrackingController(team, config=config)
    physics = BatchPhysics(team if actual is None else actual, interactions=interactions)
    state = hover_state(team, reference(0.0).position)
    state.quaternion[..., 0], state.quaternion[..., 3] = np.sin(tilt / 2), np.cos(tilt / 2)
    state = physics.reset(state)
    force = np.zeros((1, len(team), 3))
    rows = []
    for step in range(round(seconds / DT)):
        at = reference(step * DT)
        angle, rate = yaw(step * DT)
        setpoint = Setpoint.hold(at.position[None])
        setpoint.velocity[...], setpoint.acceleration[...] = at.velocity, at.acceleration
        setpoint.yaw[...], setpoint.yaw_rate[...] = angle, rate
        commands = controller.commands(state, setpoint)
        rotation = Rotation.from_quat(state.quaternion[0].copy()).as_matrix()
        rows.append((state.position[0] - at.position, rotation, commands[0].copy()))
        force[..., 2] = push(step * DT)
        state = physics.step(commands, force)
    return Flight(*(np.array(column) for column in zip(*rows, strict=True)))


def rest_at(*points: npt.ArrayLike) -> Callable[[float], Reference]:
    place = np.array(points)
    return lambda t: Reference(place, *(np.zeros_like(place),) * 3)


def swap(team: Team, seconds: float) -> Callable[[float], Reference]:
    """A stacked swap: through the middle of a circle, a quarter of a metre between planes."""
    count = len(team)
    angle = 0.3 + 2 * np.pi * np.arange(count) / count
    height = 0.8 + 0.25 * np.arange(count)[::-1]
    start = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), height], axis=-1)
    goal = start * [-1.0, -1.0, 1.0]
    return lambda t: ramped_line(start, goal, seconds, t)


def worst_height_error(token: str, feedforward: InteractionModel | None) -> float:
    """Worst height error of the lowest drone of a team that swaps places in 4 s, m."""
    team, config = parse_team(token), ControllerConfig(feedforward=feedforward)
    flight = fly(team, swap(team, 4.0), 5.0, config=config, interactions=WAKE)
    return float(np.abs(flight.error[:, -1, 2]).max())


def step_response(
    team: Team, axes: list[int], gains: str, seconds: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Each drone's answer to a step of 10 cm along its axis.

    Times from 10 to 90 %, s; overshoots and last errors as shares of the step: (N,) each.
    """
    count = len(team)
    start = np.array([[float(i), 0.0, 1.0] for i in range(count)])
    goal = start + 0.1 * np.eye(3)[axes]
    before, after = rest_at(*start), rest_at(*goal)
    config = ControllerConfig(gains=GAINS[gains])
    flight = fly(team, lambda t: after(t) if t > 0 else before(t), seconds, config=config)
    share = 1 + flight.error[1:, np.arange(count), axes] / 0.1
    rise = (np.argmax(share > 0.9, axis=0) - np.argmax(share > 0.1, axis=0)) * DT
    return rise, share.max(axis=0) - 1, share[-1] - 1


def test_a_step_rises_in_its_time_with_little_overshoot() -> None:
    rise, overshoot, last = step_response(parse_team("SSSLLL"), [0, 1, 2] * 2, "mid", 8.0)
    assert 1.1 < rise.min() <= rise.max() < 1.5
    assert 0.03 < overshoot.min() <= overshoot.max() < 0.09
    assert np.abs(last).max() < 0.02


def test_stiffer_gains_rise_faster() -> None:
    rises = [step_response(parse_team("S"), [2], gains, 3.0)[0] for gains in GAINS]
    assert rises[0] > 1.2 * rises[1] > 1.44 * rises[2]


def test_hover_recovers_from_a_wrong_mass() -> None:
    """The integral removes what the model does not know."""
    heavy = (replace(parse_team("S")[0], mass=0.0341),)
    flight = fly(parse_team("S"), rest_at((0.0, 0.0, 1.0)), 10.0, actual=heavy)
    assert np.abs(flight.error).max() > 0.003
    assert np.abs(flight.error[-1]).max() < 0.001


def push_overshoot(limit: float) -> float:
    """Overshoot, m, after a 36 g push down for 1.5 s, more than the motors can hold."""

    def push(t: float) -> float:
        return -36 * GRAM_FORCE * (1.0 <= t < 2.5)

    config = ControllerConfig(velocity_integral_limit=limit)
    flight = fly(parse_team("S"), rest_at((0.0, 0.0, 9.0)), 6.5, config=config, push=push)
    assert flight.error[..., 2].min() < -1.0
    return float(flight.error[..., 2].max())


def test_a_long_push_does_not_wind_the_integral_up() -> None:
    assert push_overshoot(0.05) < 0.01
    assert 0.05 < push_overshoot(INTEGRAL_LIMIT) < 0.3
    assert push_overshoot(1e6) > 1.0


@pytest.mark.parametrize(
    ("token", "least", "most"),
    [("L2S", 0.13, 0.21), ("S2S", 0.03, np.inf), ("S2L", 0.03, np.inf), ("SS2L", 0.03, np.inf)],
)
def test_a_wake_is_felt_without_feedforward_and_not_with_the_exact_one(
    token: str, least: float, most: float
) -> None:
    plain = worst_height_error(token, None)
    assert least < plain < most
    assert worst_height_error(token, WAKE) < min(0.01, 0.1 * plain)


@pytest.mark.parametrize("lag_compensation", [True, False])
def test_yaw_turns_and_then_follows_its_rate(lag_compensation: bool) -> None:
    def yaw(t: float) -> tuple[float, float]:
        return (1.2, 0.0) if t < 4 else (1.2 + 0.8 * (t - 4), 0.8)

    config = ControllerConfig(lag_compensation=lag_compensation)
    flight = fly(parse_team("S"), rest_at((0.0, 0.0, 1.0)), 8.0, config=config, yaw=yaw)
    heading = np.unwrap(np.arctan2(flight.rotation[:, 0, 1, 0], flight.rotation[:, 0, 0, 0]))
    time = DT * (1 + np.arange(len(heading)))
    wanted = np.array([yaw(t)[0] for t in time])
    assert heading.max() < wanted.max() + 0.01
    assert 0.5 < time[np.argmax(heading > 0.9 * 1.2)] < 1.5
    assert abs(heading[time < 4][-1] - 1.2) < 0.02
    assert np.abs(heading - wanted)[time > 6].max() < 0.02
    assert np.abs(flight.error).max() < 1e-9


@pytest.mark.parametrize("lag_compensation", [True, False])
def test_recovery_from_a_steep_tilt(lag_compensation: bool) -> None:
    config = ControllerConfig(lag_compensation=lag_compensation)
    places = rest_at((0.0, 0.0, 2.0), (1.0, 0.0, 2.0))
    flight = fly(parse_team("SL"), places, 7.0, config=config, tilt=np.radians(60))
    tilt = np.degrees(np.arccos(np.clip(flight.rotation[..., 2, 2], -1, 1)))
    # Back to within the tilt that flying home takes, then home.
    assert tilt[round(0.5 / DT) :].max() < 30
    assert tilt[round(3.0 / DT) :].max() < 4
    assert np.abs(flight.error).max() < 0.6
    assert np.abs(flight.error[-1]).max() < 0.03


def test_recovery_from_upside_down_with_a_slight_lean() -> None:
    flight = fly(parse_team("S"), rest_at((0.0, 0.0, 6.0)), 8.0, tilt=np.radians(170))
    assert flight.rotation[-1, 0, 2, 2] > 0.999
    assert np.abs(flight.error[-1]).max() < 0.05


@pytest.mark.parametrize(
    ("gains", "lag_compensation"),
    [("soft", True), ("soft", False), ("mid", True), ("mid", False), ("stiff", True)],
)
def test_hover_settles_without_a_limit_cycle(gains: str, lag_compensation: bool) -> None:
    config = ControllerConfig(gains=GAINS[gains], lag_compensation=lag_compensation)
    places = rest_at((0.0, 0.0, 1.0), (1.0, 0.0, 1.0))
    flight = fly(parse_team("SL"), places, 9.0, config=config, tilt=np.radians(10))
    late = flight.rotation[-240:, :, 2, 2]
    assert np.degrees(np.arccos(np.clip(late, -1, 1))).max() < 0.2
    assert np.ptp(flight.commands[-240:], axis=0).max() < 0.1 * GRAM_FORCE
    assert np.abs(flight.error[-1]).max() < 0.003
