"""`swarm-envs reproduce PAPER` and `swarm-envs reproduce all`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from swarm_envs.commands.checks import Misuse, check_file, check_folder, need_torch

PROGRAM = "swarm-envs reproduce"
"""What is typed before the paper."""


def run_reproduce(
    arguments: Sequence[str],
    read: Callable[[str, type[Any], Sequence[str]], Any],
    execute: Callable[[Sequence[str]], int],
) -> int:
    """Remake a figure or a table of a paper, or all of all papers.

    Args:
        arguments: after `reproduce`.
        read: reads a command's options into their dataclass.
        execute: runs the words of a `swarm-envs` command and gives its exit code.

    Returns:
        The exit code.

    Raises:
        BlockingIOError: another process writes into the folder.
        Misuse: there is no such paper.
        ValueError: a model, a table or an older run is not what it should be.
    """
    from swarm_envs.errors import unknown_name
    from swarm_envs.files import claimed
    from swarm_envs.training.reproduce import papers

    if not arguments or arguments[0] in ("-h", "--help"):
        print(papers.overview(PROGRAM))
        return 0 if arguments else 2
    paper = arguments[0]
    if paper == papers.ALL:
        return _run_all(read(f"reproduce {paper}", _all_options(), arguments[1:]), execute)
    if paper not in papers.PAPERS:
        raise Misuse(unknown_name("paper", paper, (papers.ALL, *papers.PAPERS)))
    works = papers.load(paper)
    options = read(f"reproduce {paper}", works.ReproduceOptions, arguments[1:])
    if options.needs_torch:
        need_torch()
    with claimed(options.out):
        print(works.run(options))
    return 0


def _all_options() -> type[Any]:
    from swarm_envs.training.reproduce.everything.options import ReproduceOptions

    return ReproduceOptions


def _run_all(options: Any, execute: Callable[[Sequence[str]], int]) -> int:
    from swarm_envs.training.reproduce.everything.options import run as remake

    if not options.list:
        check_folder("--out", options.out)
        if options.json is not None:
            check_file("--json", options.json)
    said, complete = remake(options, execute)
    print(said)
    return 0 if complete else 1
