"""The picture of who imports whom: `python -m tests.helpers.import_graph` draws it anew."""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import TopologicalSorter
from html import escape
from typing import NamedTuple

from tests.helpers.imports import BASE, CLI, FACE, ROOT, SOURCES, imported_modules, level, parsed

PICTURE = ROOT / "docs" / "imports.svg"
FOUNDATION, FACES, COMMANDS = "vehicles, state ...", "swap_v0, ring_v0 ...", "cli, commands"
WIDTH, ROW, HEIGHT, LETTER = 1000, 84, 34, 7.6
"""Of the picture, from one row of boxes to the next, of a box, and of a letter, pixels."""

APART = ("swarm_envs.control.tracking",)
"""Modules with a box of their own: physics flies the equations of `control`, and the controller
that users take by itself flies in physics."""

Graph = Mapping[str, set[str]]


class Box(NamedTuple):
    """Where a package stands in the picture: centre and width, pixels."""

    x: float
    y: float
    width: float


def package(module: str) -> str:
    """The box in which a module stands."""
    parts, height = module.split("."), level(module)
    if module in APART:
        return ".".join(parts[1:])
    if height in (BASE, FACE, CLI):
        return {BASE: FOUNDATION, FACE: FACES, CLI: COMMANDS}[height]
    if parts[1] in ("baselines", "training") and len(parts) > 2:
        return parts[2]
    return parts[1]


def package_graph() -> dict[str, set[str]]:
    """Whom each box imports, itself and what only types need left out."""
    graph: dict[str, set[str]] = {package(name): set() for name in SOURCES}
    for name in SOURCES:
        graph[package(name)] |= {package(m) for m in imported_modules(parsed(name), name)}
    used = set().union(*graph.values())
    return {n: found - {n} for n, found in sorted(graph.items()) if found or n in used}


def below(graph: Graph) -> dict[str, set[str]]:
    """All that each box imports, itself or through others.

    Raises:
        graphlib.CycleError: two import each other.
    """
    reached: dict[str, set[str]] = {}
    for name in TopologicalSorter(graph).static_order():
        reached[name] = graph[name].union(*(reached[other] for other in graph[name]))
    return reached


def arrows(graph: Graph) -> dict[str, set[str]]:
    """The imports that do not follow from others."""
    reached = below(graph)
    return {
        name: {a for a in others if not any(a in reached[b] for b in others)}
        for name, others in graph.items()
    }


def rows(graph: Graph) -> list[list[str]]:
    """The boxes in rows, the lowest first: each above all that it imports."""
    height: dict[str, int] = {}
    for name in TopologicalSorter(graph).static_order():
        height[name] = 1 + max((height[other] for other in graph[name]), default=-1)
    return [sorted(n for n in graph if height[n] == k) for k in range(1 + max(height.values()))]


def places(graph: Graph) -> dict[str, Box]:
    """Where the boxes stand: in each row by the middle of what they point to."""
    drawn, found = arrows(graph), dict[str, Box]()
    levels = rows(graph)
    for k, row in enumerate(levels):
        middle = {n: [found[o].x for o in sorted(drawn[n])] or [WIDTH / 2] for n in row}
        order = sorted(row, key=lambda n: (sum(middle[n]) / len(middle[n]), n))
        widths = [24 + LETTER * len(name) for name in order]
        gap = (WIDTH - sum(widths)) / (len(row) + 1)
        left = gap
        for name, width in zip(order, widths, strict=True):
            y = ROW * (len(levels) - 1 - k) + HEIGHT
            found[name] = Box(left + width / 2, y, width)
            left += width + gap
    return found


def _box(name: str, box: Box) -> str:
    corner = f'x="{box.x - box.width / 2:.1f}" y="{box.y - HEIGHT / 2:.1f}"'
    size = f'width="{box.width:.1f}" height="{HEIGHT}" rx="6"'
    text = f'<text x="{box.x:.1f}" y="{box.y + 4:.1f}">{escape(name)}</text>'
    return f"<rect {corner} {size}/>{text}"


def _arrow(upper: Box, lower: Box) -> str:
    y0, y1 = upper.y + HEIGHT / 2, lower.y - HEIGHT / 2 - 5
    bend = (y1 - y0) / 2
    curve = f"C {upper.x:.1f} {y0 + bend:.1f} {lower.x:.1f} {y1 - bend:.1f} {lower.x:.1f} {y1:.1f}"
    return f'<path d="M {upper.x:.1f} {y0:.1f} {curve}" marker-end="url(#tip)"/>'


def picture() -> str:
    """The picture as SVG: boxes in rows, arrows down."""
    graph = package_graph()
    where, drawn = places(graph), arrows(graph)
    lines = [_arrow(where[a], where[b]) for a in sorted(drawn) for b in sorted(drawn[a])]
    boxes = [_box(name, where[name]) for name in sorted(where)]
    tall = max(box.y for box in where.values()) + HEIGHT
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {tall:.0f}">',
            "<style>rect{fill:#eef3f8;stroke:#34597d}path{fill:none;stroke:#8296aa}"
            "text{font:13px sans-serif;text-anchor:middle;fill:#1d2b38}</style>",
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="2" refY="4" markerWidth="7" '
            'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" style="fill:#8296aa"/>'
            "</marker></defs>",
            f'<rect width="{WIDTH}" height="{tall:.0f}" style="fill:#fff;stroke:none"/>',
            *lines,
            *boxes,
            "</svg>",
            "",
        ]
    )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
    print(f"wrote {PICTURE}")
