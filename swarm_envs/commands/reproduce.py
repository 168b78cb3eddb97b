"""`swarm-envs reproduce PAPER` and `swarm-envs reproduce all`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from swarm_envs.commands.checks import Misuse, check_outputs, need_torch

PROGRAM = "swarm-envs reproduce"
"""What is typed before the paper."""


def reproduce_paper(
    arguments: Sequence[str], read: Callable[[str, type[Any], Sequence[str]], Any]
) -> int:
    """Remake a figure or a table of a paper, or all of all papers."""
    from swarm_envs.errors import unknown_name
    from swarm_envs.training.reproduce import papers

    if not arguments or arguments[0] in ("-h", "--help"):
        print(papers.overview(PROGRAM))
        return 0 if arguments else 2
    paper = arguments[0]
    if paper not in (papers.ALL, *papers.PAPERS):
        raise Misuse(unknown_name("paper", paper, (papers.ALL, *papers.PAPERS)))
    if paper == papers.ALL:
        return _run_all(arguments[1:], read)
    options = read(f"reproduce {paper}", papers.load_paper(paper).OPTIONS, arguments[1:])
    if options.chosen.needs_torch:
        need_torch()
    from swarm_envs.training.reproduce.reproduce_all import run_chosen

    print(run_chosen(options))
    return 0


def _run_all(arguments: Sequence[str], read: Callable[[str, type[Any], Sequence[str]], Any]) -> int:
    from swarm_envs.training.reproduce.reproduce_all import ReproduceAllOptions, reproduce_all

    options = read("reproduce all", ReproduceAllOptions, arguments)
    if not options.list:
        check_outputs(options.out, options.json)
    said, complete = reproduce_all(options)
    print(said)
    return 0 if complete else 1
