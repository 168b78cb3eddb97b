"""The compiled references against those of `swarm_envs.trajectories`, and of ellipses in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs import trajectories
from swarm_envs.state import FloatArray
from swarm_envs.tables import SETTINGS_TYPE, World
from swarm_envs.tasks.base import Orbit, Placement, world_of
from swarm_envs.tasks.motion import LINES, ORBITS, REST, WRITERS, Motion, reference_of, stage_at
from swarm_envs.trajectories import Reference

_RAMP = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 2.5, -3.0, 1.0])
"""Time since rest over the ramp's duration: its slope is a quintic step from 0 to 1."""


def ellipse(orbit: Orbit, t: FloatArray, ramp_time: float) -> Reference:
    """center + first cos(angle) + second sin(angle), the rate growing from rest within the ramp."""
    x = np.clip(t / ramp_time, 0.0, 1.0)
    warp = ramp_time * _RAMP(x) + np.maximum(t - ramp_time, 0.0)
    speeds = [_RAMP.deriv(k)(x) / ramp_time ** (k - 1) for k in (1, 2, 3)]
    angle = (orbit.phase + orbit.rate * warp)[..., None]
    w, dw, ddw = ((orbit.rate * speed)[..., None] for speed in speeds)
    radial = orbit.first * np.cos(angle) + orbit.second * np.sin(angle)
    tangent = orbit.second * np.cos(angle) - orbit.first * np.sin(angle)
    return Reference(
        orbit.center + radial,
        tangent * w,
        tangent * dw - radial * w**2,
        tangent * (ddw - w**3) - 3.0 * radial * w * dw,
    )


TIMES = np.linspace(-0.5, 7.0, 64)
N = 3


def written(world: World, motion: Motion) -> Reference:
    """The reference of an environment at all times: arrays (T, N, 3)."""
    settings = np.zeros(1, SETTINGS_TYPE)
    for name, value in motion.settings().items():
        settings[name] = value
    rows = []
    for time in TIMES:
        world.environments["time"] = time
        WRITERS[motion.kind](*world, settings)
        rows.append([array[0].copy() for array in reference_of(world.drones)])
    return Reference(*(np.array(column) for column in zip(*rows, strict=True)))


def check_close(ours: Reference, theirs: Reference) -> None:
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-12, atol=1e-12)


def legs(duration: float, stages: int = 1) -> tuple[World, FloatArray]:
    rng = np.random.default_rng(1)
    start, goals = rng.normal(size=(N, 3)), rng.normal(size=(stages, N, 3))
    world = world_of(Placement(start, goals, duration))
    return world, np.concatenate([start[None], goals])


@pytest.mark.parametrize("ramp", [0.2, 0.5])
def test_lines(ramp):
    world, (start, goal) = legs(3.0)
    theirs = trajectories.ramped_line(start, goal, 3.0, TIMES[:, None], ramp)
    ours = written(world, Motion(LINES, ramp))
    check_close(ours, theirs)
    np.testing.assert_array_equal(ours.position[-1], goal)


def test_lines_from_stage_to_stage():
    world, corners = legs(1.5, stages=3)
    ours = written(world, Motion(LINES, 0.5, stage_s=2.0))
    for k, time in enumerate(TIMES):
        stage = int(np.clip(time // 2.0, 0, 2))
        here, there = corners[stage], corners[stage + 1]
        theirs = trajectories.ramped_line(here, there, 1.5, time - 2.0 * stage, 0.5)
        check_close(Reference(*(array[k] for array in ours)), theirs)


def test_rest_is_at_the_goals_of_the_stage():
    world, corners = legs(0.0, stages=3)
    for kind in (REST, LINES):  # lines that take no time are none
        ours = written(world, Motion(kind, 0.5, stage_s=2.0))
        stage = np.clip(TIMES // 2.0, 0, 2).astype(int)
        np.testing.assert_array_equal(ours.position, corners[1 + stage])
        np.testing.assert_array_equal(np.array(ours[1:]), 0.0)


def test_orbits():
    rng = np.random.default_rng(2)
    center, first, second = rng.normal(size=(3, N, 3))
    rate, phase = rng.normal(size=(2, N))
    orbit = Orbit(center, first, second, rate, phase)
    world = world_of(Placement(center + first, center[None], 0.0, orbit))
    theirs = ellipse(orbit, TIMES[:, None], ramp_time=2.0)
    check_close(written(world, Motion(ORBITS, 2.0)), theirs)


@pytest.mark.parametrize(("time", "stage"), [(0.0, 0), (5.99, 0), (6.0, 1), (17.9, 2), (99.0, 2)])
def test_stages_change_by_the_clock(time, stage):
    assert stage_at(time, 6.0, 3) == stage
    assert stage_at(time, 0.0, 1) == 0
    # a clock that counts decisions meets the boundary in spite of rounding
    assert stage_at(sum([0.1] * 60), 6.0, 3) == 1
