"""Reproduce a figure of the RTH3D paper.

    python -m examples.papers.rth3d figure-6 --runs 2 --out runs/figure-6
    python -m examples.papers.rth3d figure-11 --out runs/figure-11

Each command prints its numbers beside those of the paper and writes them as JSON, with a picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from examples.papers.common import run_command
from examples.papers.rth3d.figures import figure_5, figure_6, figure_7, figure_8, figure_9
from examples.papers.rth3d.letters import figure_11

COMMANDS: dict[str, Callable[..., None]] = {
    "figure-5": figure_5,
    "figure-6": figure_6,
    "figure-7": figure_7,
    "figure-8": figure_8,
    "figure-9": figure_9,
    "figure-11": figure_11,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command line."""
    run_command("rth3d", COMMANDS, __doc__, arguments)


if __name__ == "__main__":
    main()
