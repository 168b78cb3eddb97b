"""`swarm-envs plan`: paths on a grid for many labelled robots."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.arguments import POSITIVE_S, Count, Range, Seed
from swarm_envs.commands.checks import as_misuse, command_options, need_file, output_files
from swarm_envs.errors import check_name
from swarm_envs.files import claimed, write_json

if TYPE_CHECKING:
    from swarm_envs.baselines.rth3d import GridInstance, GridPlan


@command_options
@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Plan collision-free paths for robots on a grid with RTH3D, PIBT or LaCAM*.

    Samples an instance, or reads one of the MAPF benchmarks; plans, validates, and prints the
    makespan and its bounds.
    """

    grid: str = "48x24x12"
    """vertices along x, y and z, such as 144x72x36; two numbers for a 2-D grid"""
    density: Annotated[float, Range(0.0, 1.0, above=True)] | None = None
    """robots per vertex, such as 0.333; default: 1/3, or 2/9 between buildings"""
    robots: Count | None = None
    """number of robots, instead of a density"""
    family: str = "uniform"
    """distribution of starts and goals: uniform, quasi-random, mirror, rings, blocks, small-blocks,
    buildings, quasi-buildings, shift, reflection, layers, ends"""
    map: Path | None = None
    """.map file of the MAPF benchmarks, instead of a grid and a family"""
    scen: Path | None = None
    """.scen file with starts and goals on that map; the first --robots, or all"""
    method: str = "auto"
    """rth3d, rth3d-lba, rth3d-lba-paper, pibt, lacam, or auto, the best of the applicable
    methods"""
    objective: Literal["makespan", "sum_of_costs"] = "makespan"
    """objective to minimize: the makespan, or within it the sum of costs"""
    labels: bool = True
    """labeled planning: each robot has its own goal; otherwise any robot may take any goal, in the
    fewest steps"""
    seed: Seed = 0
    """random seed of the instance, of pibt and of lacam"""
    time_limit_s: Annotated[float, POSITIVE_S] | None = None
    """time limit of planning, s; a phase that has begun may exceed it"""
    out: Path | None = None
    """output folder for plan.npz, plan.json and plan.png"""
    save: Path | None = None
    """write the paths, .npz"""
    picture: Path | None = None
    """write a picture of the plan, .png"""
    json: Path | None = None
    """write the results, .json"""

    def __post_init__(self) -> None:
        """Refuse a grid that is none, and two numbers of robots."""
        if self.density is not None and self.robots is not None:
            raise ValueError("--density and --robots both say how many robots; give one of them")
        if (self.map is None) != (self.scen is None):
            raise ValueError("--map and --scen belong together; give both")
        drawn = (self.grid, self.family, self.density)
        if self.map is not None and drawn != (PlanOptions.grid, PlanOptions.family, None):
            raise ValueError("--map and --scen take the place of --grid, --family and --density")
        self.shape()

    def shape(self) -> tuple[int, ...]:
        """Sides of the grid."""
        if not re.fullmatch(r"[1-9]\d*(x[1-9]\d*){1,2}", self.grid):
            rule = "must be two or three integers of at least 1, such as 144x72x36"
            raise ValueError(f"--grid is {self.grid!r}, but {rule}")
        return tuple(map(int, self.grid.split("x")))


_FILES = {
    "save": ("plan.npz", ".npz"),
    "json": ("plan.json", ".json"),
    "picture": ("plan.png", ".png"),
}
"""What `--out` writes: option, name of the file and its suffix, in the order of writing."""


def run_plan(options: PlanOptions) -> None:
    """Draw the instance, plan, print and write."""
    files = output_files(options, _FILES)
    instance = _instance(options)
    with nullcontext() if options.out is None else claimed(options.out):
        found = _plan(instance, options)
        print(*summary_lines(found), sep="\n")
        _write(files, found)


def _write(files: Mapping[str, Path], found: GridPlan) -> None:
    from swarm_envs.baselines.rth3d.grid_plan import plot_grid_plan

    for option, path in files.items():
        if option == "save":
            found.save(path)
        elif option == "json":
            write_json(path, facts(found) | {"version": __version__})
        else:
            plot_grid_plan(path, found)
        print(f"wrote {path}", flush=True)


def _instance(options: PlanOptions) -> GridInstance:
    from swarm_envs.baselines.rth3d import FAMILIES, building_columns, make_instance, max_density
    from swarm_envs.baselines.rth3d.benchmark_files import read_benchmark
    from swarm_envs.baselines.rth3d.grid import check_shape

    robots = "--robots"
    if options.density is not None:
        robots = f"the number of robots at --density {options.density:g}"
    names = {"count": robots, "the number of robots": robots, "shape": "--grid"}
    with as_misuse(OSError, names=names):
        if options.map is not None and options.scen is not None:
            need_file("--map", options.map, "the grid with its obstacles")
            need_file("--scen", options.scen, "the robots' starts and goals on the map")
            return read_benchmark(options.map, options.scen, options.robots)
        shape = check_shape(options.shape())
        count = options.robots
        if options.density is not None:
            count = round(options.density * float(np.prod(shape)))
        elif count is None and FAMILIES[check_name("family", options.family, FAMILIES)].free_count:
            walls = building_columns(shape) if FAMILIES[options.family].buildings else None
            count = max(1, int(max_density(shape, walls) * float(np.prod(shape)) + 1e-6))
        return make_instance(options.family, shape, count, options.seed)


def _plan(instance: GridInstance, options: PlanOptions) -> GridPlan:
    from swarm_envs.baselines.rth3d import METHODS, PlanNotFound, PlanTimeout, plan

    with as_misuse():
        check_name("method", options.method, METHODS)
    with tqdm(desc="plan", unit="phase", mininterval=0.1) as bar:

        def watch(name: str) -> None:
            bar.set_description(name)
            bar.update()

        try:
            return plan(
                instance.starts,
                instance.goals,
                instance.shape,
                instance.obstacles,
                method=options.method,
                objective=options.objective,
                seed=options.seed,
                time_limit=options.time_limit_s,
                watch=watch,
                labels=options.labels,
            )
        except (PlanNotFound, PlanTimeout) as error:
            raise ValueError(str(error)) from error


def facts(found: GridPlan) -> dict[str, Any]:
    """What was measured, as JSON has it."""
    names = "method winner seed makespan lower_bound ratio sum_of_costs bound before_compaction "
    names += "valid seconds"
    return {
        "shape": list(found.shape),
        "robots": len(found.starts),
        "obstacles": int(found.obstacles.sum()),
        "labels": found.set_bound is None,
        **{name: getattr(found, name) for name in names.split()},
        "phases": [vars(phase) for phase in found.phases],
    }


def summary_lines(found: GridPlan) -> list[str]:
    """What is printed of a plan."""
    sides = " x ".join(map(str, found.shape))
    lines = [
        f"{len(found.starts):,} robots on {sides}: makespan {found.makespan}, lower bound "
        f"{found.lower_bound}, ratio {found.ratio:.3f}, by {found.winner}, valid, "
        f"sum of costs {found.sum_of_costs:,}"
    ]
    if found.before_compaction is not None:
        lines.append(f"before compaction {found.before_compaction}")
    if found.bound is not None:
        lines.append(f"RTH3D guarantees a makespan of at most {found.bound}")
    width = max(len(phase.name) for phase in found.phases)
    for phase in found.phases:
        lines.append(f"  {phase.name.ljust(width)}  {phase.makespan:5d}  {phase.seconds:7.2f} s")
    return lines
