"""Every study runs tiny, is killed and resumes; `reproduce all` leaves nothing out and compares."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import tyro

from swarm_envs.cli import main
from swarm_envs.training.collection.__main__ import CollectOptions
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.reproduce import identified_vehicles, limits_study
from swarm_envs.training.reproduce.claims import (
    Between,
    Claim,
    Extent,
    Reason,
    about,
    format_quantity,
)
from swarm_envs.training.reproduce.limits_study import Sweep
from swarm_envs.training.reproduce.papers import PAPERS, Paper, load_paper, numbered_studies
from swarm_envs.training.reproduce.reproduce_all import (
    RECORD,
    ReproduceAllOptions,
    asking,
    choose_studies,
    outcome_of,
    run_many,
    steps_of,
)
from swarm_envs.training.reproduce.study import run_cells, run_study
from tests.helpers.papers import CLAIMS, MISSING, Runs, everything_into
from tests.helpers.tiny_fits import rows_of

ITEMS = numbered_studies()
NUMBERED = {
    "neural-swarm2": [f"Fig. {n}" for n in range(1, 10)] + ["Table I", "Table II", "Table III"],
}
"""What the papers number, by their captions."""
FOUND = ["agrees", "explained", "unexplained", "ours alone"]


def test_every_numbered_table_and_figure_is_there_once():
    for paper, labels in NUMBERED.items():
        assert [i.label for i in ITEMS.values() if i.paper == paper] == labels
    assert set(NUMBERED) == set(PAPERS)
    assert sum(map(len, NUMBERED.values())) == len(ITEMS)


COMMANDS = [
    pytest.param(study, quick, id=f"{study.key}-{'quick' if quick else 'full'}")
    for study in ITEMS.values()
    if not study.missing
    for quick in (True, False)
]


@pytest.fixture
def paper(monkeypatch):
    monkeypatch.setitem(PAPERS, "paper", Paper("A paper", "", "tests.helpers.papers"))


def read_collection(words):
    return tyro.cli(CollectOptions, args=words, config=(tyro.conf.OmitArgPrefixes,))


@pytest.mark.parametrize(("study", "quick"), COMMANDS)
def test_commands_are_what_the_command_line_takes(study, quick, tmp_path):
    rows = tmp_path / "rows.npz"
    rows.touch()
    options = ReproduceAllOptions(out=tmp_path, quick=quick, data=rows, seed=7)
    for step in steps_of(options, study):
        program, command, *words = shlex.split(step.command)
        assert program == "swarm-envs"
        if command == "collect":
            wanted = step.run.args[0]  # type: ignore[attr-defined]
            assert read_collection(words) == wanted and wanted.config.seed == 7
            continue
        assert (command, words[0]) == ("reproduce", study.paper)
        kind = load_paper(study.paper).OPTIONS
        read = tyro.cli(kind, args=words[1:], config=(tyro.conf.OmitArgPrefixes,))
        assert read == step.run.args[0] and read.chosen is study  # type: ignore[attr-defined]
        assert (read.out, read.seed) == (tmp_path / study.key, 7)


def test_rows_are_collected_where_none_are_given(tmp_path):
    options = ReproduceAllOptions(out=tmp_path, quick=True)
    collect, fit = steps_of(options, ITEMS["neural-swarm2/table-3"])
    read = read_collection(shlex.split(collect.command)[2:])
    words = shlex.split(fit.command)
    assert words[words.index("--data") + 1] == str(read.out / "rows.npz")


def test_a_reason_explains_in_its_direction_alone():
    reason = Reason("calmer air", Between(0.0, 7.0))
    claims = [
        Claim("error", "7", ours, about(7.0, 0.1), (reason,)) for ours in (7.5, 0.5, 15.0, math.nan)
    ]
    found = ["agrees", "explained", "unexplained", "unexplained"]
    assert [claim.agreement for claim in claims] == found
    assert [claim.reason for claim in claims] == [None, reason, None, None]
    assert [claim.agreement for claim in CLAIMS] == FOUND
    assert json.loads(json.dumps(claims[-1].as_json(), allow_nan=False))["ours"] is None


def test_ranges_and_numbers_read_well():
    said = [str(Between(5.0)), str(Between(most=1.0)), str(Between(12, 12)), str(about(-10.0, 0.2))]
    assert said == ["at least 5", "at most 1", "12", "-12 to -8"]
    numbers = [format_quantity(x) for x in (0.12345, 12.0, 124416, 1234.5)]
    assert numbers == ["0.123", "12", "124416", "1234"]


def test_a_spread_has_a_name():
    with pytest.raises(ValueError, match="say what it is"):
        Claim("error", "7", 1.0, spread=(0.0, 2.0))


def test_a_study_is_remade_or_says_why_not():
    with pytest.raises(ValueError, match="say how it is reproduced, or why not"):
        replace(MISSING, missing="")
    with pytest.raises(ValueError, match="say which claims"):
        replace(Runs().study("a"), claims=None)


def run_them(out, studies, **given):
    return run_many(everything_into(out), studies, lambda some: None, progress=False, **given)


def test_one_that_fails_is_named_and_the_others_go_on(tmp_path, paper):
    runs = Runs(a=ValueError("no"), b=RuntimeError("no <air>"))
    found = run_them(tmp_path, [runs.study("a"), runs.study("b"), MISSING, runs.study("c")])
    assert [o.state for o in found.values()] == ["failed", "failed", "not remade", "done"]
    assert found["paper/figure-b"].error == "RuntimeError: no <air>"
    assert [claim.agreement for claim in found["paper/figure-c"].claims] == ["agrees", *FOUND]
    assert "Traceback" in (tmp_path / "paper/figure-b/said.txt").read_text()
    assert "--figure c\nsaid" in (tmp_path / "paper/figure-c/said.txt").read_text()


def test_what_is_complete_is_kept_and_the_rest_redone(tmp_path, paper):
    said: list[str] = []
    runs = Runs(b=KeyboardInterrupt(), c=ValueError("no"))
    studies = [runs.study(letter) for letter in "abc"]
    with pytest.raises(KeyboardInterrupt):
        run_them(tmp_path, studies, say=said.append)
    assert runs.asked == ["a", "b"] and not said
    run_them(tmp_path, studies[2:], say=said.append)
    runs.fails = {}
    found = run_them(tmp_path, studies, say=said.append)
    assert runs.asked == ["a", "b", "c", "b", "c"]  # a stands, what failed is tried again
    assert {o.state for o in found.values()} == {"done"}
    assert said == ["resuming: 1 items are complete, 2 are to be done; paper/figure-b resumes"]


def test_a_record_that_is_damaged_counts_for_nothing(tmp_path, paper):
    one, options = Runs().study("a"), everything_into(tmp_path)
    run_them(tmp_path, [one])
    assert outcome_of(options, one).state == "done"
    (tmp_path / one.key / RECORD).write_text('{"state": "do')
    assert outcome_of(options, one).state == "not run"


def test_numbers_that_cannot_be_read_fail_the_item(tmp_path, paper):
    (outcome,) = run_them(tmp_path, [Runs().study("a", pictures=("b.png",))]).values()
    assert outcome.state == "failed" and "b.png" in outcome.error


def test_the_command_writes_a_page_of_all_items_and_goes_on(tmp_path, capsys, monkeypatch):
    command = ["reproduce", "all", "--quick", "--out", str(tmp_path)]
    wanted = ["--items", "neural-swarm2/table-1"]
    assert main([*command, *wanted]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    states = {entry["item"]: entry["state"] for entry in results["items"]}
    assert list(states) == list(ITEMS) and states["neural-swarm2/table-1"] == "done"
    shown = (tmp_path / "index.html").read_text()
    assert all(f'id="{key.replace("/", "-")}"' in shown for key in ITEMS)
    assert "mass" in (tmp_path / "neural-swarm2/table-1/said.txt").read_text()

    def fails(*arguments, **options):
        raise RuntimeError("run again")

    monkeypatch.setattr(identified_vehicles, "mass_and_thrust", fails)
    assert main([*command, *wanted]) == 0
    assert "resuming: 1 items are complete, 0 are to be done" in capsys.readouterr().out
    (tmp_path / "neural-swarm2/table-1" / RECORD).unlink()
    assert main([*command, *wanted]) == 1
    assert "failed: neural-swarm2/table-1: RuntimeError: run again" in capsys.readouterr().out
    assert "run again" in (tmp_path / "index.html").read_text()


def test_a_folder_of_another_run_is_refused(tmp_path, capsys):
    assert (
        main(["reproduce", "all", "--out", str(tmp_path), "--items", "neural-swarm2/figure-2"]) == 0
    )
    assert main(["reproduce", "all", "--quick", "--out", str(tmp_path)]) == 1
    assert "preset is full there, quick here" in capsys.readouterr().err


def test_items_are_listed_and_unknown_ones_refused(capsys):
    assert main(["reproduce", "all", "--list"]) == 0
    listed = capsys.readouterr().out
    assert all(key in listed for key in ITEMS)
    with pytest.raises(ValueError, match="did you mean 'neural-swarm2/figure-5'"):
        choose_studies(("neural-swarm2/figure5",))


TINY: dict[str, dict[str, Any]] = {
    "neural-swarm2/figure-1": {"episodes": 1, "engine": "batch"},
    "neural-swarm2/figure-5": {"model": "wake"},
    "neural-swarm2/figure-6": {"trials": 1, "engine": "batch"},
    "neural-swarm2/figure-7": {"trials": 1, "engine": "batch", "scenarios": ("SL",)},
    "neural-swarm2/figure-8": {
        **{"episodes": 2, "engine": "batch", "truth": "wake"},
        "cases": ("L2S", "S2S*"),
    },
    "neural-swarm2/figure-9": {"episodes": 1, "engine": "batch"},
    "neural-swarm2/table-1": {},
    "neural-swarm2/table-3": {"steps": 3, "seeds": 1, "cells": ("H=20,L=4", "H=10")},
    "neural-swarm2/study-lag": {"episodes": 1, "engine": "batch"},
    "neural-swarm2/study-ball": {"episodes": 1},
    "neural-swarm2/study-limits": {"episodes": 1},
    "neural-swarm2/study-hall": {"episodes": 2, "engine": "batch", "truth": "wake"},
}
"""Options with which each study takes seconds."""
SLOW = {"neural-swarm2/figure-6", "neural-swarm2/figure-7", "neural-swarm2/study-ball"}
STUDIES = {s.key: s for p in PAPERS for s in load_paper(p).STUDIES if s.report is not None}
EVERY = [pytest.param(key, marks=[pytest.mark.slow] * (key in SLOW), id=key) for key in STUDIES]


@pytest.fixture
def few(monkeypatch):
    """Few drones and few points where options cannot ask for few."""
    noise = next(sweep for sweep in limits_study.all_sweeps() if sweep.name == "noise")
    points = [p for p in noise.points if p.case == "S2S" and p.value in (0.0, 6.0)]
    monkeypatch.setattr(limits_study, "all_sweeps", lambda: [Sweep("noise", "noise", points)])


def options_of(study, out, json=None):
    data = {}
    if study.needs_torch:
        data["data"] = out.parent / "rows.npz"
        save_rows(data["data"], rows_of())
    kind = load_paper(study.paper).OPTIONS
    return asking(kind, study, out=out, json=json, **data, **TINY[study.key])


def counting(study, computed, most=None):
    """The study, but for counting the cells that are computed, and being killed after some."""

    def grid(options):
        def counted(name, compute):
            def cell():
                if len(computed) == most:
                    raise KeyboardInterrupt
                computed.append(name)
                return compute()

            return cell

        return {name: counted(name, compute) for name, compute in study.grid(options).items()}

    return replace(study, grid=grid)


@pytest.mark.parametrize("key", EVERY)
def test_a_study_is_killed_goes_on_and_names_its_claims(key, tmp_path, few):
    study, numbers = STUDIES[key], tmp_path / "numbers.json"
    options = options_of(study, tmp_path / "out", numbers)
    computed: list[str] = []
    if study.grid is not None:
        with pytest.raises(KeyboardInterrupt):
            run_study(counting(study, computed, most=1), options, progress=False)
        study = counting(study, computed)
    summary, said = run_study(study, options, progress=False)
    if study.settings is not None:  # the others keep each cell in a file that is read again
        assert len(computed) == len(set(computed)) == len(list(study.grid(options)))
        kept = len(computed)
        assert run_study(study, options, progress=False)[1] == said and len(computed) == kept
    assert json.loads(numbers.read_text()) == json.loads(json.dumps(summary))
    written = said.splitlines()[-1].removeprefix("wrote ").split(", ")
    assert all(Path(file).stat().st_size > 100 for file in written)
    if study.numbered:
        claims = list(study.claims(json.loads(numbers.read_text()), Extent(quick=True)))
        assert claims and len({claim.quantity for claim in claims}) == len(claims)


REFUSED = {
    "neural-swarm2": [
        ("", "give one of --figure 1, --figure 5"),
        ("--figure 5 --table 3", "give one of --figure 1, --figure 5"),
        ("--figure 2", "2"),
        ("--figure 5 --belief x", "but for --figure 1 or --figure 8 or --figure 9"),
        ("--figure 6 --scenarios SS", "--scenarios has no meaning for --figure 6"),
        ("--figure 7 --scenarios S", "a swap takes two"),
        ("--figure 7 --truth none", "no belief ships"),
        ("--figure 8 --cases S2M", "case 'S2M'"),
        ("--figure 8 --episodes 5000", "at most 1000"),
        ("--figure 8 --belief x.safetensors", "name its force model by --truth"),
        ("--figure 8 --truth wake --belief no.safetensors", "no.safetensors"),
        ("--figure 8 --truth none", "no belief ships"),
        ("--table 3", "--data PATH"),
        ("--table 3 --data x.npz --cells H=11", "did you mean 'H=10'"),
    ],
}
"""Options of each paper that cannot be, and what is said of them."""


@pytest.mark.parametrize(
    ("paper", "words", "said"),
    [(paper, *case) for paper, cases in REFUSED.items() for case in cases],
)
def test_options_that_cannot_be_are_refused(paper, words, said, tmp_path, refused):
    assert said in refused(
        "reproduce", paper, *words.split(), "--out", tmp_path / "out", codes=(1, 2)
    )
    assert not (tmp_path / "out").exists()


def test_cells_of_other_settings_and_damaged_ones_are_refused(tmp_path):
    path = tmp_path / "cells.json"
    found = run_cells({"a": lambda: {"value": 1}}, path, {"seed": 0}, progress=False)
    assert found == {"a": {"value": 1}}
    with pytest.raises(ValueError, match="options: seed is 0 there, 1 here"):
        run_cells({}, path, {"seed": 1}, progress=False)
    path.write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        run_cells({}, path, {"seed": 0}, progress=False)
