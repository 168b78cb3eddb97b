"""Ramps before and behind a flight, so that it begins and ends at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from swarm_envs.deploy.flight import AT_REST, Flight
from swarm_envs.state import FloatArray

_RATE = 50.0


def settled(flight: Flight, seconds: float) -> Flight:
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
    if not 0.0 < seconds < np.inf:
        raise ValueError(f"seconds is {seconds}, but must be positive and finite")
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

    def longer(array: FloatArray | None) -> FloatArray | None:
        if array is None:
            return None
        return np.concatenate([array, np.repeat(array[-1:], len(steps), axis=0)])

    known = flight.velocity
    if known is None:
        known = flight.curve(flight.time - flight.time[0], 1)
    return replace(
        flight,
        time=np.concatenate([flight.time, flight.time[-1] + steps]),
        position=np.concatenate([flight.position, ramp(steps)]),
        velocity=np.concatenate([known, ramp(steps, 1)]),
        yaw=longer(flight.yaw),
        force=longer(flight.force),
    )


def _reversed(flight: Flight) -> Flight:
    """Backwards in time."""

    def back(array: FloatArray | None, sign: float = 1.0) -> FloatArray | None:
        return None if array is None else sign * array[::-1]

    return replace(
        flight,
        time=-flight.time[::-1],
        position=flight.position[::-1],
        velocity=back(flight.velocity, -1.0),
        yaw=back(flight.yaw),
        force=back(flight.force),
    )
