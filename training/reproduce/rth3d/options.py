"""Options of `swarm-envs reproduce rth3d`, and what it does with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from swarm_envs.baselines.rth3d import METHODS
from swarm_envs.errors import check_name
from swarm_envs.files import write_json, write_table, written_whole
from swarm_envs.training.reproduce.rth3d.cells import jobs, run_name, runs_at
from swarm_envs.training.reproduce.rth3d.claims import check
from swarm_envs.training.reproduce.rth3d.curves import Curves, curves, growth
from swarm_envs.training.reproduce.rth3d.experiments import FIGURES, Figure, Setting
from swarm_envs.training.reproduce.rth3d.page import page, rows, summary
from swarm_envs.training.reproduce.rth3d.pictures import plot_figure
from swarm_envs.training.reproduce.runs import Cell, run_cells


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Remake a figure of the RTH3D paper: time and makespan over the size of the grid.

    `--figure 5`: 4:2:1 grids; `--figure 6`: square grids six vertices high; `--figure 7`: between
    tall buildings; `--figure 8`: by density; `--figure 9`: rings and blocks; `--figure 11`: ten
    drones write letters, flown. The largest grids take minutes; `--largest` leaves them out. What
    is killed goes on where it was when called again.
    """

    figure: Literal["5", "6", "7", "8", "9", "11"]
    """number of the figure"""
    out: Path = Path("reproduce")
    """folder for the picture, the numbers and the page; made if missing"""
    json: Path | None = None
    """write the numbers to this file too"""
    methods: tuple[str, ...] = ("rth3d", "rth3d-lba", "auto")
    """rth3d, rth3d-lba, auto, pibt"""
    runs: int = 20
    """of each method on each grid where grids are small"""
    budget: int = 250_000
    """vertices of all runs of a method on a grid together: on larger grids there are fewer runs"""
    largest: int = 500_000
    """vertices of the largest grid"""
    seed: int = 0
    """the first of the seeds"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: an unknown or repeated method, or a number out of range.
        """
        for method in self.methods:
            check_name("method", method, METHODS)
        if not self.methods or len(set(self.methods)) < len(self.methods):
            raise ValueError(f"--methods is {' '.join(self.methods)!r}; give each method once")
        if self.seed < 0 or min(self.runs, self.budget) < 1:
            raise ValueError(
                f"--seed is {self.seed}, --runs {self.runs} and --budget {self.budget}, but must "
                "be at least 0, 1 and 1"
            )
        if self.figure != _LETTERS and not chosen(self).series:
            raise ValueError(
                f"--largest is {self.largest} vertices, below every grid of figure {self.figure}; "
                f"the smallest has {_smallest(FIGURES[self.figure])}"
            )

    @property
    def name(self) -> str:
        """Of the files, such as `figure_5`."""
        return f"figure_{self.figure}"

    @property
    def needs_torch(self) -> bool:
        """Whether something is trained: nothing is."""
        return False

    def seeds(self, setting: Setting) -> range:
        """Of a setting's runs."""
        return range(self.seed, self.seed + runs_at(setting, self.runs, self.budget))


_LETTERS = "11"
"""The figure that is flown."""


def _smallest(figure: Figure) -> int:
    return min(setting.vertices for curve in figure.series.values() for setting in curve)


def chosen(options: ReproduceOptions) -> Figure:
    """The figure, without grids larger than wanted."""
    figure = FIGURES[options.figure]
    kept = {
        name: tuple(setting for setting in curve if setting.vertices <= options.largest)
        for name, curve in figure.series.items()
    }
    return replace(figure, series={name: curve for name, curve in kept.items() if curve})


def run(options: ReproduceOptions) -> str:
    """Do what the options say, and return what to print."""
    if options.figure == _LETTERS:
        return _letters(options)
    figure = chosen(options)
    path = options.out / f"{options.name}.json"
    settings = {"figure": options.figure}
    kept = run_cells(path, settings, jobs(figure, options.methods, options.seeds))
    drawn = curves(figure, options.methods, _by_setting(options, figure, kept))
    claims = check(figure, drawn)
    files = [path.with_suffix(suffix) for suffix in (".csv", ".png", ".md")]
    write_table(files[0], rows(drawn))
    plot_figure(files[1], figure, drawn)
    with written_whole(files[2]) as partial:
        partial.write_text(page(options.name, figure, drawn, claims), encoding="utf-8")
    if options.json is not None:
        content = {"points": rows(drawn), "growth": _growth(drawn), "peers": _peers(figure)}
        write_json(options.json, content | {"claims": [asdict(claim) for claim in claims]})
    names = ", ".join(str(file) for file in (path, *files))
    return f"{summary(drawn, claims)}\nwrote {names}"


def _letters(options: ReproduceOptions) -> str:
    from swarm_envs.training.reproduce.rth3d.letters import format_letters, reproduce_letters

    summary = reproduce_letters(options.out, options.seed)
    if options.json is not None:
        write_json(options.json, summary)
    files = ", ".join(str(options.out / f"figure_11.{kind}") for kind in ("json", "csv", "png"))
    return f"{format_letters(summary)}\nwrote {files}"


def _by_setting(
    options: ReproduceOptions, figure: Figure, kept: Mapping[str, Cell]
) -> dict[Setting, dict[str, list[Cell]]]:
    return {
        setting: {
            method: [kept[run_name(setting, method, seed)] for seed in options.seeds(setting)]
            for method in options.methods
        }
        for curve in figure.series.values()
        for setting in curve
    }


def _growth(drawn: Curves) -> dict[str, dict[str, float]]:
    laws = {f"{name}, {method}": growth(row) for (name, method), row in drawn.items()}
    return {name: asdict(law) for name, law in laws.items() if law is not None}


def _peers(figure: Figure) -> list[dict[str, object]]:
    return [asdict(peer) for peer in figure.peers]
