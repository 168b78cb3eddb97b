"""What the curves should show, and whether they do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from swarm_envs.training.reproduce.rth3d.curves import Curves, Point, growth
from swarm_envs.training.reproduce.rth3d.experiments import GUARANTEED, Figure, Target

SLACK = 30
"""What the makespan before compaction may be above m1 + 2 m2 + 2 m3, at most."""


@dataclass(frozen=True)
class Claim:
    """Something that should be so, and what was measured."""

    text: str
    """What should be so."""
    measured: str
    """What was measured."""
    holds: bool
    """Whether it is so."""


def check(figure: Figure, curves: Curves) -> list[Claim]:
    """Every claim of a figure for which something was run."""
    return [
        *_targets(figure, curves),
        *_bounds(curves),
        *_falling(figure, curves),
        *_orders(figure, curves),
    ]


def _targets(figure: Figure, curves: Curves) -> Iterator[Claim]:
    for target in figure.targets:
        points = [
            point
            for point in curves.get((target.series, target.method), ())
            if point.setting in target.settings and point.ratio is not None
        ]
        if points:
            yield _reached(target, points)


def _reached(target: Target, points: Sequence[Point]) -> Claim:
    spreads = [point.ratio if target.compacted else point.before for point in points]
    worst = max(spread.mean for spread in spreads if spread is not None)
    first, last = points[0].setting, points[-1].setting
    where = first.grid if first.grid == last.grid else f"{first.grid} to {last.grid}"
    where += f", up to {points[-1].robots:,} robots" if first.robots else ""
    kind = "" if target.compacted else " before compaction"
    source = " (the paper's)" if target.of_paper else ""
    return Claim(
        f"{target.series}, {where}: `{target.method}`{kind} at most {target.most:g}{source}",
        f"{worst:.3f}",
        worst <= target.most,
    )


def _bounds(curves: Curves) -> Iterator[Claim]:
    for method in GUARANTEED:
        points = [p for (_, own), row in curves.items() if own == method for p in row]
        known = [(p.constant, p.setting.grid) for p in points if p.constant is not None]
        if known:
            constant, grid = max(known)
            yield Claim(
                f"`{method}` before compaction: at most m1 + 2 m2 + 2 m3 + {SLACK}",
                f"{constant:+d} ({grid})",
                constant <= SLACK,
            )


def _falling(figure: Figure, curves: Curves) -> Iterator[Claim]:
    if figure.axis == "density":
        return
    for (name, method), row in curves.items():
        ratios = [p.ratio.mean for p in row if p.ratio is not None]
        if method not in GUARANTEED or len(ratios) < 2:
            continue
        rises = sum(later > earlier for earlier, later in pairwise(ratios))
        yield Claim(
            f"{name}: ratio of `{method}` falls as the grid grows",
            f"{ratios[0]:.3f} to {ratios[-1]:.3f}, {rises} of {len(ratios) - 1} steps up",
            ratios[-1] < ratios[0],
        )


def _orders(figure: Figure, curves: Curves) -> Iterator[Claim]:
    """Growth of RTH3D's time; the theory says nothing of PIBT's, and so nothing of `auto`'s."""
    if figure.order is None:
        return
    for (name, method), row in curves.items():
        law = growth(row) if method in GUARANTEED else None
        if law is not None:
            yield Claim(
                f"{name}: time of `{method}` grows no faster than vertices^{figure.order:.2f}",
                f"{law.exponent:.2f} ± {law.error:.2f}",
                law.exponent <= figure.order,
            )
