"""Reference trajectories: exact derivatives, rest at the ends, broadcasting, refusals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference, ramped_line, rest_to_rest

START, GOAL, DURATION = np.array([0.5, -0.2, 1.0]), np.array([-0.4, 0.6, 1.3]), 3.0

Motion = Callable[[FloatArray], Reference]

MOTIONS: dict[str, Motion] = {
    "rest_to_rest": lambda t: rest_to_rest(START, GOAL, DURATION, t),
    "ramped_line": lambda t: ramped_line(START, GOAL, DURATION, t),
    "ramped_line, all ramp": lambda t: ramped_line(START, GOAL, DURATION, t, ramp=0.5),
}

motions = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS.keys())


@motions
def test_each_derivative_is_the_slope_of_the_one_before(motion: Motion) -> None:
    t = np.linspace(-0.5, DURATION + 0.5, 801) + 1e-3
    h = 1e-4
    before, at, after = motion(t - h), motion(t), motion(t + h)
    for order in range(3):
        slope = (after[order] - before[order]) / (2 * h)
        # The jerk has corners where ramps begin and end: central differences there are off by h.
        tolerance = 2e-6 if order < 2 else 2e-2
        np.testing.assert_allclose(slope, at[order + 1], rtol=0, atol=tolerance)


@motions
def test_jerk_is_continuous(motion: Motion) -> None:
    t = np.linspace(-0.5, DURATION + 0.5, 40001)
    jerk = motion(t).jerk
    assert np.abs(np.diff(jerk, axis=0)).max() < 0.01 * np.abs(jerk).max()


@pytest.mark.parametrize("name", ["rest_to_rest", "ramped_line", "ramped_line, all ramp"])
@pytest.mark.parametrize(("t", "place"), [(-1.0, START), (0.0, START), (3.0, GOAL), (9.0, GOAL)])
def test_lines_rest_exactly_at_their_ends(name: str, t: float, place: FloatArray) -> None:
    at = MOTIONS[name](np.array(t))
    np.testing.assert_array_equal(at.position, place)
    for part in at[1:]:
        np.testing.assert_array_equal(part, 0.0)


def test_rest_to_rest_is_half_way_at_half_time_with_the_known_peak_speed() -> None:
    at = rest_to_rest(START, GOAL, DURATION, DURATION / 2)
    np.testing.assert_allclose(at.position, (START + GOAL) / 2, atol=1e-15)
    np.testing.assert_allclose(at.velocity, 140 / 64 * (GOAL - START) / DURATION, rtol=1e-14)


def test_ramped_line_holds_its_speed_between_the_ramps() -> None:
    t = np.linspace(0.2, 0.8, 50) * DURATION
    speed = (GOAL - START) / (0.8 * DURATION)
    at = ramped_line(START, GOAL, DURATION, t)
    np.testing.assert_allclose(at.velocity, np.broadcast_to(speed, (50, 3)), rtol=1e-13)
    np.testing.assert_allclose(at.acceleration, 0.0, atol=1e-13)


def test_times_and_teams_broadcast() -> None:
    rng = np.random.default_rng(0)
    starts, goals = rng.normal(size=(2, 4, 3)), rng.normal(size=(2, 4, 3))
    durations, times = rng.uniform(2, 4, (2, 1)), rng.uniform(0, 4, (2, 1))
    for function in (rest_to_rest, ramped_line):
        batch = function(starts, goals, durations, times)
        for e in range(2):
            for i in range(4):
                one = function(starts[e, i], goals[e, i], durations[e, 0], times[e, 0])
                for many, single in zip(batch, one, strict=True):
                    assert many.shape == (2, 4, 3)
                    np.testing.assert_array_equal(many[e, i], single)
                    assert many.flags.writeable


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rest_to_rest(START, GOAL, 0.0, 1.0), "duration is 0.0"),
        (lambda: rest_to_rest(START[:2], GOAL, 1.0, 1.0), r"start has shape \(2,\)"),
        (lambda: ramped_line(START, GOAL * np.nan, 1.0, 1.0), "goal is .*nan"),
        (lambda: ramped_line(START, GOAL, 1.0, 1.0, ramp=0.6), "ramp is 0.6"),
    ],
)
def test_bad_arguments_are_refused(call: Callable[[], Reference], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
