"""The command `swarm-envs`: one subcommand a job, each loaded when it is called."""

from __future__ import annotations

import importlib
import inspect
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from swarm_envs import __version__
from swarm_envs.arguments import Range, Seed
from swarm_envs.commands.checks import (
    Misuse,
    check_inputs,
    check_outputs,
    command_options,
    forget_output,
    need_torch,
)
from swarm_envs.errors import unknown_name
from swarm_envs.files import claimed, write_json

PROGRAM = "swarm-envs"  # The command's name
DONE, FAILED, MISUSED, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""
HELP = frozenset({"-h", "--help"})
"""Arguments that ask for help."""

Options = TypeVar("Options")


@dataclass(frozen=True)
class Command:
    """A subcommand."""

    summary: str  # One line for the list of commands
    run: Callable[[Sequence[str]], int]
    """Takes the arguments after the command's name and gives the exit code."""


@command_options
@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Fly stacked swaps with and without compensation of the downwash.

    Prints the worst height error of the lowest drone; writes a picture, a video and all results.
    """

    out: Path = Path("demo")
    """output folder for summary.json, demo.png and demo.mp4"""
    seed: Seed = 0
    """random seed of the swaps"""
    swaps: Annotated[int, Range(1, 1000)] = 6
    """number of random swaps per scenario; each is flown twice"""
    video: bool = True
    """render the video, which takes most of the time"""
    json: Path | None = None
    """also write the results to this file"""


def _run_demo(options: DemoOptions) -> int:
    check_outputs(options.out, options.json)
    from swarm_envs.baselines.neural_swarm.demo import crashed_flights, format_table, run_demo

    with claimed(options.out):
        summary = run_demo(options.out, options.seed, options.swaps, options.video)
    if options.json is not None:
        write_json(options.json, summary)
    print(format_table(summary), "", *(f"note: {note}" for note in summary["notes"]), sep="\n")
    files = [options.out / name for name in summary["files"].values() if name]
    print("wrote", ", ".join(map(str, [options.out / "summary.json", *files])))
    crashed = crashed_flights(summary)
    if crashed:
        message = f"{crashed} flights ended early: their worst error is a lower bound"
        _complain(f"{PROGRAM} demo", message, FAILED)
    return crashed


def _load(path: str) -> Any:
    """What `module:name` names; modules of the package without its name."""
    module, name = path.split(":")
    return getattr(importlib.import_module(f"swarm_envs.{module}"), name)


def _command(
    name: str, options: str, run: str | Callable[[Any], object], prefixes: bool = False
) -> Callable[[Sequence[str]], int]:
    """A command that reads options and runs a function, which may count failures."""

    def read_and_run(arguments: Sequence[str]) -> int:
        found = _read(name, _load(options), arguments, prefixes)
        return FAILED if (_load(run) if isinstance(run, str) else run)(found) else DONE

    return read_and_run


def _learner(
    name: str, options: str, function: str, prefixes: bool = False
) -> Callable[[Sequence[str]], int]:
    """A command that fits a model with a function that needs torch, and prints its report."""

    def learn(config: Any) -> None:
        check_outputs(config.out, config.json)
        need_torch()
        check_inputs(config)
        with claimed(config.out):
            report = _load(function)(config)
        print(*report.lines(), f"wrote the model and the report into {config.out}", sep="\n")
        if hasattr(config, "how_to_use"):
            print(*config.how_to_use(), sep="\n")

    return _command(name, options, learn, prefixes)


def _fit(arguments: Sequence[str]) -> int:
    """Fit a force model; with `--residual`, which has other options, what it leaves over."""
    module = "training.force_model."
    if "--residual" in arguments:
        options, function = "force_fit_config:ResidualConfig", "residual_fit:fit_residual"
        run = _learner("fit --residual", module + options, module + function, prefixes=True)
        return run([word for word in arguments if word != "--residual"])
    options, function = "force_fit_config:FitConfig", "pipeline:fit"
    return _learner("fit", module + options, module + function, prefixes=True)(arguments)


def _collect(options: Any) -> None:
    check_outputs(options.out, options.json)
    check_inputs(options.config)
    with claimed(options.out):
        _load("training.collection.__main__:run_collect")(options)


def _in_module(name: str) -> Callable[[Sequence[str]], int]:
    """Return a command whose module has `<Name>Options` and `run_<name>`."""
    place = f"commands.{name}"
    return _command(name, f"{place}:{name.title()}Options", f"{place}:run_{name}")


COMMANDS: Mapping[str, Command] = {
    "demo": Command(
        "stacked swaps with and without compensation of downwash",
        _command("demo", "cli:DemoOptions", _run_demo),
    ),
    "fly": Command(
        "fly one episode and write metrics, films, replays and trajectories", _in_module("fly")
    ),
    "evaluate": Command("evaluate agents on many episodes", _in_module("evaluate")),
    "benchmark": Command("evaluate every agent on every benchmark task", _in_module("benchmark")),
    "grade": Command("grade submissions of a course", _in_module("grade")),
    "assignment": Command("list or start the assignments of a course", _in_module("assignment")),
    "collect": Command(
        "collect flight logs in simulation",
        _command("collect", "training.collection.__main__:CollectOptions", _collect),
    ),
    "train": Command(
        "train a policy with PPO, SAC, TD3 or DAgger",
        _command(
            "train", "training.rl.rl_config:RlConfig", "commands.train:run_train", prefixes=True
        ),
    ),
    "fit": Command("fit a force model to flight logs; with --residual, what it leaves over", _fit),
}
"""Every command by its name. To add one, write a function like `_run_demo` and name it here."""

EXAMPLES: Mapping[str, str] = {
    "demo": "--out demo",
    "fly": "--layout stacked --team L2S --agent tracking --seed 1 --out flight",
    "evaluate": "--layout random --agent swap-dagger straight-line --episodes 64 --json out.json",
    "benchmark": "--out board --workers 2",
    "grade": "--assignment swap --agent my.py:MyAgent --seed 4711 --out grades.csv",
    "assignment": "start controller my-controller",
    "collect": "--out flights --seed 0",
    "train": "--layout random --algo ppo --drones 4 --steps 3000000 --out runs/a",
    "fit --residual": "--data flights --out runs/residual",
    "fit": "--data flights --model deep-set --seed 0 --out runs/fit",
}
"""What to type first, for the help of each command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code."""
    try:
        return _run(list(sys.argv[1:] if arguments is None else arguments))
    except BrokenPipeError:
        forget_output()
        return DONE


def _run(given: Sequence[str]) -> int:
    """Run a command line and return its exit code.

    Raises:
        BrokenPipeError: a help text was not read to its end, as by `| head`, which is no failure.
    """
    if not given or given[0] in HELP:
        print(_overview(), flush=True)
        return DONE if given else MISUSED
    if given[0] == "--version":
        print(f"{PROGRAM} {__version__}")
        return DONE
    name, rest = given[0], given[1:]
    if name not in COMMANDS:
        return _complain(
            PROGRAM, unknown_name("command", name, (*COMMANDS, "--help", "--version")), MISUSED
        )
    where = f"{PROGRAM} {name}"
    try:
        with _terminable():
            code = COMMANDS[name].run(rest)
        sys.stdout.flush()  # here it can be told that what reads it is gone, or a disk full
        return code
    except Misuse as error:
        return _complain(where, str(error), MISUSED)
    except (OSError, ImportError, ValueError, MemoryError) as error:
        if isinstance(error, BrokenPipeError) and not HELP.isdisjoint(rest):
            raise
        forget_output()  # and no traceback, which would not say more
        said = " ".join(str(error).splitlines()) or "there is not enough memory"
        return _complain(where, said, FAILED)
    except KeyboardInterrupt as interrupt:
        return _complain(where, str(interrupt) or "interrupted", INTERRUPTED)


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end a command like Ctrl-C, so that it removes what it has half written."""

    def end(*_: object) -> None:
        raise KeyboardInterrupt("terminated")

    if threading.current_thread() is not threading.main_thread():  # where signals cannot be set
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name.ljust(width)}  {c.summary}" for name, c in COMMANDS.items()]
    head = [f"usage: {PROGRAM} COMMAND [options]", "", "commands:"]
    explains = f"Run `{PROGRAM} COMMAND --help` for the options of a command"
    version = f"`{PROGRAM} --version` prints the version."
    example = f"Example: {PROGRAM} fly {EXAMPLES['fly']}"
    return "\n".join([*head, *lines, "", f"{explains}; {version}", example])


def _read(
    name: str, options: type[Options], arguments: Sequence[str], prefixes: bool = False
) -> Options:
    """Read a command's options into their dataclass; bad ones are explained, exit code 2.

    With `prefixes`, options of a nested dataclass are named after it: `--logs.guard-s`.
    """
    from swarm_envs.commands.mistakes import read_options

    description = _description(name, options)
    return read_options(options, arguments, f"{PROGRAM} {name}", prefixes, description)


def _description(name: str, options: type) -> str:
    """What the help of a command begins with: each paragraph of the docstring, and an example."""
    paragraphs = (inspect.getdoc(options) or "").split("\n\n")
    joined = [" ".join(paragraph.splitlines()) for paragraph in paragraphs]
    return "\n\n".join([*joined, f"Example: {PROGRAM} {name} {EXAMPLES[name]}"])


def _complain(where: str, message: str, code: int) -> int:
    sys.stderr.write(f"{where}: error: {message}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
