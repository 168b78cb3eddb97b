"""What a curriculum reports: JSON and a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swarm_envs.training.curriculum.rounds import RoundReport
from swarm_envs.training.curriculum.unseen import GOALS, Unseen, by_size


@dataclass(frozen=True)
class CurriculumReport:
    """The content of `curriculum.json`."""

    command: str
    """The command that was run."""
    config: object
    """Its options."""
    interactions: str
    """Force model of the environment."""
    interactions_sha256: str
    """Fingerprint of the force model that blew."""
    rule: str
    """How a round's clearance follows from the round before."""
    rounds: list[RoundReport]
    """What each round flew and learned."""
    true_drag: dict[str, list[float]]
    """Of the environment, by type and axis, N s/m."""
    unseen: list[Unseen]
    """Errors on teams that no round flew."""
    explained: dict[str, dict[str, float]]
    """By number of drones: mean, least and goal of the share of the true vertical force."""
    reached: bool
    """Whether every team of each number of drones reaches the goal."""
    wall_time_s: float
    """Of this call: what was done before a kill is not in it."""

    def lines(self) -> list[str]:
        """What the command prints."""
        return [rounds_table(self.rounds, self.unseen), "", *sizes(self.unseen)]


def sizes_as_json(unseen: list[Unseen]) -> dict[str, dict[str, float]]:
    """Mean, least and goal by number of drones."""
    return {
        str(size): {"mean": round(mean, 4), "least": least, "goal": GOALS[size]}
        for size, (mean, least) in by_size(unseen).items()
    }


def goals_reached(unseen: list[Unseen]) -> bool:
    """Whether every team of each number of drones reaches the goal."""
    return all(least >= GOALS[size] for size, (_, least) in by_size(unseen).items())


def sizes(unseen: list[Unseen]) -> list[str]:
    """Lines on how much of the true force the last model explains."""
    return [
        f"{size} drones: {100 * mean:.1f} % of the variance of the true f_a,z on unseen swaps "
        f"(least of the teams {100 * least:.1f} %; goal {100 * GOALS[size]:.0f} %)"
        for size, (mean, least) in by_size(unseen).items()
    ]


def rounds_table(rounds: list[RoundReport], unseen: list[Unseen]) -> str:
    """The rounds as a table, plain text."""
    head = ("round", "planned", "gap error", "clearance", "distance", "cut", "rows", "val. MSE")
    units = ("", "cm", "cm", "flown, cm", "/ radii", "", "", "g^2 (zero)")
    shares = [f"{size} drones" for size in GOALS]
    lines = [(*head, *shares), (*units, *("% of f_z" for _ in shares))]
    for k, r in enumerate(rounds):
        c = r.closeness
        means = [
            np.mean([u.explained[k] for u in unseen if u.drones == size]) if unseen else np.nan
            for size in GOALS
        ]
        lines.append(
            (
                f"{r.number} {r.title}",
                f"{100 * r.clearance_m:.1f}",
                f"{100 * c.gap_error_m:.1f}",
                f"{100 * c.least_clearance_m:.1f}",
                f"{c.least_distance_ratio:.2f}",
                f"{c.cut_swaps + c.cut_walks}/{c.flights}",
                str(r.rows),
                f"{r.validation_mse:.2f} ({r.zero_mse:.1f})",
                *(f"{100 * mean:.1f}" for mean in means),
            )
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip()
        for line in lines
    )
