"""Reproduce a figure of DMPC-Swarm.

    python -m examples.papers.dmpc_swarm figure-3b --seeds 1 --out runs/figure-3b

Each command prints its numbers, for figures beside those of the paper, and writes them as JSON,
with a picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from examples.papers.common import run_command
from examples.papers.dmpc_swarm.figures import figure_3a, figure_3b, figure_3c, figure_4
from examples.papers.dmpc_swarm.hall import figures_in_hall

COMMANDS: dict[str, Callable[..., None]] = {
    "figure-3a": figure_3a,
    "figure-3b": figure_3b,
    "figure-3c": figure_3c,
    "figure-4": figure_4,
    "hall": figures_in_hall,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command line."""
    run_command("dmpc_swarm", COMMANDS, __doc__, arguments)


if __name__ == "__main__":
    main()
