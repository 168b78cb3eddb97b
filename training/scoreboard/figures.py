"""Numbers as the scoreboard's page writes them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from swarm_envs.training.scoreboard.board import Metric, Value

NONE = "\N{EN DASH}"
"""Where there is no number."""
_THIN = "\N{NARROW NO-BREAK SPACE}"


def number(value: float, unit: str = "") -> str:
    """Three digits, or so; a rate in per cent, without the sign."""
    if unit == "%":
        return f"{100.0 * value:.{0 if value in (0.0, 1.0) else 1}f}"
    if value == 0.0:
        return "0"
    places = max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:,.{min(places, 6)}f}".replace(",", _THIN)
    return text.rstrip("0").rstrip(".") if "." in text else text


def interval(value: Value, unit: str = "") -> str:
    """The ends of an interval; empty where there is none."""
    if value.interval is None:
        return ""
    low, high = (number(end, unit) for end in value.interval)
    return f"{low}{NONE}{high}"


def duration(seconds: float) -> str:
    """Such as `12 s`, `3.4 min`, `1.2 h`."""
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= size:
            return f"{seconds / size:.1f}".removesuffix(".0") + f" {unit}"
    return f"{seconds:.3g} s"


def micros(value: float) -> str:
    """A time in microseconds, with the unit that reads best."""
    for size, unit in ((1e6, "s"), (1e3, "ms")):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.3g} µs"


def goodness(metric: Metric, values: Sequence[float | None]) -> list[float | None]:
    """How good each value of a column is, in [0, 1]; None where nothing can be said.

    Rates stand on their own; other values lie between the worst and the best of the column, by
    their logarithm where that is more than a factor of 30 away.
    """
    if metric.better == "neither":
        return [None] * len(values)
    found = [value for value in values if value is not None]
    low, high = (0.0, 1.0) if metric.unit == "%" else (min(found, default=0), max(found, default=0))
    if low == high:
        return [None if value is None else 0.5 for value in values]
    logarithmic = low > 0.0 and high / low > 30.0
    shares = [None if value is None else _share(value, low, high, logarithmic) for value in values]
    higher = metric.better == "higher"
    return [None if share is None else share if higher else 1.0 - share for share in shares]


def _share(value: float, low: float, high: float, logarithmic: bool) -> float:
    if logarithmic:
        return math.log(value / low) / math.log(high / low)
    return (value - low) / (high - low)
