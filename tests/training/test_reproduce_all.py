"""`swarm-envs reproduce all`: nothing is left out, it goes on, numbers stand beside the papers."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest
import tyro

from swarm_envs.cli import main
from swarm_envs.training.collection.__main__ import CollectOptions
from swarm_envs.training.reproduce import dmpc_figures
from swarm_envs.training.reproduce.ablation import ablation_claims
from swarm_envs.training.reproduce.claims import (
    Between,
    Claim,
    Extent,
    Reason,
    about,
    format_quantity,
)
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
    with pytest.raises(ValueError, match="say how it is remade, or why it is not"):
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


def claims_of(key: str, numbers: Any, quick: bool = False) -> dict[str, Claim]:
    claims = ITEMS[key].claims
    assert claims is not None
    return by_name(claims(numbers, Extent(quick)))


def by_name(claims: Iterable[Claim]) -> dict[str, Claim]:
    listed = list(claims)
    found = {claim.quantity: claim for claim in listed}
    assert len(found) == len(listed)
    return found


def spread(median: float) -> dict[str, float]:
    return {"median": median, "lower_quartile": 0.9 * median, "upper_quartile": 1.1 * median}


def swap(name: str, before: float, after: float, p_value: float) -> dict[str, Any]:
    ratio = after / before
    sides = {"without": spread(before), "compensated": spread(after)}
    return {"case": name, "paper_cm": (17.0, 7.0), "ratio": ratio, "p_value": p_value, **sides}


def test_swaps_stand_beside_the_paper_s_medians():
    cases = [swap("L2S", 16.0, 0.5, 0.03), swap("S2S", 9.0, 9.5, 0.4)]
    air = {"truth": {"name": "wake"}, "cases": cases}
    airs = [air | {"world": world} for world in ("ideal", "hall")]
    rows = claims_of("neural-swarm2/figure-8", {"truths": airs}, quick=True)
    without, with_ = (rows[f"`wake` air, hall, L2S: error {s}, cm"] for s in ("without", "with"))
    assert (without.ours, without.agreement, with_.agreement) == (16.0, "agrees", "unexplained")
    assert with_.spread == pytest.approx((0.45, 0.55))
    assert rows["`wake` air, L2S: error with, cm"].agreement == "ours alone"
    improving = rows["`wake` air: share of cases whose median improves"]
    assert (improving.ours, improving.agreement) == (0.5, "unexplained")


def test_a_reason_explains_the_ring_of_5_alone_and_only_so_far():
    five = swap("ring of 5", 8.6, 7.8, 1.0) | {"paper_cm": (10.0, 5.0), "explained": 0.8}
    air = {"truth": {"name": "wake"}, "world": "hall", "cases": [five]}
    worse = air | {"cases": [five | {"compensated": spread(9.0)}]}
    larger = five | {"paper_cm": (15.0, 10.0), "compensated": spread(14.0)}
    of_16 = air | {"cases": [larger, five]}
    name = "`wake` air, hall: error with, cm"
    for figure, flown, verdict in (
        (9, air, "explained"),
        (9, worse, "unexplained"),
        (1, of_16, "unexplained"),
    ):
        rows = claims_of(f"neural-swarm2/figure-{figure}", {"truths": [flown]})
        assert rows[name].agreement == verdict


def cell(total: list[float | None], least: float) -> dict[str, Any]:
    legs = [[] if t is None else [t / 4] * 4 for t in total]
    seeds = list(range(len(total)))
    arrived = sum(t is not None for t in total)
    return {
        "seeds": seeds,
        "total_s": total,
        "legs_s": legs,
        "arrived": arrived,
        "least_scaled_distance_m": [least] * len(total),
    }


def test_compute_units_by_what_they_save():
    times = {"1 CU": [70.0], "2 CUs": [45.0], "3 CUs": [60.0, 40.0, 36.0]}
    cells = {name: cell(list(t), 0.25) for name, t in times.items()}
    rows = claims_of("dmpc-swarm/figure-3b", {"cells": cells})
    saved = rows["time that the second unit saves over what the third saves"]
    assert (saved.ours, saved.agreement) == (5.0, "agrees")
    assert rows["3 CUs: all four changes of formation, s"].spread == (36.0, 60.0)
    assert {row.agreement for row in rows.values()} == {"agrees"}


def test_a_jam_without_recovery():
    cells = {
        "jam, ours": cell([None], 0.2),
        "jam, paper's": cell([31.0], 0.25),
        "jam, none": cell([20.0], 0.05),
    }
    rows = claims_of("dmpc-swarm/figure-4", {"cells": cells}, quick=True)
    nearest = "least scaled distance of two references, m"
    assert rows[f"our recovery: {nearest}"].agreement == "unexplained"
    assert rows[f"the paper's recovery: {nearest}"].agreement == "agrees"
    assert rows[f"without recovery: {nearest}"].agreement == "agrees"
    assert rows["our recovery: share of runs in which all arrive"].ours == 0.0
    assert rows["our recovery: time to the last arrival, s"].agreement == "unexplained"


def point(grid: str, method: str, before: float, robots: int = 100) -> dict[str, Any]:
    ends = {f"ratio_before_compaction{end}": before for end in ("", "_least", "_most")}
    ends |= {f"ratio{end}": before - 0.2 for end in ("", "_least", "_most")}
    own = {"series": "uniform", "grid": grid, "method": method, "robots": robots, "runs": 2}
    return own | ends


@pytest.mark.parametrize(
    ("preset", "largest", "verdict"),
    [
        ("full", 1.68, "agrees"),
        ("full", 1.55, "explained"),  # shorter than the paper's
        ("full", 1.9, "unexplained"),
        ("quick", 1.9, "explained"),  # a small grid
        ("quick", 1.58, "explained"),
    ],
)
def test_ratios_of_makespans(preset, largest, verdict):
    points = [
        point(grid, method, value)
        for method in ("rth3d", "rth3d-lba", "rth3d-lba-paper", "auto")
        for grid, value in (("12x6x3", 2.5), ("48x24x12", largest))
    ]
    rows = claims_of("rth3d/figure-5", {"points": points}, preset == "quick")
    assert rows["uniform 48 x 24 x 12, `rth3d`: ratio before compaction"].agreement == verdict
    ratio = rows["uniform 48 x 24 x 12, `rth3d`: ratio before compaction"]
    if ratio.reason is not None:  # small grids have larger ratios, never smaller ones
        assert ("--quick" in ratio.reason.text) == (largest > 1.7)
    fallen = rows["uniform, `rth3d`: ratio on the largest grid over the smallest"]
    assert (fallen.ours, fallen.agreement) == (largest / 2.5, "agrees")


def test_a_curve_that_is_not_there_is_named():
    with pytest.raises(ValueError, match="no curve of 'rth3d' on 'uniform'"):
        claims_of("rth3d/figure-6", {"points": []})


def test_table_3_by_ratios_to_its_first_cell():
    names = {"H=20,L=4": (6.42, 6.4), "L=5": (7.21, 6.5), "no-relative-velocity": (7.6, 7.2)}
    rows = [
        {
            "cell": name,
            "paper_g2": paper,
            "paper_deviation_g2": None,
            "ours_g2": ours,
            "ours_deviation_g2": 0.05,
        }
        for name, (paper, ours) in names.items()
    ]
    rows.append({"cell": "pairwise", "paper_g2": None})
    found = by_name(ablation_claims({"rows": rows}, Extent()))
    assert found["H=20,L=4: validation error, g²"].agreement == "agrees"
    deep = found["L=5: error over that of H=20,L=4"]
    assert deep.ours == pytest.approx(6.5 / 6.4) and deep.agreement == "explained"
    assert found["no-relative-velocity: error over that of H=20,L=4"].agreement == "agrees"
    assert len(found) == 5
