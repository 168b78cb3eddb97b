"""The study of experience with forces: it resumes, and its teachers know the true force."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from examples import force_knowledge
from examples.force_knowledge import (
    CONDITIONS,
    ForceStudy,
    SprintOracle,
    StackOracle,
    run_study,
    summary_of,
    table_of,
)
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of
from tests.helpers.interrupts import calls_of


def test_an_interrupted_study_resumes_with_the_same_results(tmp_path, monkeypatch):
    monkeypatch.setattr(
        force_knowledge, "CONDITIONS", {name: CONDITIONS[name] for name in ("none", "hall")}
    )
    small = {"environments": 2, "evaluation_episodes": 1, "hidden": (8,), "set_hidden": (8,)}
    monkeypatch.setattr(force_knowledge, "RECIPE", {**force_knowledge.RECIPE, **small})
    study = ForceStudy(out=tmp_path / "study", task=["sprint"], seeds=[0], steps=120, episodes=2)
    with calls_of(force_knowledge, "train_policy", killed_at=3), pytest.raises(KeyboardInterrupt):
        run_study(study)
    results = run_study(study)
    assert len({path.parent for path in study.out.rglob("report.json")}) == 4
    assert json.loads((study.out / "results.json").read_text()) == results
    assert run_study(replace(study, out=tmp_path / "other")) == results
    assert len(table_of(results).splitlines()) == 5


def test_an_interval_counts_training_seeds():
    one_fails = np.repeat([[1.0], [1.0], [0.0]], 100, axis=1)
    found = summary_of(one_fails)
    assert found["mean"] == pytest.approx(2 / 3)
    assert found["interval"] == [0.0, 1.0]  # all three draws are that seed in 1 of 27 resamples
    assert found["each"] == [1.0, 1.0, 0.0]


@pytest.mark.parametrize("condition", CONDITIONS)
def test_teachers_compensate_the_force_of_their_air(condition):
    teacher = SprintOracle()
    requires = {**teacher.requires, **CONDITIONS[condition], "threads": 1}
    blueprint = batch_of("columns_v0", layout="sprint", **requires)
    core = SwarmCore(blueprint.task, blueprint.config, 32)
    core.reset(list(range(32)))
    while core.running.all():
        core.step(np.clip(teacher.teach(core), -1.0, 1.0))
    away = np.linalg.norm(teacher.shift(core), axis=-1)
    if condition == "none":
        assert away.max() < 2e-3  # what the integrator has gathered on the way
    else:
        assert away.max() > 0.01
    ended = core.metrics_of(np.flatnonzero(~core.running).tolist())
    assert np.mean([metrics["success"] for metrics in ended]) > 0.9


def test_only_a_teacher_in_air_with_forces_puts_the_heavy_on_top():
    teacher, places = StackOracle(), {}
    for condition in ("none", "learned"):
        blueprint = batch_of("columns_v0", **teacher.requires, **CONDITIONS[condition])
        core = SwarmCore(blueprint.task, blueprint.config, 1)
        core.reset([3])
        places[condition] = teacher.assigned_places(core) - teacher.shift(core)
        goals = np.array(core.world.drones["goal"])
    assert np.array_equal(places["none"], goals)
    assert not np.allclose(places["learned"], goals)
