"""Learning of tasks: curricula, layouts of evaluations, and defaults of options."""

from __future__ import annotations

import json
from copy import deepcopy
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from swarm_envs import TASKS, crowd_v0, formation_v1, pursuit_v0
from swarm_envs.cli import main
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import blueprint_of
from swarm_envs.swap_v1 import blueprint
from swarm_envs.tasks import formation
from swarm_envs.tasks.formation import LAYOUTS, FormationCurriculum, FormationTask
from swarm_envs.tasks.learning import ALL, collision, crash
from swarm_envs.tasks.ring import LOST_M
from swarm_envs.tasks.swap import SwapCurriculum
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.validation import learning_of, with_defaults
from swarm_envs.vehicles import parse_team

TINY = [
    *("--drones", "2", "--environments", "8", "--set", "n_steps=8", "batch_size=64", "n_epochs=1"),
    *("--hidden", "8", "--steps", "256", "--evaluation-episodes", "2", "--neighbors", "1"),
    *("--interactions", "none", "--no-progress"),
]


def options(**given) -> RlConfig:
    return RlConfig(out=Path("never"), **given)


def test_what_is_not_given_is_the_tasks():
    ring, swap = with_defaults(options(), "ring_v1"), with_defaults(options(), "swap_v1")
    assert (ring.layout, ring.horizon_s) == ("rings", 5.0)
    assert (swap.layout, swap.horizon_s) == ("random", 3.5)
    given = with_defaults(options(layout="tour", horizon_s=9.0), "formation_v1")
    assert (given.layout, given.horizon_s) == ("tour", 9.0)
    assert with_defaults(given, "formation_v1") == given
    assert (swap.drones, swap.team) == (4, ()) and (ring.drones, ring.team) == (None, ("S*S*S*LL",))
    assert with_defaults(options(drones=(2, 3)), "ring_v1").team_sizes == (2, 3)


def test_a_crash_is_any_contact_and_a_collision_is_between_drones():
    metrics = {f"collided_{name}": 0 for name in ("drones", "floor", "wall", "obstacle")}
    metrics["tumbled"] = 0
    assert (crash(metrics), collision(metrics)) == (0.0, 0.0)
    for name in ("collided_floor", "collided_wall", "collided_obstacle", "tumbled"):
        assert (crash(metrics | {name: 2}), collision(metrics | {name: 2})) == (1.0, 0.0)
    hit = metrics | {"collided_drones": 2}
    assert (crash(hit), collision(hit)) == (1.0, 1.0)


def test_obstacles_are_observed_wherever_there_are_any():
    """A policy that sees none is refused among them."""
    for name, given, seen in (
        *(("crowd_v0", {}, 3), ("gates_v0", {}, 3), ("pursuit_v0", {}, 0), ("swap_v1", {}, 0)),
        ("swap_v1", {"obstacles": "column=1:1:0.1"}, 3),
        ("crowd_v0", {"num_obstacles": 0}, 0),
    ):
        assert with_defaults(options(algo="dagger", **given), name).num_obstacles == seen


@pytest.mark.parametrize("task", TASKS)
def test_layouts_are_refused_with_the_list(task):
    learning = learning_of(task)
    with pytest.raises(ValueError, match="unknown --layout 'spiral'") as error:
        with_defaults(options(layout="spiral"), task)
    assert all(f"'{name}'" in str(error.value) for name in learning.layouts)
    for layout in learning.layouts:
        whole = with_defaults(options(layout=layout, algo="dagger"), task)
        assert whole.layout == layout
        assert {*learning.evaluation_layouts(layout)} <= {*learning.layouts}


def test_the_better_policy_has_the_higher_quality():
    """By hand: success averaged over layouts; on rings 15 cm cost as much as a lost one."""
    swap, ring = learning_of("swap_v1"), learning_of("ring_v1")
    measured = {"random_success": 0.5, "circle_success": 1.0}
    assert swap.quality(measured) == pytest.approx(0.75)
    assert swap.quality({"circle_8_success": 1.0}) == pytest.approx(1.0)
    good = {"rings_success": 1.0, "rings_worst_height_error_m": 0.03}
    assert ring.quality(good) == pytest.approx(0.8)
    height = ring.measures["worst_height_error_m"]
    assert height({"worst_height_error_m": 0.03, "success": True}) == 0.03
    assert height({"worst_height_error_m": 0.03, "success": False}) == LOST_M
    assert height({"worst_height_error_m": None, "success": False}) == LOST_M


def test_episodes_are_of_every_kind_as_often_as_is_said():
    task, rng = SwapCurriculum(team=parse_team("SSSS")), np.random.default_rng(0)
    circles = crowds = 0
    for _ in range(1000):
        placement = task.place(rng)
        start, goal = placement.start, placement.goals[0]
        order = [int(np.linalg.norm(start - g, axis=1).argmin()) for g in goal]
        np.testing.assert_allclose(start[order], goal, atol=1e-12)
        assert all(order[i] != i for i in range(4))
        circles += bool(np.ptp(start[:, 2]) == 0)
        crowds += bool(np.ptp(start[:, 2]) > 0 and np.ptp(start, axis=0).max() <= 1.6)
    assert circles == pytest.approx(250, abs=45)
    # Four points of the random box, 3.4 m wide, lie within 1.6 m in x and in y by chance too: with
    # r = 1.6 / 3.4 it happens in a share of (4 r^3 - 3 r^4)^2 = 0.07.
    assert crowds == pytest.approx(500 + 0.07 * 250, abs=50)


def test_crowded_episodes_are_apart_and_half_of_them_pairs():
    task = SwapCurriculum(team=parse_team("SSSS"), circle_share=0.0, crowded_share=1.0)
    rng, pairs = np.random.default_rng(1), 0
    for _ in range(400):
        placement = task.place(rng)
        start, goal = placement.start, placement.goals[0]
        gaps = np.linalg.norm(start[:, None] - start[None], axis=-1)[np.triu_indices(4, 1)]
        assert gaps.min() >= 0.35
        order = [int(np.linalg.norm(start - g, axis=1).argmin()) for g in goal]
        pairs += all(order[order[i]] == i for i in range(4))
    # of the nine derangements of four, three are pairs too
    assert pairs / 400 == pytest.approx(0.5 + 0.5 * 3 / 9, abs=0.08)


def test_given_starts_and_lone_drones_are_drawn_as_by_the_task():
    start = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    placement = SwapCurriculum(team=parse_team("SS")).place(np.random.default_rng(0), start)
    assert np.array_equal(placement.start, start)
    assert len(SwapCurriculum(team=parse_team("S")).place(np.random.default_rng(0)).start) == 1


def test_formations_of_the_curriculum_are_shapes_in_turn_and_stretched(monkeypatch):
    """Distances within start and goal are those of two of the shapes, times one factor."""
    monkeypatch.setattr(formation, "NEAREST_SHARE", 0.0)
    task = FormationCurriculum(team=parse_team(8 * "S"))
    rng, seen = np.random.default_rng(0), set()
    shapes = [np.sort(_distances(points)) for points in task.places]
    for _ in range(60):
        drawn = task.draw(rng)
        assert drawn.duration == 0.0 and drawn.orbit is None
        found = []
        for points in (drawn.start, drawn.goals[0]):
            ratios = [np.sort(_distances(points)) / shape for shape in shapes]
            (kind, *_) = (k for k, ratio in enumerate(ratios) if np.ptp(ratio) < 1e-9)
            found.append((kind, ratios[kind][0]))
        assert found[0][1] == pytest.approx(found[1][1])
        assert 0.8 <= found[0][1] <= 1.0
        seen.add((found[0][0], found[1][0]))
    assert len(seen) > 10  # of 16 pairs: planes count once
    monkeypatch.setattr(formation, "NEAREST_SHARE", 1.0)
    near = FormationCurriculum(team=parse_team("SSSS"))
    start, goals, *_ = near.draw(rng)
    least = min(np.square(start - goals[0][list(p)]).sum() for p in permutations(range(4)))
    assert np.square(start - goals[0]).sum() == pytest.approx(least)


def _distances(points: np.ndarray) -> np.ndarray:
    first, second = np.triu_indices(len(points), 1)
    return np.asarray(np.linalg.norm(points[first] - points[second], axis=-1))


def test_a_formation_layout_is_a_mission_by_name():
    for name, mission in LAYOUTS.items():
        task = formation_v1.blueprint(num_drones=8, layout=name).task
        assert isinstance(task, FormationTask) and task.mission == mission
        assert task.with_team(task.team[::-1]).motion == task.motion
    assert formation_v1.blueprint().task.mission == LAYOUTS["tour"]  # type: ignore[attr-defined]
    assert formation_v1.blueprint(num_drones=8, layout="shuffle").task.episode_s == 8.0
    with pytest.raises(ValueError, match=r"layout='cube' and labels are given, but a layout"):
        formation_v1.blueprint(layout="cube", labels="random")
    with pytest.raises(ValueError, match="did you mean 'cube'"):
        formation_v1.blueprint(layout="cubes")


def test_crowds_are_learned_with_few_obstacles_too_and_with_those_of_the_run():
    for given, more in (((), 0), ("column=0:1.1:0.1", 1)):
        task = crowd_v0.blueprint(num_drones=16, layout="open", obstacles=given).task
        found = learning_of("crowd_v0").parts(task, ALL)
        assert sum(share for share, _ in found.values()) == pytest.approx(1.0)
        stand = {name: len(part.obstacles) - more for name, (_, part) in found.items()}
        assert [stand.pop(name) for name in ("open", "column", "columns")] == [0, 1, 2]
        assert min(stand["forest"], stand["buildings"]) >= 3  # as many as a row has places for


def test_each_layout_of_a_pursuit_is_learned_with_its_own_success():
    found = learning_of("pursuit_v0").parts(pursuit_v0.blueprint(num_drones=4).task, ALL)
    assert {part.success for _, part in found.values()} == {
        blueprint_of("pursuit_v0", num_drones=4, layout=name).task.success for name in found
    }
    assert len(found) == 3


@pytest.mark.parametrize("task", ["formation", "ring"])
def test_a_task_is_trained_and_what_comes_out_flies(task, tmp_path, capsys):
    pytest.importorskip("stable_baselines3")
    out = tmp_path / "run"
    assert main(["train", "--task", task, *TINY, "--out", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    learning = learning_of(report["config"]["task"])
    layouts = learning.evaluation_layouts(report["config"]["layout"])
    assert set(report["chosen"]) == {"step"} | {
        f"{a}_{b}" for a in layouts for b in learning.measures
    }
    fly = ["--task", task, "--drones", "2", "--episodes", "1", "--horizon-s", "0.5"]
    assert main(["evaluate", *fly, "--interactions", "none", "--agent", str(out)]) == 0
    assert main(["evaluate", "--agent", str(out), "--episodes", "1", "--drones", "2"]) == 2
    assert f"{task}, but the environment's task is swap" in capsys.readouterr().err


def test_rewards_follow_new_weights():
    """The same flight, weighed otherwise: rewards differ by what the term's weight changed."""
    found = blueprint(num_drones=2, physics="batch", layout="circle")
    core, action = SwarmCore(found.task, found.config), np.full((1, 2, 3), 0.3)
    core.reset([0])
    before = deepcopy(core.step(action))
    core.set_reward_weights({"effort": -2.0})
    core.reset([0])
    after = core.step(action)
    place = core.task.reward_names.index("effort")
    changed = (-2.0 - core.task.reward_weights["effort"]) * before.reward_terms[place]
    np.testing.assert_allclose(after.rewards - before.rewards, changed, atol=1e-15)
    with pytest.raises(ValueError, match="did you mean 'effort'"):
        core.set_reward_weights({"efort": 1.0})
