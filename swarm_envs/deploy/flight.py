"""The flight of a team as curves in time: from a recording, a plan, or arrays; checked by name.

Ramps before and behind a flight make it begin and end at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from swarm_envs.arguments import POSITIVE_S, OneOf, Range, typed
from swarm_envs.state import FloatArray
from swarm_envs.trajectories import Reference
from swarm_envs.vehicles import Team, parse_team
from swarm_envs.viewing.record import About, Recording

PATHS = ("flown", "setpoint")
"""What of a recording is exported: where drones were, or where the tracking loop wanted them."""
LONGEST_STEP_S = 0.25
"""Longest time between samples: where a drone was in a longer gap is not known, s."""
SHORTEST_S = 0.5  # Shorter flights are none, s
LONGEST_S = 3600.0  # Longest flight along a plan, s
YAWS = ("hold", "flown")
"""Yaw of a recording: as at the start throughout, or as it was, wobble included."""
AT_REST = 0.02  # Below this speed a drone counts as standing still, m/s
RATE = 200.0  # Points a second at which curves are compared
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Flight:
    """Motions of N drones, sampled T times. World frame, SI.

    Args:
        team: the N vehicles.
        time: (T,) s, increasing.
        position: (T, N, 3) m.
        velocity: (T, N, 3) m/s, or None where it is not known.
        yaw: (T, N) rad, or None for zero.
        force: (T, N, 3) force of the air beyond thrust, N, or None for none.
        about: what the episode was, if it was one.

    Raises:
        ValueError: shapes that do not fit, NaN, a time that does not increase, a gap, or a flight
            that is too short; the message names the drone and the time.
    """

    team: Team
    time: FloatArray
    position: FloatArray
    velocity: FloatArray | None = None
    yaw: FloatArray | None = None
    force: FloatArray | None = None
    about: About | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be flown."""
        object.__setattr__(self, "team", parse_team(self.team))
        time = np.asarray(self.time, dtype=np.float64)
        if time.ndim != 1:
            raise ValueError(f"time has shape {time.shape}, but must be (T,)")
        object.__setattr__(self, "time", time)
        drones = len(self.team)
        for name, shape in (("position", (3,)), ("velocity", (3,)), ("yaw", ()), ("force", (3,))):
            if getattr(self, name) is not None:
                self._check(name, (len(time), drones, *shape))
        _check_time(time)

    def _check(self, name: str, shape: tuple[int, ...]) -> None:
        array = np.asarray(getattr(self, name), dtype=np.float64)
        if array.shape != shape:
            raise ValueError(f"{name} has shape {array.shape}, but must have {shape}")
        if not np.isfinite(array).all():
            t, i = (int(n) for n in np.argwhere(~np.isfinite(array))[0][:2])
            raise ValueError(
                f"{name} of drone_{i} is {array[t, i]} at sample {t}; leave the flight out, or cut "
                "it before that"
            )
        object.__setattr__(self, name, array)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the N drones, as environments call them."""
        return tuple(f"drone_{i}" for i in range(len(self.team)))

    @property
    def duration_s(self) -> float:
        """From the first sample to the last, s."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def dense_time(self) -> FloatArray:
        """(D,) times since the first sample, at `RATE` and at the end, s."""
        count = max(int(np.ceil(self.duration_s * RATE)), 1)
        return np.linspace(0.0, self.duration_s, count + 1)

    @cached_property
    def curve(self) -> Any:
        """Position (N, 3) as a function of time since the first sample, through every sample."""
        from scipy.interpolate import CubicHermiteSpline, CubicSpline

        time = self.time - self.time[0]
        if self.velocity is None:
            return CubicSpline(time, self.position)
        return CubicHermiteSpline(time, self.position, self.velocity)

    @cached_property
    def dense_position(self) -> FloatArray:
        """(D, N, 3) m."""
        return np.asarray(self.curve(self.dense_time))

    def rows(self, drone: int) -> FloatArray:
        """(D, 4) x, y, z (m) and yaw (rad, without jumps by a turn) of a drone, densely."""
        yaw = np.zeros(len(self.dense_time))
        if self.yaw is not None:
            turned = np.unwrap(self.yaw[:, drone])
            yaw = np.interp(self.dense_time, self.time - self.time[0], turned)
        return np.column_stack([self.dense_position[:, drone], yaw])

    def forces(self, drone: int) -> FloatArray:
        """(D, 3) force of the air on a drone, densely, N; zero where it is not known."""
        if self.force is None:
            return np.zeros((len(self.dense_time), 3))
        time = self.time - self.time[0]
        return np.column_stack(
            [np.interp(self.dense_time, time, self.force[:, drone, k]) for k in range(3)]
        )

    @cached_property
    def end_speeds(self) -> FloatArray:
        """(2, N) speed at the start and at the end, m/s."""
        return np.asarray(np.linalg.norm(self.curve([0.0, self.duration_s], 1), axis=-1))

    def part(self, begin_s: float, end_s: float) -> Flight:
        """What was flown between two times since the first sample, at the samples between them.

        Raises:
            ValueError: there is no flight between them.
        """
        since = self.time - self.time[0]
        inside = (since >= begin_s - _ROUNDING) & (since <= end_s + _ROUNDING)
        return replace(self, **self._each(lambda array: array[inside]))

    def _each(self, change: Callable[[FloatArray], FloatArray]) -> dict[str, Any]:
        """Every array that is known, changed, by its name."""
        names = ("time", "position", "velocity", "yaw", "force")
        known = {name: getattr(self, name) for name in names}
        return {name: change(array) for name, array in known.items() if array is not None}


@typed
def flight_of(
    recording: Recording,
    path: Annotated[str, OneOf(PATHS)] = "flown",
    yaw: Annotated[str, OneOf(YAWS)] = "hold",
) -> Flight:
    """The flight that an episode's record holds.

    Args:
        recording: of an episode.
        path: `flown`, or `setpoint` for what the tracking loop was asked for.
        yaw: `hold` for that of the start throughout, or `flown`.

    Raises:
        ValueError: another path or yaw, or a record that is no flight.
    """
    x, y, z, w = np.moveaxis(recording.quaternion, -1, 0)
    turned = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    flight = Flight(
        team=recording.team,
        time=recording.time,
        position=recording.position,
        velocity=recording.velocity,
        yaw=turned if yaw == "flown" else np.repeat(turned[:1], len(turned), axis=0),
        force=recording.force,
        about=recording.about,
    )
    return flight if path == "flown" else _along_setpoints(flight, recording.setpoint)


def _along_setpoints(flight: Flight, setpoint: FloatArray) -> Flight:
    """Between decisions set-points are cubic, and begin and end as fast as the drones."""
    from scipy.interpolate import CubicSpline

    assert flight.velocity is not None
    asked = replace(flight, position=setpoint)  # checked before a spline is drawn through it
    ends = tuple((1, flight.velocity[k]) for k in (0, -1))
    spline = CubicSpline(flight.time, setpoint, bc_type=ends)
    return replace(asked, velocity=spline(flight.time, 1))


@typed
def flight_along(
    reference: Callable[[float], Reference],
    duration_s: Annotated[float, Range(SHORTEST_S, LONGEST_S, unit="s")],
    team: str | Team,
    rate: Annotated[float, Range(1.0 / LONGEST_STEP_S, 1000.0, unit="Hz")] = RATE,
) -> Flight:
    """The flight that a plan asks for.

    Args:
        reference: where the N drones should be at a time, s, such as `SwarmPlan.reference`.
        duration_s: of the plan, s.
        team: the vehicles.
        rate: samples a second.

    Raises:
        ValueError: a duration or rate out of its range, or a reference that is not finite.
    """
    time = np.linspace(0.0, duration_s, int(np.ceil(duration_s * rate)) + 1)
    # At the end itself a plan may say that all is over.
    samples = [reference(min(t, duration_s * (1.0 - 1e-12))) for t in time]
    position, velocity = (np.array([sample[k] for sample in samples]) for k in (0, 1))
    return Flight(parse_team(team), time, position, velocity)


def _check_time(time: npt.NDArray[np.float64]) -> None:
    if not np.isfinite(time).all():
        k = int(np.argmin(np.isfinite(time)))
        raise ValueError(f"time is {time[k]} at sample {k}, but must be finite")
    steps = np.diff(time)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise ValueError(
            f"time does not increase: sample {k} is at {time[k]:g} s, the next at {time[k + 1]:g} s"
        )
    if len(time) < 4 or time[-1] - time[0] < SHORTEST_S:
        length = float(time[-1] - time[0]) if len(time) else 0.0
        raise ValueError(
            f"the flight has {len(time)} samples over {length:g} s, but must have at least 4 over "
            f"{SHORTEST_S} s"
        )
    if steps.max() > LONGEST_STEP_S:
        k = int(np.argmax(steps))
        raise ValueError(
            f"there is a gap of {steps[k]:.3g} s after {time[k]:g} s, but samples must be at most "
            f"{LONGEST_STEP_S} s apart: positions in between are unknown"
        )


_RATE = 50.0


@typed
def settled(flight: Flight, seconds: Annotated[float, POSITIVE_S]) -> Flight:
    """A flight whose drones are brought from rest before it, and to rest after it.

    The ramps are polynomials of 5th degree, over half of what the speed at that end would cover in
    their time; they replace nothing that was flown. Yaw and force stay as they are at the ends. At
    an end where all drones stand still there is none.

    Args:
        flight: of N drones.
        seconds: duration of each ramp, s.

    Raises:
        ValueError: the duration is not positive.
    """
    first, last = flight.end_speeds.max(axis=1)
    if last > AT_REST:
        flight = _with_ramp(flight, seconds)
    if first > AT_REST:
        flight = _reversed(_with_ramp(_reversed(flight), seconds))
    return flight


def _with_ramp(flight: Flight, seconds: float) -> Flight:
    from scipy.interpolate import BPoly

    slopes = [flight.curve(flight.duration_s, order) for order in (1, 2)]
    there = flight.position[-1] + 0.5 * seconds * slopes[0]
    still = np.zeros_like(there)
    rows = np.array([[flight.position[-1], *slopes], [there, still, still]])
    ramp = BPoly.from_derivatives([0.0, seconds], rows)
    steps = np.linspace(0.0, seconds, max(int(np.ceil(seconds * _RATE)), 2) + 1)[1:]

    longer = flight._each(
        lambda array: np.concatenate([array, np.repeat(array[-1:], len(steps), axis=0)])
    )
    known = flight.velocity
    if known is None:
        known = flight.curve(flight.time - flight.time[0], 1)
    longer["time"] = np.concatenate([flight.time, flight.time[-1] + steps])
    longer["position"] = np.concatenate([flight.position, ramp(steps)])
    longer["velocity"] = np.concatenate([known, ramp(steps, 1)])
    return replace(flight, **longer)


def _reversed(flight: Flight) -> Flight:
    """Backwards in time."""
    arrays = flight._each(lambda array: array[::-1])
    arrays |= {name: -arrays[name] for name in ("time", "velocity") if name in arrays}
    return replace(flight, **arrays)
