"""Early validation: training rows held out to choose weights or settings, never `val`.

Two kinds, since a model may generalise in time and still know its flights: contiguous pieces of
flights that are trained on, and whole flights.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from swarm_envs.training.flight_logs.split import held_out_blocks
from swarm_envs.training.interaction_rows.rows import BoolArray, InteractionRows

PIECE_ENTRIES = 150
"""Length of a piece, in entries of a flight's clock: 4.5 s of the published flights' table."""
GUARD_ENTRIES = 15
"""Entries before and after a held-out piece that are neither trained on nor held out."""


Held = Literal["pieces", "flights"]
"""What is held out: pieces of flights, or whole ones."""


def inner_split(
    rows: InteractionRows, share: float, seed: int, held: Held = "pieces"
) -> tuple[BoolArray, BoolArray]:
    """Split the training rows once more.

    Args:
        rows: all rows; those of the validation blocks are in neither part.
        share: of the pieces or flights to hold out, above 0 and at most 0.5.
        seed: of the draw.
        held: `pieces` of time, all drones of a flight together, with a guard gap before and
            after; an entry is the usual step between rows of a flight. Or whole `flights`, so
            many of every scenario, at least one.

    Returns:
        (R,) masks of the rows to train on and of those held out.

    Raises:
        ValueError: the share is out of range, or one of the parts would be empty.
    """
    if not 0.0 < share <= 0.5:
        raise ValueError(f"share is {share}, but must be above 0 and at most 0.5")
    held_out, guarded = (_pieces if held == "pieces" else _flights)(rows, share, seed)
    training = ~rows.validation & ~held_out & ~guarded
    held_out &= ~rows.validation
    if not (training.any() and held_out.any()):
        raise ValueError(
            f"of {int((~rows.validation).sum())} training rows no {held} can be held out for early "
            f"validation (a piece has {PIECE_ENTRIES} entries); fit without it, or add flights"
        )
    return training, held_out


def _flights(rows: InteractionRows, share: float, seed: int) -> tuple[BoolArray, BoolArray]:
    """Whole flights of every scenario; nothing is guarded."""
    rng, chosen = np.random.default_rng(seed), set()
    for scenario in np.unique(rows.scenario):
        flights = np.unique(rows.flight[rows.scenario == scenario])
        count = max(1, round(share * len(flights)))
        chosen |= set(rng.choice(flights, count, replace=False).tolist())
    return np.isin(rows.flight, sorted(chosen)), np.zeros(len(rows), dtype=np.bool_)


def _pieces(rows: InteractionRows, share: float, seed: int) -> tuple[BoolArray, BoolArray]:
    """Contiguous pieces of time, and what lies in their guard gaps."""
    flights = np.unique(rows.flight)
    entries = [_entries(rows.step[rows.flight == flight]) for flight in flights]
    blocks = [int(entry.max()) // PIECE_ENTRIES + 1 for entry in entries]
    held_out = np.zeros(len(rows), dtype=np.bool_)
    guarded = np.zeros(len(rows), dtype=np.bool_)
    chosen = held_out_blocks(blocks, share, seed)
    for flight, entry, pieces in zip(flights, entries, chosen, strict=True):
        own = rows.flight == flight
        held_out[own] = pieces[entry // PIECE_ENTRIES]
        guarded[own] = _near_a_piece(entry, pieces)
    return held_out, guarded


def _entries(
    step: np.ndarray[tuple[int], np.dtype[np.int64]],
) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Number of each row's entry since the flight's first."""
    distinct = np.unique(step)
    usual = int(np.median(np.diff(distinct))) if len(distinct) > 1 else 1
    return (step - distinct[0]) // max(usual, 1)


def _near_a_piece(
    entry: np.ndarray[tuple[int], np.dtype[np.int64]], pieces: BoolArray
) -> BoolArray:
    """Whether an entry lies within the guard gap of a held-out piece."""
    near = np.zeros(len(entry), dtype=np.bool_)
    for piece in np.flatnonzero(pieces):
        begin, end = piece * PIECE_ENTRIES, (piece + 1) * PIECE_ENTRIES
        near |= (entry >= begin - GUARD_ENTRIES) & (entry < end + GUARD_ENTRIES)
    return near
