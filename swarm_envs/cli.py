"""The command `swarm-envs`; each subcommand is imported when it is called."""

from __future__ import annotations

import difflib
import importlib
import inspect
import io
import os
import re
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import is_dataclass
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, get_type_hints

from swarm_envs import TASKS, __version__, task_family
from swarm_envs.commands.checks import Misuse, forget_output
from swarm_envs.errors import nearest, unknown_name
from swarm_envs.user_files import users_line

PROGRAM = "swarm-envs"  # The command's name
DONE, FAILED, MISUSED, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""
HELP = frozenset({"-h", "--help"})
"""Arguments that request the help text."""
NARROWEST = 60  # Least columns of a help text; tyro does not terminate with much fewer
WIDE = 10_000  # Columns in which tyro does not wrap error messages


class Command(NamedTuple):
    """A subcommand: `run_<name>` of the module `swarm_envs.commands.<name>`.

    Its argument is the module's dataclass `<Name>Options`; it may return a number of failures.
    """

    summary: str
    """One line for the list of commands."""
    example: str
    """An example of its options for the help text."""
    prefixes: bool = False
    """True if options of a nested dataclass have its name as a prefix: `--logs.rate-hz`."""


COMMANDS: Mapping[str, Command] = {
    "demo": Command(
        "simulate stacked swaps with and without compensation of downwash", "--out demo"
    ),
    "fly": Command(
        "simulate one episode and write metrics, videos, replays and trajectories",
        "--layout stacked --team L2S --agent tracking --seed 1 --out flight",
    ),
    "evaluate": Command(
        "evaluate agents on many episodes",
        "--layout random --agent swap-dagger straight-line --episodes 64 --json out.json",
    ),
    "benchmark": Command("evaluate every agent on every benchmark task", "--out board --workers 2"),
    "grade": Command(
        "grade the submissions of a course",
        "--assignment swap --agent my.py:MyAgent --out grades.csv",
    ),
    "assignment": Command(
        "list or start the assignments of a course", "start controller my-controller"
    ),
    "collect": Command("collect flight logs in simulation", "--out flights --seed 0"),
    "train": Command(
        "train a policy with PPO, SAC, TD3 or DAgger",
        "--layout random --algo ppo --drones 4 --steps 3000000 --out runs/a",
        prefixes=True,
    ),
    "fit": Command(
        "fit a force model to flight logs, or identify its residual force",
        "--data flights --model deep-set --seed 0 --out runs/fit",
        prefixes=True,
    ),
    "compile": Command("compile the kernels before the first episode", "--no-progress"),
}
"""Every command by its name. To add one, write its module and add it here."""
_SIMILAR = "Perhaps you meant:|Arguments similar to"  # Before similar options and their help texts
_NEAR = 0.75  # Least similarity of an option that is suggested
_WORD = re.compile(r"Unrecognized options: (\w[\w-]*)")
_NOT_A_NUMBER = re.compile(
    r"Error parsing (--\S+): .*\b(INT|FLOAT|int|float)\b[^'\"]*['\"](.*)['\"]"
)
_NO_CHOICE = re.compile(r"invalid choice '(.*)' for argument '(\S+)'. Expected one of (\(.*\))")
_KINDS = {"int": "an integer", "float": "a number"}
_LISTS = ("--agent", "--env", "--set")  # If one is given again, tyro forgets the values before


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code."""
    _print_every_name()
    try:
        return _run(list(sys.argv[1:] if arguments is None else arguments))
    except BrokenPipeError:
        forget_output()
        return DONE


def _run(given: Sequence[str]) -> int:
    """Run a command line and return its exit code.

    Raises:
        BrokenPipeError: the reader of the output has ended, such as `| head`; no failure.
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
            failed = load_run(name)(read_options(name, rest))
        sys.stdout.flush()  # so that a closed pipe or a full disk is reported here
        return FAILED if failed else DONE
    except Misuse as error:
        return _complain(where, str(error), MISUSED)
    except (OSError, ImportError, ValueError, MemoryError) as error:
        if isinstance(error, BrokenPipeError):
            raise
        forget_output()
        message = " ".join(str(error).splitlines()) or "there is not enough memory"
        return _complain(where, message, FAILED)
    except KeyboardInterrupt as interrupt:
        return _complain(where, str(interrupt) or "interrupted", INTERRUPTED)
    except Exception as error:
        place = users_line(error)
        if place is None:
            raise
        return _complain(where, f"{place} raises {type(error).__name__}: {error}", FAILED)


def _print_every_name() -> None:
    """Let the output escape what its encoding lacks, as stderr does: paths and names hold anything.

    Else a command would fail by its last line, as in a file of Windows' cp1252, with its work done.
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end a command like Ctrl-C, so that it removes incomplete files."""

    def end(*_: object) -> None:
        raise KeyboardInterrupt("terminated")

    if threading.current_thread() is not threading.main_thread():  # signals cannot be set there
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
    example = f"Example: {PROGRAM} fly {COMMANDS['fly'].example}"
    return "\n".join([*head, *lines, "", f"{explains}; {version}", example])


def load_run(name: str) -> Any:
    """Return the function of a command."""
    return getattr(importlib.import_module(f"swarm_envs.commands.{name}"), f"run_{name}")


def load_options(name: str) -> Any:
    """Return the dataclass of a command's options."""
    module = importlib.import_module(f"swarm_envs.commands.{name}")
    return getattr(module, f"{name.title()}Options")


def read_options(name: str, words: Sequence[str]) -> Any:
    """Read a command's options into their dataclass.

    Args:
        name: the command.
        words: the command line after its name.

    Raises:
        Misuse: an option does not exist, or has an invalid value.
        SystemExit: the help text was requested and printed.
    """
    import tyro

    options, program = load_options(name), f"{PROGRAM} {name}"
    for word in words:
        if not word or re.fullmatch("--[^=]+=", word):
            raise Misuse("the value of an option is empty; give a value, or leave the option out")
    names = [word.partition("=")[0] for word in words]
    for option in _LISTS:
        if names.count(option) > 1:
            raise Misuse(f"{option} is given twice; give it once, with all its values")
    for word, following in pairwise([*words, "--"]):
        if word in ("--env", "--set") and following.startswith("--"):
            raise Misuse(f"{word} has no value; give NAME=VALUE, or leave the option out")
    prefixes = () if COMMANDS[name].prefixes else (tyro.conf.OmitArgPrefixes,)
    about = _description(name, options)
    read = partial(tyro.cli, options, prog=program, description=about, config=prefixes)
    columns = WIDE
    if not HELP.isdisjoint(words):
        columns = max(NARROWEST, shutil.get_terminal_size().columns)
        _join_lines_of_help(options)
    printed = io.StringIO()
    try:
        with _columns(columns), redirect_stderr(printed):
            return read(args=[*words])
    except SystemExit as end:
        if not end.code:
            raise
        known = _option_names(partial(read, args=["--help"]))
        message = _in_one_line(printed.getvalue(), known)
    except ValueError as error:
        message = str(error)
    raise Misuse(f"{message} (see `{program} --help`)")


def _join_lines_of_help(options: type) -> None:
    """Let tyro wrap the docstrings of fields anew: it keeps line breaks before indented lines."""
    import tyro

    from swarm_envs.envs.options import field_docstrings

    for base in filter(is_dataclass, options.__mro__):
        kinds, texts = get_type_hints(base, include_extras=True), field_docstrings(base)
        unresolved = [n for n, kind in base.__annotations__.items() if isinstance(kind, str)]
        for name in unresolved:  # each is done once: its annotation is no string then
            if is_dataclass(kinds[name]):
                _join_lines_of_help(kinds[name])
            elif text := texts.get(name):
                base.__annotations__[name] = Annotated[kinds[name], tyro.conf.arg(help=text)]


@contextmanager
def _columns(number: int) -> Iterator[None]:
    """Let tyro write lines of a number of columns, independent of the terminal."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(number)
    try:
        yield
    finally:
        os.environ.pop("COLUMNS")
        if before is not None:
            os.environ["COLUMNS"] = before


def _option_names(show_help: Callable[[], object]) -> list[str]:
    """Return the names of a command's options, from the help text that a function prints."""
    printed = io.StringIO()
    with suppress(SystemExit), _columns(WIDE), redirect_stdout(printed):
        show_help()
    heads = re.findall("^ {1,4}(?:-h, )?(--.*)", printed.getvalue(), re.M)
    return [name for head in heads for name in re.findall(r"--[\w.-]*\w", head)]


def _in_one_line(box: str, names: Sequence[str]) -> str:
    """Return the reason of an error from tyro's box, without title, frame and help text.

    `names` are those of the command's options, of which the nearest are suggested.
    """
    text = re.sub("[\u2500\u2502\u2570\u256f]|-{4,}", " ", "\n".join(box.splitlines()[1:]))
    reason = re.sub(r"^Error parsing \w+: ", "", " ".join(text.split()))
    reason = re.split("Got errors:|Argument helptext:|For full helptext", reason)[0].strip()
    if number := _NOT_A_NUMBER.match(reason):
        option, kind, value = number.groups()
        return f"{option} is {value!r}, but must be {_KINDS[kind.lower()]}"
    if choice := _NO_CHOICE.match(reason):
        value, option, listed = choice.groups()
        valid = {*re.findall(r"'(.*?)'", listed)} - {"None"}
        return f"{option} is {value!r}; {nearest(value, valid)}"
    reason = re.split(_SIMILAR, reason)[0].strip()
    typed = [each for each in re.findall(r"--[\w.-]*\w", reason) if each not in names]
    near = [each for name in typed for each in difflib.get_close_matches(name, names, 1, _NEAR)]
    word = _WORD.search(reason)
    if word and "--task" in names and word[1] in {*TASKS, *map(task_family, TASKS)}:
        near.append(f"--task {word[1]}")
    hint = f"; did you mean {' and '.join(near)}?" if near else ""
    return reason + hint


def _description(name: str, options: Any) -> str:
    """Return the head of a command's help text: its docstring, and an example."""
    paragraphs = (inspect.getdoc(options) or "").split("\n\n")
    joined = [" ".join(paragraph.splitlines()) for paragraph in paragraphs]
    return "\n\n".join([*joined, f"Example: {PROGRAM} {name} {COMMANDS[name].example}"])


def _complain(where: str, message: str, code: int) -> int:
    sys.stderr.write(f"{where}: error: {message}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
