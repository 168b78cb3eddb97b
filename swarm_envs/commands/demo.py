"""`swarm-envs demo`: stacked swaps with and without compensation of the downwash."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from swarm_envs.commands.checks import check_outputs
from swarm_envs.errors import check_integer
from swarm_envs.files import claimed, write_json


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Simulate stacked swaps with and without compensation of the downwash.

    In a stacked swap, drones fly above one another and exchange horizontal positions. The command
    prints the worst height error of the lowest drone, and writes a plot, a video and all results.
    """

    out: Path = Path("demo")
    """Output folder for summary.json, demo.png and demo.mp4."""
    seed: int = 0
    """Random seed of the swaps."""
    swaps: int = 6
    """Number of random swaps per scenario; each is simulated with and without compensation."""
    video: bool = True
    """Render the video, which takes most of the time."""
    json: Path | None = None
    """Also write the results to this file."""

    def __post_init__(self) -> None:
        """Raise ValueError if a number is out of range."""
        check_integer("--seed", self.seed, at_least=0)
        check_integer("--swaps", self.swaps, at_least=1, at_most=1000)


def run_demo(options: DemoOptions) -> int:
    """Simulate, write and print; return the number of flights that crashed."""
    check_outputs(options.out, options.json)
    from swarm_envs.baselines.neural_swarm import demo

    with claimed(options.out):
        summary = demo.run_demo(options.out, options.seed, options.swaps, options.video)
    if options.json is not None:
        write_json(options.json, summary)
    print(demo.format_table(summary), "", *(f"note: {n}" for n in summary["notes"]), sep="\n")
    files = [options.out / name for name in summary["files"].values() if name]
    print("wrote", ", ".join(map(str, [options.out / "summary.json", *files])))
    crashed = demo.crashed_flights(summary)
    if crashed:
        print(f"{crashed} flights ended early: their worst error is a lower bound")
    return crashed
