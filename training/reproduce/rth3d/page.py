"""A figure's numbers as a table, as Markdown, and as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from swarm_envs.training.reproduce.rth3d.claims import Claim
from swarm_envs.training.reproduce.rth3d.curves import FIT_FROM, Curves, Point, Spread, growth
from swarm_envs.training.reproduce.rth3d.experiments import GUARANTEED, Figure

Row = dict[str, object]
"""A line of a table by its columns."""


def rows(curves: Curves) -> list[Row]:
    """One row for each point of each curve, for a table."""
    return [_row(name, method, p) for (name, method), row in curves.items() for p in row]


def _row(name: str, method: str, point: Point) -> Row:
    return {
        "series": name,
        "grid": point.setting.grid,
        "vertices": point.setting.vertices,
        "robots": point.robots,
        "method": method,
        "runs": point.runs,
        "solved": point.solved,
        **_columns("cpu_s", point.cpu_s),
        **_columns("ratio", point.ratio),
        **_columns("ratio_before_compaction", point.before),
        "most_over_m1_2m2_2m3": point.constant,
        "plans_by": "; ".join(f"{name} {count}" for name, count in point.winners.items()),
    }


def _columns(name: str, spread: Spread | None) -> Row:
    if spread is None:
        return {name: None, f"{name}_least": None, f"{name}_most": None}
    values = (spread.mean, spread.least, spread.most)
    return dict(zip((name, f"{name}_least", f"{name}_most"), map(_short, values), strict=True))


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def _table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(head)} |",
        f"|{'---|' * len(head)}",
        *(f"| {' | '.join(line)} |" for line in lines),
    ]


_HEAD = ("grid", "robots", "method", "runs", "CPU s", "ratio", "before compaction", "over the sum")


_LEGEND = (
    "Means; ratio is makespan over the largest Manhattan distance; the last column is the largest "
    "excess of the makespan before compaction over m1 + 2 m2 + 2 m3."
)


def _line(method: str, point: Point) -> tuple[str, ...]:
    return (
        point.setting.grid.replace("x", " x "),
        f"{point.robots:,}",
        f"`{method}`",
        str(point.runs) if point.solved == point.runs else f"{point.solved} of {point.runs}",
        f"{point.cpu_s.mean:.3g}",
        _mean(point.ratio),
        _mean(point.before),
        "" if point.constant is None else f"{point.constant:+d}",
    )


def _mean(spread: Spread | None) -> str:
    return "" if spread is None else f"{spread.mean:.3f}"


def _claims(claims: Sequence[Claim]) -> list[str]:
    lines = [(claim.text, claim.measured, "yes" if claim.holds else "**no**") for claim in claims]
    return _table(("", "measured", "holds"), lines)


def _laws(figure: Figure, curves: Curves) -> list[str]:
    lines = []
    for (name, method), row in curves.items():
        law = growth(row)
        if law is not None:
            known = figure.order is not None and method in GUARANTEED
            theory = f"{figure.order:.2f}" if known else ""
            fitted = f"{law.exponent:.2f} ± {law.error:.2f}"
            lines.append((name, f"`{method}`", fitted, theory, str(law.settings)))
    if not lines:
        return []
    head = ("", "method", "exponent", "theory", "sizes")
    text = (
        f"CPU time over vertices from {FIT_FROM} on, least squares of the logarithms of the means, "
        "with the standard error:"
    )
    return ["## Growth", "", text, "", *_table(head, lines), ""]


def page(name: str, figure: Figure, curves: Curves, claims: Sequence[Claim]) -> str:
    """A figure's page in Markdown.

    Args:
        name: of the picture, without suffix.
        figure: what was varied.
        curves: its points.
        claims: what was checked.
    """
    lines = [f"# {figure.headline}", "", f"![{figure.headline}]({name}.png)", ""]
    lines += [_LEGEND, ""]
    for series in figure.series:
        own = [(method, row) for (of, method), row in curves.items() if of == series]
        body = [_line(method, point) for method, row in own for point in row]
        if body:
            lines += [f"## {series}", "", *_table(_HEAD, body), ""]
    lines += _laws(figure, curves)
    return "\n".join([*lines, "## Checked", "", *_claims(claims), ""])


def summary(curves: Curves, claims: Sequence[Claim]) -> str:
    """The largest setting of each curve and the claims, as text."""
    lines = [f"{'':32}{'grid':>12}{'robots':>9}{'method':>11}{'runs':>5}{'CPU s':>9}{'ratio':>8}"]
    for (name, method), row in curves.items():
        point = row[-1]
        lines.append(
            f"{name:32}{point.setting.grid:>12}{point.robots:>9,}{method:>11}{point.runs:>5}"
            f"{point.cpu_s.mean:>9.3g}{_mean(point.ratio) or '-':>8}"
        )
    lines += [f"{'ok ' if c.holds else 'NO '} {c.text}: {c.measured}" for c in claims]
    return "\n".join(lines)
