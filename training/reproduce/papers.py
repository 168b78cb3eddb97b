"""The paper whose figures and tables can be reproduced."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from swarm_envs.training.reproduce.study import Study


@dataclass(frozen=True)
class Paper:
    """A paper of which something can be reproduced."""

    title: str  # Of the paper
    summary: str  # What is reproduced, in a line
    module: str
    """Has `OPTIONS`, the command's dataclass of options, and `STUDIES`, everything it numbers."""


_PACKAGE = "swarm_envs.training.reproduce"
PAPERS = {
    "neural-swarm2": Paper(
        "Neural-Swarm2: Planning and Control of Heterogeneous Multirotor Swarms using Learned "
        "Interactions",
        "interaction forces, the controller that knows them, the planner",
        f"{_PACKAGE}.neural_swarm2",
    ),
}
"""Every paper by the name that the command takes."""

ALL = "all"  # In a paper's place: every table and figure of all of them


def load_paper(paper: str) -> Any:
    """The module of a paper, a key of `PAPERS`."""
    return importlib.import_module(PAPERS[paper].module)


def numbered_studies() -> dict[str, Study]:
    """Every numbered table and figure of the papers by key, such as `neural-swarm2/table-3`."""
    studies = (study for paper in PAPERS for study in load_paper(paper).STUDIES)
    return {study.key: study for study in studies if study.numbered}


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
            f"  {ALL.ljust(width)}  every table and figure of these, with the papers' values",
            "",
            f"`{program} PAPER --help` lists its figures and tables.",
        ]
    )
