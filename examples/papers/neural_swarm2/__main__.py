"""Command line: `python -m examples.papers.neural_swarm2 figure-8 --world hall --out DIR`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from examples.papers.common import run_command
from examples.papers.neural_swarm2.ablation import table_3
from examples.papers.neural_swarm2.adaptation import adaptation
from examples.papers.neural_swarm2.as_flown import as_flown
from examples.papers.neural_swarm2.ball import ball
from examples.papers.neural_swarm2.collection import table_2
from examples.papers.neural_swarm2.curriculum import curriculum
from examples.papers.neural_swarm2.flight_figures import figure_1, figure_8, figure_9
from examples.papers.neural_swarm2.force_figure import figure_5
from examples.papers.neural_swarm2.import_logs import import_logs
from examples.papers.neural_swarm2.planning_figures import figure_6, figure_7
from examples.papers.neural_swarm2.real_flights import real_flights
from examples.papers.neural_swarm2.vehicles import table_1

COMMANDS: dict[str, Callable[..., None]] = {
    "import": import_logs,
    "figure-1": figure_1,
    "figure-5": figure_5,
    "figure-6": figure_6,
    "figure-7": figure_7,
    "figure-8": figure_8,
    "figure-9": figure_9,
    "table-1": table_1,
    "table-2": table_2,
    "table-3": table_3,
    "curriculum": curriculum,
    "as-flown": as_flown,
    "real-flights": real_flights,
    "ball": ball,
    "adaptation": adaptation,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command line."""
    run_command(
        "neural_swarm2",
        COMMANDS,
        "Figures and tables of Neural-Swarm2, and studies of its controller.",
        arguments,
    )


if __name__ == "__main__":
    main()
