"""`swarm-envs reproduce all`: every numbered table and figure, one after another, on one page.

Each study has a folder of its own, which is complete or is gone on with.
"""

from __future__ import annotations

import dataclasses
import json
import shlex
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_type_hints

from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.errors import check_integer, check_name
from swarm_envs.files import claimed, write_json, written_whole
from swarm_envs.training.provenance import begin_manifest
from swarm_envs.training.reproduce.claims import Claim, Extent
from swarm_envs.training.reproduce.collected_flights import collect_rows, collection
from swarm_envs.training.reproduce.papers import load_paper, numbered_studies
from swarm_envs.training.reproduce.reproduce_page import html_page, markdown_page
from swarm_envs.training.reproduce.study import Study, StudyOptions, run_study

__all__ = ["ReproduceAllOptions", "reproduce_all", "run_chosen"]

_State = Literal["done", "failed", "not run", "not remade"]
"""Of a study: reproduced, failed, not asked for yet, and what no simulation reproduces."""
RECORD = "item.json"
"""Written last into a study's folder: it is complete, or has failed and says how."""
_SETTINGS = "settings.json"  # what all studies of a folder share


@dataclass(frozen=True, kw_only=True)
class ReproduceAllOptions:
    """Reproduce every table and figure of the three papers, and compare with the papers' values.

    Writes a folder for each item, `index.html` (all of it on one page, self-contained),
    `side_by_side.md` and `results.json`. Interrupted and run again it resumes; an item
    that fails is named on the page, stops no other, and is tried again the next time.
    """

    out: Path = Path("reproduce-all")
    """folder, made if missing"""
    quick: bool = False
    """few runs of small cases: minutes instead of hours"""
    items: tuple[str, ...] = ()
    """items to remake, such as neural-swarm2/table-3; all if none are named"""
    list: bool = False
    """list the items and end"""
    data: Path | None = None
    """rows of measured force for Table III, as `swarm-envs fit` reads them; collected in simulation
    if not given"""
    seed: int = 0
    """of every command"""
    json: Path | None = None
    """write the results to this file too"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: an unknown item, or a negative seed.
            FileNotFoundError: there are no such rows.
        """
        choose_studies(self.items)
        check_integer("seed", self.seed, 0)
        if self.data is not None and not self.data.exists():
            raise FileNotFoundError(
                f"no file of rows at {str(self.data)!r}; give its path by --data"
            )

    def folder(self, study: Study) -> Path:
        """Of a study."""
        return self.out / study.key

    @property
    def settings(self) -> dict[str, object]:
        """What all studies of the folder share."""
        return {
            "preset": "quick" if self.quick else "full",
            "seed": self.seed,
            "data": None if self.data is None else str(self.data.resolve()),
            "version": __version__,
        }


@dataclass(frozen=True)
class StudyOutcome:
    """What came of a study."""

    study: Study  # What was to be reproduced
    state: _State  # How it stands
    commands: tuple[str, ...] = ()  # What remakes it, as one types it
    claims: tuple[Claim, ...] = ()  # The paper's numbers and the results
    cpu_s: float = 0.0  # CPU time that it took, s; of the last part, if it was interrupted
    error: str = ""  # What went wrong

    def as_json(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return {
            "item": self.study.key,
            "label": self.study.label,
            "shows": self.study.shows,
            "state": self.state,
            "missing": self.study.missing,
            "error": self.error,
            "commands": list(self.commands),
            "cpu_s": self.cpu_s,
            "rows": [claim.as_json() for claim in self.claims],
        }


class _Step(NamedTuple):
    """One command of `swarm-envs` that a study takes."""

    command: str  # as one types it
    run: Callable[[], str]  # does the same, and gives what is left to print


def choose_studies(keys: Sequence[str]) -> list[Study]:
    """Numbered studies by key, in the papers' order; all if none are named."""
    studies = numbered_studies()
    for key in keys:
        check_name("item", key, studies)
    return [study for key, study in studies.items() if not keys or key in keys]


def steps_of(options: ReproduceAllOptions, study: Study) -> list[_Step]:
    """The commands that remake a study; rows of measured force are collected unless `--data` is."""
    folder, steps = options.folder(study), []
    given: dict[str, Any] = {"out": folder, "seed": options.seed}
    if study.numbers:
        given["json"] = folder / study.numbers
    if study.collects is not None:
        flights = study.collects[options.quick]
        if study.report is None or options.data is None:
            words, wanted = collection(folder, flights, options.seed)
            steps.append(_Step(_shell(words), partial(collect_rows, wanted)))
        given["data"] = options.data or folder / "flights" / "rows.npz"
    if study.report is not None:
        given |= study.quick if options.quick else study.full
        made = asking(load_paper(study.paper).OPTIONS, study, **given)
        steps.append(_Step(_shell(_words_of(made)), partial(run_chosen, made)))
    return steps


def asking(kind: type[StudyOptions], study: Study, **given: Any) -> StudyOptions:
    """Options that ask for a study: `figure=8` for `figure-8`."""
    name, _, value = study.name.partition("-")
    hint = get_type_hints(kind)[name]  # such as Literal[1, 3] | None
    choices = [choice for part in (hint, *get_args(hint)) for choice in get_args(part)]
    return kind(**{name: next(c for c in choices if str(c) == value)}, **given)


def run_chosen(options: StudyOptions) -> str:
    """Do what `swarm-envs reproduce PAPER` does with these options, and give what it prints."""
    with claimed(options.out):
        return run_study(options.chosen, options)[1]


def _words_of(options: StudyOptions) -> list[str]:
    """A command's words after `swarm-envs`, without options that have their default."""
    words = ["reproduce", options.paper]
    for entry in dataclasses.fields(options):
        value, flag = getattr(options, entry.name), f"--{entry.name.replace('_', '-')}"
        if value == entry.default:
            continue
        if isinstance(value, bool):
            words.append(flag if value else f"--no-{flag.removeprefix('--')}")
        else:
            words += [flag, *map(str, value if isinstance(value, tuple) else (value,))]
    return words


def _shell(words: Sequence[str]) -> str:
    return shlex.join(["swarm-envs", *words])


def outcome_of(options: ReproduceAllOptions, study: Study) -> StudyOutcome:
    """State of a study in its folder, without running anything."""
    if study.missing:
        return StudyOutcome(study, "not remade")
    commands = tuple(step.command for step in steps_of(options, study))
    path = options.folder(study) / RECORD
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        cpu_s, error = float(record["cpu_s"]), record["error"]
        found = StudyOutcome(study, record["state"], commands, (), cpu_s, error)
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return StudyOutcome(study, "not run", commands)
    return _with_claims(options, found) if found.state == "done" else found


def _with_claims(options: ReproduceAllOptions, outcome: StudyOutcome) -> StudyOutcome:
    """The outcome with its claims; failed if its numbers or pictures cannot be read."""
    study, folder = outcome.study, options.folder(outcome.study)
    assert study.claims is not None
    extent = Extent(options.quick, (folder / "flights").exists())
    try:
        path = folder / (study.numbers or f"{study.file}.json")
        claims = tuple(study.claims(json.loads(path.read_text(encoding="utf-8")), extent))
        absent = [name for name in study.pictures if not (folder / name).is_file()]
        if not claims or absent:
            raise ValueError(f"it left no {', '.join(absent) or 'numbers'}")
    except Exception as error:  # whatever is wrong with one study, the others stand
        said = f"its numbers cannot be read: {type(error).__name__}: {error}"
        return replace(outcome, state="failed", error=said)
    return replace(outcome, claims=claims)


def _run_one(options: ReproduceAllOptions, study: Study) -> StudyOutcome:
    """Remake a study, and record what came of it."""
    folder, begin, error = options.folder(study), time.process_time(), ""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / RECORD).unlink(missing_ok=True)
    steps = steps_of(options, study)
    with (folder / "said.txt").open("w", encoding="utf-8") as said, redirect_stdout(said):
        try:
            for step in steps:
                said.write(f"$ {step.command}\n")
                said.write(f"{step.run()}\n")
        except Exception as failure:
            said.write(traceback.format_exc())
            error = f"{type(failure).__name__}: {failure}"
    cpu_s = round(time.process_time() - begin, 1)
    commands = tuple(step.command for step in steps)
    outcome = StudyOutcome(study, "failed" if error else "done", commands, (), cpu_s, error)
    if not error:
        outcome = _with_claims(options, outcome)
    write_json(
        folder / RECORD, {"state": outcome.state, "error": outcome.error, "cpu_s": outcome.cpu_s}
    )
    return outcome


def run_many(
    options: ReproduceAllOptions,
    studies: Sequence[Study],
    each: Callable[[Mapping[str, StudyOutcome]], None],
    progress: bool = True,
    say: Callable[[str], None] = print,
) -> dict[str, StudyOutcome]:
    """Run what is not complete; one that fails stops no other. `each` gets all outcomes so far."""
    found = {study.key: outcome_of(options, study) for study in studies}
    todo = [study for study in studies if found[study.key].state in ("not run", "failed")]
    done = sum(outcome.state == "done" for outcome in found.values())
    if done:
        begun = [s.key for s in todo if options.folder(s).is_dir()]
        begun = [key for key in begun if found[key].state == "not run"]
        gone = f"; {', '.join(begun)} resumes" if begun else ""
        say(f"resuming: {done} items are complete, {len(todo)} are to be done{gone}")
    total = done + len(todo)
    with tqdm(total=total, initial=done, desc="items", unit="item", disable=not progress) as bar:
        for study in todo:
            bar.set_postfix_str(study.key)
            found[study.key] = _run_one(options, study)
            each(found)
            bar.update()
    return found


def reproduce_all(options: ReproduceAllOptions) -> tuple[str, bool]:
    """Remake what was asked for.

    Returns what to print, and whether everything that was asked for was done.

    Raises:
        ValueError: the folder holds a run of other settings.
        BlockingIOError: another process writes into it.
        OSError: it cannot be written.
    """
    if options.list:
        studies = numbered_studies()
        width, lines = max(map(len, studies)), list[str]()
        for key, study in studies.items():
            why = f" [not reproduced: {study.missing}]" if study.missing else ""
            lines.append(f"{key.ljust(width)}  {study.shows}{why}")
        return "\n".join(lines), True
    with claimed(options.out):
        begin_manifest(options.out / _SETTINGS, options.settings)
        others = {key: outcome_of(options, study) for key, study in numbered_studies().items()}
        wanted = choose_studies(options.items)
        found = run_many(options, wanted, lambda some: _write(options, {**others, **some}))
        everything = {**others, **found}
        _write(options, everything)
    failed = [outcome for outcome in found.values() if outcome.state == "failed"]
    lines = [f"failed: {outcome.study.key}: {outcome.error}" for outcome in failed]
    spent = sum(outcome.cpu_s for outcome in everything.values())
    lines.append(f"{spent / 60:.1f} minutes of CPU time")
    lines.append(f"wrote {options.out / 'index.html'}, side_by_side.md and results.json")
    return "\n".join(lines), not failed


def _write(options: ReproduceAllOptions, outcomes: Mapping[str, StudyOutcome]) -> None:
    """The page, the table and the results of what there is by now."""
    listed = list(outcomes.values())
    content = {**options.settings, "items": [outcome.as_json() for outcome in listed]}
    write_json(options.out / "results.json", content)
    if options.json is not None:
        write_json(options.json, content)
    texts = {
        "index.html": html_page(listed, _about(options.quick), options.out),
        "side_by_side.md": markdown_page(listed, _about(options.quick)),
    }
    for name, text in texts.items():
        with written_whole(options.out / name) as partial_file:
            partial_file.write_text(text, encoding="utf-8")


def _about(quick: bool) -> tuple[str, ...]:
    how = (
        "Few runs of small cases (`--quick`): without it there are the papers' sizes and counts."
        if quick
        else "Sizes and counts as in the papers, where the text gives them."
    )
    return (
        f"Every table and figure of three papers, reproduced by `swarm-envs reproduce all"
        f"{' --quick' if quick else ''}` (swarm-envs {__version__}). {how}",
        "Each number has a range that counts as the paper's. What lies "
        "outside is explained only if a known reason covers it, in its direction and so far; else "
        "it stands as unexplained.",
    )
