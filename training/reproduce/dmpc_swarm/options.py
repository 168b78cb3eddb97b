"""Options of `swarm-envs reproduce dmpc-swarm`, and what it does with them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.files import write_json, write_table
from swarm_envs.training.reproduce.dmpc_swarm import cells as experiments
from swarm_envs.training.reproduce.dmpc_swarm.flights import Flight, Setting
from swarm_envs.training.reproduce.dmpc_swarm.page import recording
from swarm_envs.training.reproduce.dmpc_swarm.pictures import (
    format_cells,
    plot_jam,
    plot_losses,
    plot_sequence,
    rows,
)
from swarm_envs.training.reproduce.dmpc_swarm.places import format_places, reproduce_places
from swarm_envs.training.reproduce.runs import Cell, run_cells

Settings = Mapping[str, Sequence[Setting]]
"""What is varied, and its values."""


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Remake a figure of DMPC-Swarm, the public simulation's times beside ours.

    `--figure 3a` draws the formations, `--figure 3b` flies through them with one, two and three
    compute units, `--figure 3c` with each trigger, `--figure 4` a circle while no compute unit
    hears anything for two seconds. `--study loss` sweeps the share of messages lost, met by our
    recovery, by the paper's, and not at all.
    What takes a while goes on where it was when it is killed and called again.
    """

    figure: Literal["3a", "3b", "3c", "4"] | None = None
    """number of the figure"""
    study: Literal["loss"] | None = None
    """the sweep of losses"""
    out: Path = Path("reproduce")
    """folder for pictures, numbers and replay pages; made if missing"""
    json: Path | None = None
    """write the numbers to this file too"""
    seed: int = 0
    """the first of the seeds"""
    seeds: int = 3
    """how many, each a run of every cell"""
    replay: bool = True
    """write a replay page of each cell's first run; needs plotly"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: not exactly one of figure and study, or a number out of range.
        """
        if (self.figure is None) == (self.study is None):
            raise ValueError("give one of --figure 3a, 3b, 3c, 4, or --study loss")
        if self.seed < 0 or self.seeds < 1:
            raise ValueError(
                f"--seed is {self.seed} and --seeds {self.seeds}, but must be at least 0 and 1"
            )

    @property
    def name(self) -> str:
        """Of the files, such as `figure_3b`."""
        return "losses" if self.figure is None else f"figure_{self.figure}"

    @property
    def needs_torch(self) -> bool:
        """Whether something is trained: nothing is."""
        return False


def run(options: ReproduceOptions) -> str:
    """Do what the options say, and return what to print."""
    if options.figure == "3a":
        return _places(options)
    settings, fly_one = _plan(options)
    flights: dict[str, Flight] = {}
    jobs: dict[str, Callable[[], Cell]] = {
        name: functools.partial(
            experiments.computed, fly_one, runs, functools.partial(flights.__setitem__, name)
        )
        for name, runs in settings.items()
    }
    seeds = [options.seed + k for k in range(options.seeds)]
    found = run_cells(options.out / f"{options.name}.json", {"seeds": seeds}, jobs)
    written = _write(options, settings, fly_one, flights, found)
    if options.json is not None:
        write_json(options.json, {"cells": found, "theirs_s": dict(experiments.THEIRS)})
    names = ", ".join(str(path) for path in written)
    return f"{format_cells(found, experiments.THEIRS)}\nwrote {names}"


def _places(options: ReproduceOptions) -> str:
    summary = reproduce_places(options.out)
    if options.json is not None:
        write_json(options.json, summary)
    files = ", ".join(str(options.out / f"figure_3a.{kind}") for kind in ("json", "csv", "png"))
    return f"{format_places(summary)}\nwrote {files}"


def _plan(options: ReproduceOptions) -> tuple[Settings, Callable[[Setting], Flight]]:
    seeds = range(options.seed, options.seed + options.seeds)
    if options.study is not None:
        return experiments.loss_cells(seeds), experiments.fly_circle
    if options.figure == "4":
        return experiments.jam_cells(seeds), experiments.fly_circle
    assert options.figure is not None
    return experiments.sequence_cells(options.figure, seeds), experiments.fly_sequence


def _write(
    options: ReproduceOptions,
    settings: Settings,
    fly_one: Callable[[Setting], Flight],
    flights: dict[str, Flight],
    found: Mapping[str, Cell],
) -> list[Path]:
    """The picture, the table and the pages; cells of an earlier run are flown again to be drawn."""
    files = [options.out / f"{options.name}.{kind}" for kind in ("json", "csv", "png")]
    write_table(files[1], rows(found, experiments.THEIRS))
    if options.study is not None:
        plot_losses(files[2], found)
        return files
    flights |= {name: fly_one(runs[0]) for name, runs in settings.items() if name not in flights}
    drawn = {name: flights[name] for name in settings}
    if options.figure == "4":
        plot_jam(files[2], drawn, experiments.JAM_S)
    else:
        by = "compute units" if options.figure == "3b" else "triggers"
        headline = f"Fig. {options.figure}: sixteen drones through five formations, by {by}"
        plot_sequence(files[2], headline, drawn, found, experiments.THEIRS)
    if options.replay:
        files += _pages(options, drawn)
    return files


def _pages(options: ReproduceOptions, flights: Mapping[str, Flight]) -> list[Path]:
    from swarm_envs.viewing.replay import write_replay

    config, files = MlrDmpcConfig(), []
    for name, flight in flights.items():
        plain = "".join(c if c.isalnum() else "_" for c in name).strip("_")
        path = options.out / f"{options.name}_{plain}.html"
        write_replay(path, recording(flight, config, name, options.seed))
        files.append(path)
    return files
