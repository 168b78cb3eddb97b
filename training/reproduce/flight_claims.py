"""What the flight tests are to show, held against what was flown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from swarm_envs.training.reproduce.flight_cases import PLAIN_SWAPS

LARGE_CM = 8.0
"""Errors above this are to be halved at least."""
LARGE_CASES = 6
"""So many of the ten plain swaps are to have one."""


class Claim(NamedTuple):
    """One claim, and whether the flights bear it out."""

    claim: str
    """What the paper says."""
    found: str
    """What we found."""
    reached: bool
    """Whether it holds here."""


def swap_claims(rows: Sequence[Mapping[str, Any]]) -> list[Claim]:
    """Claims about the swaps of Fig. 8, as far as their cases were flown.

    Args:
        rows: of the cases, as `flight_report.case_row` gives them.
    """
    worse = [row["case"] for row in rows if row["ratio"] >= 1.0]
    large = [row for row in rows if row["without"]["median"] > LARGE_CM]
    stubborn = [row["case"] for row in large if row["ratio"] > 0.5]
    claims = [
        Claim(
            "the median is smaller with compensation in every case",
            f"in {len(rows) - len(worse)} of {len(rows)}{_but(worse)}",
            not worse,
        ),
        Claim(
            f"it is at least halved where it exceeds {LARGE_CM:g} cm without",
            f"in {len(large) - len(stubborn)} of {len(large)}{_but(stubborn)}",
            not stubborn,
        ),
    ]
    plain = [row for row in rows if row["case"] in PLAIN_SWAPS]
    if len(plain) == len(PLAIN_SWAPS):
        found = sum(row in large for row in plain)
        claims.append(
            Claim(
                f"at least {LARGE_CASES} of the ten plain cases exceed it",
                f"{found} do",
                found >= LARGE_CASES,
            )
        )
    return claims + [_beats_paper(row) for row in rows if row["paper_cm"]]


def ring_claims(rows: Sequence[Mapping[str, Any]]) -> list[Claim]:
    """Claims about rings: each flight's worst error is halved, and the paper's factor beaten."""
    halved = [
        Claim(
            f"{row['case']}: the worst drone's error is at least halved",
            _change(row),
            row["ratio"] <= 0.5,
        )
        for row in rows
    ]
    return halved + [_beats_paper(row) for row in rows]


def _beats_paper(row: Mapping[str, Any]) -> Claim:
    before, after = row["paper_cm"]
    return Claim(
        f"{row['case']}: the factor is larger than the paper's {before:g} / {after:g} cm",
        _change(row),
        row["ratio"] < after / before,
    )


def _change(row: Mapping[str, Any]) -> str:
    before, after = (row[side]["median"] for side in ("without", "compensated"))
    return f"{before:.1f} to {after:.1f} cm, a factor of {before / after:.1f}"


def _but(cases: Sequence[str]) -> str:
    return f", not in {', '.join(cases)}" if cases else ""
