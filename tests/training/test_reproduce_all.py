"""`swarm-envs reproduce all`: nothing is left out, it goes on, numbers stand beside the papers."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace

import pytest
import tyro

from swarm_envs.cli import main
from swarm_envs.training.collection.__main__ import CollectOptions
from swarm_envs.training.reproduce import dmpc_figures
from swarm_envs.training.reproduce.claims import Between, Claim, Reason, about, format_quantity
from swarm_envs.training.reproduce.papers import PAPERS, Paper, load_paper, numbered_studies
from swarm_envs.training.reproduce.reproduce_all import (
    RECORD,
    ReproduceAllOptions,
    choose_studies,
    outcome_of,
    run_many,
    steps_of,
)
from tests.helpers.papers import CLAIMS, MISSING, Runs, everything_into

ITEMS = numbered_studies()
NUMBERED = {
    "neural-swarm2": [f"Fig. {n}" for n in range(1, 10)] + ["Table I", "Table II", "Table III"],
    "dmpc-swarm": ["Fig. 1", "Fig. 2", "Fig. 3a", "Fig. 3b", "Fig. 3c", "Fig. 4"],
    "rth3d": [f"Fig. {n}" for n in range(1, 12)],
}
"""What the papers number, by their captions; of RTH3D's Fig. 10 the text has nothing."""
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
    assert [format_quantity(x) for x in (0.12345, 12.0, 124416, 1234.5)] == [
        "0.123",
        "12",
        "124416",
        "1234",
    ]


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
    wanted = ["--items", "dmpc-swarm/figure-3a"]
    assert main([*command, *wanted]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    states = {entry["item"]: entry["state"] for entry in results["items"]}
    assert list(states) == list(ITEMS) and states["dmpc-swarm/figure-3a"] == "done"
    shown = (tmp_path / "index.html").read_text()
    assert all(f'id="{key.replace("/", "-")}"' in shown for key in ITEMS)
    assert "16 drones" in (tmp_path / "dmpc-swarm/figure-3a/said.txt").read_text()

    def fails(*arguments, **options):
        raise RuntimeError("run again")

    monkeypatch.setattr(dmpc_figures, "formation", fails)
    assert main([*command, *wanted]) == 0
    assert "resuming: 1 items are complete, 0 are to be done" in capsys.readouterr().out
    (tmp_path / "dmpc-swarm/figure-3a" / RECORD).unlink()
    assert main([*command, *wanted]) == 1
    assert "failed: dmpc-swarm/figure-3a: RuntimeError: run again" in capsys.readouterr().out
    assert "run again" in (tmp_path / "index.html").read_text()


def test_a_folder_of_another_run_is_refused(tmp_path, capsys):
    assert main(["reproduce", "all", "--out", str(tmp_path), "--items", "rth3d/figure-1"]) == 0
    assert main(["reproduce", "all", "--quick", "--out", str(tmp_path)]) == 1
    assert "was begun with preset 'full'" in capsys.readouterr().err


def test_items_are_listed_and_unknown_ones_refused(capsys):
    assert main(["reproduce", "all", "--list"]) == 0
    listed = capsys.readouterr().out
    assert all(key in listed for key in ITEMS)
    with pytest.raises(ValueError, match="did you mean 'rth3d/figure-5'"):
        choose_studies(("rth3d/figure5",))
