"""`swarm-envs reproduce all`: that nothing is left out, that it goes on, and who is told what."""

from __future__ import annotations

import json
import math
from dataclasses import fields

import pytest
import tyro

from swarm_envs.cli import main
from swarm_envs.training.collection.__main__ import CollectOptions
from swarm_envs.training.reproduce import papers
from swarm_envs.training.reproduce.dmpc_swarm import options as dmpc_options
from swarm_envs.training.reproduce.everything.item import Item
from swarm_envs.training.reproduce.everything.registry import ITEMS, TITLES, choose
from swarm_envs.training.reproduce.everything.rows import Range, Reason, Row, about, number
from swarm_envs.training.reproduce.everything.runner import RECORD, run_all, standing
from tests.helpers.papers import MISSING, ROWS, Written, item, job

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
    assert set(NUMBERED) == set(papers.PAPERS) == set(TITLES)
    assert sum(map(len, NUMBERED.values())) == len(ITEMS)


COMMANDS = [
    pytest.param(item, preset, id=f"{item.key}-{preset}")
    for item in ITEMS.values()
    if item.full
    for preset in ("quick", "full")
]


@pytest.mark.parametrize(("item", "preset"), COMMANDS)
def test_commands_are_what_the_command_line_takes(item, preset, tmp_path):
    rows = tmp_path / "rows.npz"
    for words in item.commands(preset, tmp_path, rows, seed=7):
        assert not any("{" in word for word in words)
        if words[0] == "collect":
            read = tyro.cli(CollectOptions, args=words[1:], config=(tyro.conf.OmitArgPrefixes,))
            assert read.config.seed == 7 and tmp_path in read.out.parents
            continue
        assert words[:2] == ["reproduce", item.paper]
        options = papers.load(item.paper).ReproduceOptions
        read = tyro.cli(options, args=words[2:], config=(tyro.conf.OmitArgPrefixes,))
        assert read.out == tmp_path and read.seed == 7
        asked = read.figure if item.name.startswith("figure") else read.table
        assert str(asked) == item.name.split("-")[1]


def test_rows_are_collected_where_none_are_given(tmp_path):
    words = ITEMS["neural-swarm2/table-3"].commands("quick", tmp_path, None)
    assert [w[0] for w in words] == ["collect", "reproduce"]
    read = tyro.cli(CollectOptions, args=words[0][1:], config=(tyro.conf.OmitArgPrefixes,))
    assert words[1][words[1].index("--data") + 1] == str(read.out / "rows.npz")


def test_a_reason_explains_in_its_direction_alone():
    reason = Reason("calmer air", Range(0.0, 7.0))
    rows = [
        Row(quantity="error", paper="7", ours=ours, agrees=about(7.0, 0.1), reasons=(reason,))
        for ours in (7.5, 0.5, 15.0, math.nan)
    ]
    assert [r.verdict for r in rows] == ["agrees", "explained", "unexplained", "unexplained"]
    assert [r.reason for r in rows] == [None, reason, None, None]
    assert [r.verdict for r in ROWS] == FOUND
    assert json.loads(json.dumps(rows[-1].as_json(), allow_nan=False))["ours"] is None


def test_ranges_and_numbers_read_well():
    said = [str(Range(5.0)), str(Range(most=1.0)), str(Range(12, 12)), str(about(-10.0, 0.2))]
    assert said == ["at least 5", "at most 1", "12", "-12 to -8"]
    assert [number(x) for x in (0.12345, 12.0, 124416, 1234.5)] == ["0.123", "12", "124416", "1234"]


def test_a_spread_has_a_name():
    with pytest.raises(ValueError, match="say what it is"):
        Row(quantity="error", paper="7", ours=1.0, spread=(0.0, 2.0))


def test_an_item_is_remade_or_says_why_not():
    given = {f.name: getattr(MISSING, f.name) for f in fields(Item)}
    with pytest.raises(ValueError, match="commands, or why"):
        Item(**given | {"missing": ""})


def test_one_that_fails_is_named_and_the_others_go_on(tmp_path):
    execute, items = Written(), [item("a", "fail"), item("b", "die"), MISSING, item("c")]
    found = run_all(job(tmp_path, execute), items, lambda some: None, progress=False)
    assert [o.state for o in found.values()] == ["failed", "failed", "not remade", "done"]
    assert found["paper/b"].error == "RuntimeError: no <air>"
    assert "exit code 1" in found["paper/a"].error
    assert [r.verdict for r in found["paper/c"].rows] == ["agrees", *FOUND]
    assert "Traceback" in (tmp_path / "paper/b/said.txt").read_text()


def test_what_is_complete_is_kept_and_the_rest_redone(tmp_path):
    said: list[str] = []
    execute = Written()
    items = [item("a"), item("b", "stop"), item("c", "fail")]
    with pytest.raises(KeyboardInterrupt):
        run_all(job(tmp_path, execute), items, lambda some: None, said.append, progress=False)
    assert execute.asked == ["a", "b"] and not said
    run_all(job(tmp_path, execute), items[2:], lambda some: None, said.append, progress=False)
    execute.heals = True
    found = run_all(job(tmp_path, execute), items, lambda some: None, said.append, progress=False)
    assert execute.asked == ["a", "b", "c", "b", "c"]  # a stands, what failed is tried again
    assert {o.state for o in found.values()} == {"done"}
    assert said == [
        "going on: 1 items are complete, 2 are to be done; paper/b goes on where it was"
    ]


def test_a_record_that_is_damaged_counts_for_nothing(tmp_path):
    one, execute = item("a"), Written()
    run_all(job(tmp_path, execute), [one], lambda some: None, progress=False)
    assert standing(job(tmp_path, execute), one).state == "done"
    (tmp_path / one.key / RECORD).write_text('{"state": "do')
    assert standing(job(tmp_path, execute), one).state == "not run"


def test_numbers_that_cannot_be_read_fail_the_item(tmp_path):
    one, execute = item("a", pictures=("b.png",)), Written()
    (outcome,) = run_all(job(tmp_path, execute), [one], lambda s: None, progress=False).values()
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

    def fails(out):
        raise RuntimeError("run again")

    monkeypatch.setattr(dmpc_options, "reproduce_places", fails)
    assert main([*command, *wanted]) == 0
    assert "going on: 1 items are complete, 0 are to be done" in capsys.readouterr().out
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
        choose(("rth3d/figure5",))
