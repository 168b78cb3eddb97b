"""Every study over the registry: each runs tiny, is killed, resumes, and names its claims."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from swarm_envs.cli import main
from swarm_envs.training.interaction_rows import save_rows
from swarm_envs.training.reproduce import dmpc_flights, limits_study
from swarm_envs.training.reproduce.claims import Extent
from swarm_envs.training.reproduce.limits_study import Sweep
from swarm_envs.training.reproduce.papers import PAPERS, load_paper
from swarm_envs.training.reproduce.reproduce_all import asking
from swarm_envs.training.reproduce.study import run_cells, run_study
from tests.helpers.tiny_fits import rows_of

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
    "dmpc-swarm/figure-3a": {},
    "dmpc-swarm/figure-3b": {"seeds": 1, "replay": False},
    "dmpc-swarm/figure-3c": {"seeds": 1, "replay": False},
    "dmpc-swarm/figure-4": {"seeds": 1, "replay": False},
    "dmpc-swarm/study-loss": {"seeds": 1},
    "rth3d/figure-5": {"runs": 2, "largest": 2000},
    "rth3d/figure-6": {"runs": 1, "largest": 2000},
    "rth3d/figure-7": {"runs": 1, "largest": 2000},
    "rth3d/figure-8": {"runs": 1, "methods": ("rth3d", "rth3d-lba")},
    "rth3d/figure-9": {"runs": 1, "largest": 4000},
    "rth3d/figure-11": {},
}
"""Options with which each study takes seconds."""
SLOW = {
    *("neural-swarm2/figure-6", "neural-swarm2/figure-7", "neural-swarm2/study-ball"),
    *("dmpc-swarm/study-loss", "rth3d/figure-8"),
}
STUDIES = {s.key: s for p in PAPERS for s in load_paper(p).STUDIES if s.report is not None}
EVERY = [pytest.param(key, marks=[pytest.mark.slow] * (key in SLOW), id=key) for key in STUDIES]


@pytest.fixture
def few(monkeypatch):
    """Few drones and few points where options cannot ask for few."""
    monkeypatch.setattr(dmpc_flights, "DRONES", 4)
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
    if study.numbered and key != "rth3d/figure-8":
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
    "dmpc-swarm": [("--figure 4 --study loss", "give one of")],
    "rth3d": [
        ("--figure 5 --methods rth4d", "rth3d-lba"),
        ("--figure 5 --methods auto auto", "each method once"),
        ("--figure 8 --largest 43199", "below every grid"),
    ],
}
"""Options of each paper that cannot be, and what is said of them."""


@pytest.mark.parametrize(
    ("paper", "words", "said"),
    [(paper, *case) for paper, cases in REFUSED.items() for case in cases],
)
def test_options_that_cannot_be_are_refused(paper, words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    try:
        code = main(["reproduce", paper, *words.split(), "--out", str(tmp_path / "out")])
    except SystemExit as end:
        code = int(end.code or 0)
    assert code in (1, 2) and not (tmp_path / "out").exists()
    shown = capsys.readouterr()
    assert said in shown.err + shown.out


def test_cells_of_other_settings_and_damaged_ones_are_refused(tmp_path):
    path = tmp_path / "cells.json"
    found = run_cells({"a": lambda: {"value": 1}}, path, {"seed": 0}, progress=False)
    assert found == {"a": {"value": 1}}
    with pytest.raises(ValueError, match="made with other seed"):
        run_cells({}, path, {"seed": 1}, progress=False)
    path.write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        run_cells({}, path, {"seed": 0}, progress=False)
