"""A number of a paper and its reproduction: whether they agree, and if not, the known reason."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

Agreement = Literal["agrees", "explained", "unexplained", "ours alone"]
"""Within the tolerance; outside, for a known reason; outside; nothing in the paper to compare."""


class Extent(NamedTuple):
    """How much was run for the numbers that claims are checked on."""

    quick: bool = False  # Few runs of small cases (`--quick`) instead of the papers' sizes
    collected: bool = False
    """The rows of measured force were collected in simulation, not given by `--data`."""


@dataclass(frozen=True)
class Between:
    """Numbers from the least to the most, both included."""

    least: float = -math.inf  # Lowest number of the range
    most: float = math.inf  # Highest number of the range

    def __contains__(self, value: float) -> bool:
        """Whether a number lies in the range; NaN lies in none."""
        return self.least <= value <= self.most

    def __str__(self) -> str:
        """Such as `5.6 to 8.4`, `at least 5`, `at most 10`."""
        if self.least == self.most:
            return f"{self.least:.4g}"
        if math.isinf(self.most):
            return f"at least {self.least:.4g}"
        if math.isinf(self.least):
            return f"at most {self.most:.4g}"
        return f"{self.least:.4g} to {self.most:.4g}"


def exactly(value: float) -> Between:
    """One number alone."""
    return Between(value, value)


def about(value: float, share: float) -> Between:
    """Numbers within a share of a value: `about(10, 0.2)` is 8 to 12."""
    margin = abs(value) * share
    return Between(value - margin, value + margin)


@dataclass(frozen=True)
class Reason:
    """Why our number may be another than the paper's: in one direction and so far, no further."""

    text: str  # A sentence
    explains: Between  # Results that it explains


@dataclass(frozen=True)
class Claim:
    """One quantity, the paper's value and the result."""

    quantity: str  # What is measured, with its unit
    paper: str  # What the paper says, as it says it; "-" if nothing
    ours: float  # What we measured
    agrees: Between | None = None
    """Numbers that count as the paper's; None where the paper gives nothing to compare."""
    reasons: tuple[Reason, ...] = ()  # Why the result may differ
    spread: tuple[float, float] | None = None  # Range over which the result scatters
    spread_is: str = ""
    """What of: `quartiles`, `least and largest`, `standard deviation`; nothing without spread."""

    def __post_init__(self) -> None:
        """Refuse a spread without an order or a name."""
        if self.spread is None:
            object.__setattr__(self, "spread_is", "")
        elif not self.spread_is or self.spread[0] > self.spread[1]:
            raise ValueError(
                f"{self.quantity!r}: the spread {self.spread} must rise and say what it is"
            )

    @property
    def reason(self) -> Reason | None:
        """The first reason that explains our number, if it is outside the tolerance."""
        if self.agrees is None or self.ours in self.agrees:
            return None
        return next((reason for reason in self.reasons if self.ours in reason.explains), None)

    @property
    def agreement(self) -> Agreement:
        """Whether the result agrees with the paper."""
        if self.agrees is None:
            return "ours alone"
        if self.ours in self.agrees:
            return "agrees"
        return "explained" if self.reason else "unexplained"

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for JSON: NaN is null."""
        return {
            "quantity": self.quantity,
            "paper": self.paper,
            "ours": self.ours if math.isfinite(self.ours) else None,
            "spread": self.spread,
            "spread_is": self.spread_is,
            "agrees": None if self.agrees is None else str(self.agrees),
            "verdict": self.agreement,
            "reason": self.reason.text if self.reason else "",
        }


def claims_of(stated: Iterable[tuple[Any, ...]], ours: Iterable[float]) -> list[Claim]:
    """Claims without spread: rows of quantity, paper, `agrees` and reasons, and our numbers."""
    return [
        Claim(what, paper, value, agrees, tuple(reasons))
        for (what, paper, agrees, *reasons), value in zip(stated, ours, strict=True)
    ]


def format_quantity(value: float) -> str:
    """A number with as many digits as a reader wants: `0.123`, `12.3`, `124416`."""
    if not math.isfinite(value):
        return "none"
    if value == int(value) and abs(value) < 1e15:
        return str(int(value))
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
