"""The papers whose figures and tables can be remade, each with options of its own."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType, ModuleType


@dataclass(frozen=True)
class Paper:
    """A paper of which something can be remade."""

    summary: str
    """What is remade, in a line."""
    module: str
    """Has `ReproduceOptions`, a dataclass with a property `needs_torch`, and `run(options)`, which
    does it and returns what to print."""


PAPERS: Mapping[str, Paper] = MappingProxyType(
    {
        "neural-swarm2": Paper(
            "interaction forces, the controller that knows them, the planner",
            "swarm_envs.training.reproduce.options",
        ),
        "dmpc-swarm": Paper(
            "distributed MPC over a radio that loses messages",
            "swarm_envs.training.reproduce.dmpc_swarm.options",
        ),
        "rth3d": Paper(
            "paths for 100,000 labelled robots on three-dimensional grids",
            "swarm_envs.training.reproduce.rth3d.options",
        ),
    }
)
"""Every paper by the name that the command takes."""

ALL = "all"
"""In a paper's place: every table and figure of all of them."""


def load(paper: str) -> ModuleType:
    """The module that remakes what is in a paper, a key of `PAPERS`."""
    return importlib.import_module(PAPERS[paper].module)


def overview(program: str) -> str:
    """Which papers there are, for `--help`."""
    width = max(map(len, PAPERS))
    lines = [f"  {name.ljust(width)}  {paper.summary}" for name, paper in PAPERS.items()]
    return "\n".join(
        [
            f"usage: {program} PAPER [options]",
            "",
            "papers:",
            *lines,
            f"  {ALL.ljust(width)}  every table and figure of these, beside the papers' values",
            "",
            f"`{program} PAPER --help` lists its figures and tables.",
        ]
    )
