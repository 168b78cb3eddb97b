"""HTML and SVG out of elements: whatever text a user chose, it is written as text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias
from xml.etree.ElementTree import Element, tostring

Content: TypeAlias = "Element | str | Iterable[Content] | None"
"""What stands in an element: others, text, lists of both; None is nothing."""


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
        element.set(key.rstrip("_").replace("_", "-"), _text(value))
    _fill(element, content)
    return element


def html(*content: Content) -> str:
    """Elements and texts as HTML; all text is escaped."""
    holder = tag("x", *content)
    return tostring(holder, encoding="unicode", method="html")[len("<x>") : -len("</x>")]


def _text(value: str | float) -> str:
    if value is True:
        return ""
    return value if isinstance(value, str) else f"{value:.5g}"


def _fill(element: Element, content: Iterable[Content]) -> None:
    for each in content:
        if isinstance(each, str):
            _write(element, each)
        elif isinstance(each, Element):
            element.append(each)
        elif each is not None:
            _fill(element, each)


def _write(element: Element, text: str) -> None:
    if len(element):
        element[-1].tail = (element[-1].tail or "") + text
    else:
        element.text = (element.text or "") + text
