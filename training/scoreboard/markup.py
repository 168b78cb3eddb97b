"""HTML out of elements, and numbers as the scoreboard's page writes them.

Whatever text a user chose, it is written as text.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TypeAlias
from xml.etree.ElementTree import Element, tostring

from swarm_envs.training.scoreboard.board import Interval

Content: TypeAlias = "Element | str | Iterable[Content] | None"
"""What stands in an element: others, text, lists of both; None is nothing."""
NONE = "\N{EN DASH}"  # Where there is no number
_THIN = "\N{NARROW NO-BREAK SPACE}"


def tag(name: str, *content: Content, **attributes: str | float | bool | None) -> Element:
    """An element.

    Args:
        name: such as `td`.
        content: in order.
        attributes: by name; a trailing underscore falls away and others become hyphens, so
            `class_` and `aria_label` can be written. None and False leave the attribute out.
    """
    element = Element(name)
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        text = value if isinstance(value, str) else "" if value is True else f"{value:.5g}"
        element.set(key.rstrip("_").replace("_", "-"), text)
    _fill(element, content)
    return element


def html(*content: Content) -> str:
    """Elements and texts as HTML; all text is escaped."""
    holder = tag("x", *content)
    return tostring(holder, encoding="unicode", method="html")[len("<x>") : -len("</x>")]


def _fill(element: Element, content: Iterable[Content]) -> None:
    for each in content:
        if isinstance(each, str):
            if len(element):
                element[-1].tail = (element[-1].tail or "") + each
            else:
                element.text = (element.text or "") + each
        elif isinstance(each, Element):
            element.append(each)
        elif each is not None:
            _fill(element, each)


def format_value(value: float, unit: str = "") -> str:
    """Three digits, or so; a rate in per cent, without the sign."""
    if unit == "%":
        return f"{100.0 * value:.{0 if value in (0.0, 1.0) else 1}f}"
    if value == 0.0:
        return "0"
    places = max(0, 2 - math.floor(math.log10(abs(value))))
    text = f"{value:,.{min(places, 6)}f}".replace(",", _THIN)
    return text.rstrip("0").rstrip(".") if "." in text else text


def format_interval(ends: Interval | None, unit: str = "") -> str:
    """The ends of an interval; empty where there is none."""
    return "" if ends is None else NONE.join(format_value(end, unit) for end in ends)


def format_duration(seconds: float) -> str:
    """Such as `12 s`, `3.4 min`, `1.2 h`."""
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= size:
            return f"{seconds / size:.1f}".removesuffix(".0") + f" {unit}"
    return f"{seconds:.3g} s"
