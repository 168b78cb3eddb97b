"""`swarm-envs plan`: what it writes, and what it refuses."""

from __future__ import annotations

import json

import pytest

from swarm_envs.baselines.rth3d import GridPlan
from swarm_envs.cli import main


def test_it_plans_prints_and_writes(tmp_path, capsys):
    asked = ["--grid", "12x9x6", "--density", "0.2", "--seed", "1", "--out", str(tmp_path)]
    assert main(["plan", *asked, "--method", "rth3d-lba"]) == 0
    text = capsys.readouterr().out
    facts = json.loads((tmp_path / "plan.json").read_text())
    found = GridPlan.load(tmp_path / "plan.npz")
    assert facts["robots"] == 130 == len(found.starts)
    assert facts["makespan"] == found.makespan and facts["valid"] is True
    assert f"makespan {found.makespan}" in text and "guaranteed: at most" in text
    assert (tmp_path / "plan.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("asked", "code", "said"),
    [
        (["--grid", "12x9y6"], 2, "--grid is '12x9y6'"),
        (["--density", "1.5"], 2, "--density is 1.5"),
        (["--density", "0.1", "--robots", "5"], 2, "give one of them"),
        (["--family", "unifrom"], 2, "did you mean 'uniform'"),
        (["--method", "rthd"], 2, "did you mean 'rth3d'"),
        (["--save", "plan.pkl"], 2, "must end in .npz"),
        (["--grid", "6x6x6", "--density", "0.5"], 1, "carry 72 at most"),
        (["--grid", "6x6x6", "--time-limit-s", "1e-9", "--method", "rth3d"], 1, "time limit"),
    ],
)
def test_what_cannot_be_is_refused(asked, code, said, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    try:
        assert main(["plan", *asked]) == code
    except SystemExit as end:
        assert end.code == code
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
