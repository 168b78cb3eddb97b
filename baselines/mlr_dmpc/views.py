"""Who takes part: views, ordered, that drones lock to so that no two of them plan at a time."""

from __future__ import annotations

from typing import NamedTuple


class ViewId(NamedTuple):
    """What orders views: a later epoch wins, then the higher proposer."""

    epoch: int
    """Counts up with each proposal."""
    proposer: int
    """Compute unit that proposed it."""


class View(NamedTuple):
    """Compute units and drones that take part."""

    id: ViewId
    """Its place in the order."""
    units: tuple[int, ...]
    """Compute units that plan, ascending."""
    drones: frozenset[int]
    """Drones that are planned for and avoided."""

    def leader(self, round_: int) -> int:
        """Who says in a round which drones are planned in the next one."""
        return self.units[round_ % len(self.units)]

    def rank(self, unit: int, round_: int) -> int:
        """Which of the selected drones a unit takes: (k + w) mod M over the members."""
        return (round_ + self.units.index(unit)) % len(self.units)


SILENCE = 11.5
"""A unit is left out when only one silence in exp(11) would be as long by loss alone."""
LEAST_SILENT_ROUNDS = 6
"""Rounds of silence below which no unit is left out of a view."""


class Absences:
    """For how long each unit has been silent, weighed by how much else was lost meanwhile.

    A round in which most messages were lost says little about a missing one; in a blackout nobody
    is left out.
    """

    def __init__(self, num_units: int) -> None:
        self.count = num_units
        self._rounds = [0] * num_units
        self._evidence = [0.0] * num_units

    def observe(self, heard: frozenset[int], log_odds: float) -> None:
        """Note who was heard, and minus the logarithm of the share lost in that round."""
        for unit in range(len(self._rounds)):
            silent = unit not in heard
            self._rounds[unit] = self._rounds[unit] + 1 if silent else 0
            self._evidence[unit] = self._evidence[unit] + log_odds if silent else 0.0

    def gone(self, unit: int) -> bool:
        """Whether a unit has been silent for too long for loss alone."""
        enough = self._rounds[unit] >= LEAST_SILENT_ROUNDS
        return enough and self._evidence[unit] >= SILENCE

    def present(self, unit: int) -> bool:
        """Whether a unit was heard lately."""
        return self._rounds[unit] < LEAST_SILENT_ROUNDS
