"""The command `evaluate`: scores, resuming, agents that fail; and who is recommended by scores."""

from __future__ import annotations

import itertools
import json
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import swarm_envs
from docs.recommend import recommendations, replaced
from swarm_envs import TASKS, make, swap_v1
from swarm_envs.agents import fly_episode, load, recommended
from swarm_envs.agents.evaluation import (
    TIMED,
    EpisodeFile,
    bootstrap_interval,
    evaluate_agent,
    frozen_seeds,
    interquartile_mean,
    rate_interval,
    score_episodes,
)
from swarm_envs.agents.models import ModelAgent
from swarm_envs.agents.policy import FILE, PolicyAgent, write_policy
from swarm_envs.cli import main
from swarm_envs.envs.options import options_type
from swarm_envs.training.scoreboard.results import Cell, Results
from swarm_envs.user_files import file_digest
from tests.helpers.users_agents import FAILING, FINE

QUICK = ["--drones", "2", "--horizon-s", "0.5", "--episodes", "4", "--seed", "7"]

MINE = (
    FINE
    + FAILING
    + """
class Unmade(Fine):
    def __init__(self): raise SystemExit('no')
class Leaves(Fine):
    def act(self, observations, view): raise SystemExit('bye')
class Picky(Fine):
    requires = {'action': 'acceleration', 'num_drones': 5}
"""
)

BATCH = """
import numpy as np
class Late:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    made = 0
    def reset(self, env, seed): self.made += 1
    def act(self, observations, view):
        rows = np.stack(list(observations.values()))
        return dict(zip(observations, self.act_batch(rows)))
    def act_batch(self, rows):
        return np.zeros((*rows.shape[:-1], 3), np.float32) + (1 // (self.made <= 16))
class Several(Late):
    def act(self, observations, view):
        return {name: np.zeros(3, np.float32) for name in observations}
    def act_batch(self, rows):
        return np.full((*rows.shape[:-1], 3), float(rows.ndim > 2 and len(rows) > 1), np.float32)
class Batch(Late):
    def act_batch(self, rows):
        return np.zeros((*rows.shape[:-1], 3), np.float32) / (1 // (rows.ndim == 2))
class Spread(Late):
    def act_batch(self, rows):
        return np.zeros((*rows.shape[:-1], 3) if rows.ndim == 2 else 3, np.float32)
class Differs(Late):
    def act(self, observations, view): return {n: np.full(3, 0.5) for n in observations}
    def act_batch(self, rows): return np.zeros((*rows.shape[:-1], 3), np.float32)
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE, encoding="utf-8")
    return file


def test_the_report_is_what_the_episodes_were(tmp_path, capsys):
    out = tmp_path / "run"
    agents = ["--agent", "straight-line", "detour"]
    arguments = ["evaluate", "--drones", "2", "--episodes", "5", "--seed", "7", *agents]
    assert main([*arguments, "--out", str(out), "--layout", "circle"]) == 0
    said = capsys.readouterr()
    assert "100%" in said.err
    assert "swap_v1, team SS, layout circle, 5 episodes, seed 7" in said.out
    assert "means, with intervals in --json: time to goal, s (of successes); energy" in said.out
    assert "detour*" in said.out
    assert "sees the true state" in said.out
    report = json.loads((out / "report.json").read_text())
    line, detour = report["agents"]
    assert (line["privileged"], detour["privileged"]) == (False, True)
    assert line["collision_rate"] == line["collision_rate_by_kind"]["drone"] == 1.0
    assert (line["success_rate"], detour["success_rate"]) == (0.0, 1.0)
    env = swap_v1.parallel_env(
        num_drones=2, layout="circle", physics="batch", **load("detour").requires
    )
    flown = [fly_episode(env, load("detour"), seed) for seed in frozen_seeds(7, 5)]
    energies = sorted(metrics["energy_j"] for metrics in flown)
    assert detour["energy_j"] == pytest.approx(np.mean(energies[1:4]), abs=1e-12)
    low, high = detour["intervals"]["energy_j"]
    assert energies[0] <= low <= detour["energy_j"] <= high <= energies[-1]
    separation = min(metrics["minimum_separation_m"] for metrics in flown)
    assert detour["smallest_separation_m"] == separation
    env.close()


def test_one_agent_s_numbers_stand_at_the_top_and_nothing_else_stays(tmp_path):
    report = tmp_path / "out.json"
    assert main(["evaluate", *QUICK, "--agent", "hover", "--json", str(report)]) == 0
    content = json.loads(report.read_text())
    assert content["success_rate"] == content["collision_rate"] == 0.0
    assert content["agents"][0]["length_s"] == content["length_s"] == 0.5
    assert [file.name for file in tmp_path.iterdir()] == ["out.json"]


def test_agents_that_fail_are_named_and_the_others_go_on(tmp_path, mine, capsys):
    report = tmp_path / "out.json"
    names = ["Raises", "Fine", "Nan", "Leaves", "Unmade"]
    agents = [f"{mine}:{name}" for name in names]
    assert main(["evaluate", *QUICK, "--agent", *agents, "--json", str(report)]) == 1
    said = capsys.readouterr()
    assert "mine.py" in said.err
    found = {a["agent"].split(":")[-1]: a for a in json.loads(report.read_text())["agents"]}
    assert "error" not in found["Fine"]
    assert "decision 1: KeyError: 'nothing'" in found["Raises"]["error"]
    assert "decision 3: ValueError" in found["Nan"]["error"]
    assert "must be finite" in found["Nan"]["error"]
    assert "decision 1: SystemExit: bye" in found["Leaves"]["error"]
    assert "SystemExit: no" in found["Unmade"]["error"]
    assert said.out.count("FAILED") == 4


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("tracing", "unknown agent 'tracing'; did you mean 'tracking'?"),
        ("tracking,hover", "separate names by spaces"),
        ("{mine}:Missing", "unknown class or function 'Missing'"),
        ("{mine}:Picky", "requires num_drones=5, not 2"),
        ("none.py:Agent", "there is no file 'none.py'"),
        (
            "ring-dagger",
            "this policy supports ring, but the environment's task is swap; set the task",
        ),
    ],
)
def test_who_cannot_fly_is_refused_before_anybody_flies(name, why, tmp_path, mine, capsys):
    report = tmp_path / "out.json"
    agents = ["hover", name.format(mine=mine)]
    assert main(["evaluate", *QUICK, "--json", str(report), "--agent", *agents]) == 2
    said = capsys.readouterr()
    assert why in said.err
    assert "episode" not in said.err  # no bar
    assert not report.exists()


def test_without_an_agent_the_best_for_the_task_flies(tmp_path):
    report, drones = tmp_path / "out.json", ["--drones", "4", "--episodes", "1"]
    assert main(["evaluate", *drones, "--horizon-s", "0.5", "--json", str(report)]) == 0
    assert json.loads(report.read_text())["agent"] == recommended("swap", num_drones=4)


def test_another_setting_begins_another_file_and_damage_is_named(tmp_path):
    one = EpisodeFile(tmp_path, "a.py:Mine", {"layout": "random"})
    one.add({"seed": 1, "metrics": {}, "act_us": []})
    assert EpisodeFile(tmp_path, "a.py:Mine", {"layout": "circle"}).episodes == {}
    with one.path.open("a") as torn:
        torn.write('{"seed": 12')  # by a kill
    assert EpisodeFile(tmp_path, "a.py:Mine", {"layout": "random"}).episodes.keys() == {1}
    with one.path.open("a") as file:
        file.write("nonsense\n")
    with pytest.raises(ValueError, match=r"a-py-Mine.*is damaged"):
        EpisodeFile(tmp_path, "a.py:Mine", {"layout": "random"})


@pytest.mark.parametrize("edited", ["policy.py", "gains.py", "more/scale.py", "notes.py"])
def test_an_agent_is_another_if_its_file_or_one_that_it_imports_is_edited(tmp_path, capsys, edited):
    (tmp_path / "more").mkdir()
    for file in ("gains.py", "more/scale.py", "notes.py"):
        (tmp_path / file).write_text("GAIN = 0.0\n")
    policy = tmp_path / "policy.py"
    policy.write_text(
        "import sys\nsys.path.insert(0, __file__.rpartition('/')[0])\nfrom gains import GAIN\n"
        "from more import scale\n"
        "def act(rows): return GAIN * rows[..., :3]\n"
    )
    arguments = ["evaluate", *QUICK, "--agent", f"{policy}:act", "--out", str(tmp_path / "run")]
    for expected in (False, True):
        assert main(arguments) == 0
        assert ("resumes after" in capsys.readouterr().out) is expected
    (tmp_path / edited).write_text((tmp_path / edited).read_text() + "# edited\n")
    assert main(arguments) == 0
    assert ("resumes after" in capsys.readouterr().out) is (edited == "notes.py")


@pytest.mark.parametrize(
    ("source", "covers"),
    [
        ("try:\n    import beside\nexcept SyntaxError:\n    pass\n", True),
        ("import importlib\nbeside = importlib.import_module('beside')\n", True),
        ("try:\n    from .......... import beside\nexcept ImportError:\n    pass\n", False),
    ],
)
def test_the_digest_of_a_file_bears_what_it_does_not_understand(tmp_path, source, covers):
    file, beside = tmp_path / "own.py", tmp_path / "beside.py"
    file.write_text(source)
    beside.write_text("match x y")
    (tmp_path / "folder.py").mkdir()
    before = file_digest(f"{file}:Own")
    beside.write_text("match y x")
    assert (file_digest(f"{file}:Own") != before) is covers


def test_an_agent_that_flies_many_at_once_is_asked_for_each_episode():
    class Picky(ModelAgent):
        def reset(self, env, seed):
            if seed % 3 == 0:
                raise ValueError(f"not {seed}")

    seeds = frozen_seeds(0, TIMED + 12)
    env = swap_v1.parallel_env(num_drones=2, horizon_s=0.5, physics="batch")
    agent = Picky(lambda rows: 0.0 * rows[:, :3])
    episodes = [*evaluate_agent(env, agent, seeds, refusals=True)]
    assert [episode["seed"] for episode in episodes] == seeds
    refused = {e["seed"]: e["metrics"]["refused"] for e in episodes if "refused" in e["metrics"]}
    assert refused == {seed: f"not {seed}" for seed in seeds if seed % 3 == 0}
    assert {*refused} & {*seeds[TIMED:]}
    env.close()


@pytest.mark.parametrize("name", ["straight-line", "swap-dagger"])
def test_many_episodes_at_once_are_the_episodes_one_by_one(name):
    agent, seeds = load(name), frozen_seeds(3, TIMED + 5)
    options = {**agent.requires, "num_drones": 4, "horizon_s": 2.0, "physics": "batch"}
    env = swap_v1.parallel_env(**options)
    episodes = list(evaluate_agent(env, agent, seeds))
    assert [episode["seed"] for episode in episodes] == seeds
    assert all(episode["act_us"] for episode in episodes[:TIMED])
    assert not any(episode["act_us"] for episode in episodes[TIMED:])
    for seed, episode in zip(seeds, episodes, strict=True):
        assert episode["metrics"] == fly_episode(env, agent, seed)
    env.close()


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("Late", r"seed \d+, decision \d+: ZeroDivisionError"),
        ("Batch", r"act_batch fails in the episodes of seeds \d+ to \d+, but act does not: Ze"),
        ("Several", r"act returns \[0.0, .* for drone_0, but act_batch \[1.0, .* both must return"),
        ("Differs", r"act returns \[0.5, .* for drone_0, but act_batch \[0.0, .* both must return"),
        (
            "Spread",
            r"but act does not: .* shape \(3,\) for rows of shape .* must return \(4, 2, 3\)",
        ),
    ],
)
def test_who_fails_among_many_at_once_is_named(tmp_path, capsys, name, why):
    file = tmp_path / "batch.py"
    file.write_text(BATCH, encoding="utf-8")
    arguments = ["evaluate", *QUICK, "--episodes", str(TIMED + 4), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--agent", f"{file}:{name}"]) == 1
    assert re.search(why, json.loads((tmp_path / "out" / "report.json").read_text())["error"])
    (kept,) = (tmp_path / "out" / "episodes").iterdir()
    assert kept.read_text().count("\n") == 1 + TIMED  # what was flown before it failed


LEARNED = {"interactions": "learned"}  # a part of a training's configuration


def test_a_policy_that_was_trained_with_other_options_is_noted(tmp_path, capsys):
    """A note for `evaluate` and `fly`, unless the options are those of the training."""
    weights = "reward_weights={'crash': -2}"
    shipped = load("swap-dagger")
    assert isinstance(shipped, PolicyAgent)
    trained = replace(shipped.policy, provenance={"config": {**LEARNED, "env": [weights]}})
    write_policy(tmp_path / FILE, trained)
    arguments = ["--agent", str(tmp_path), "--horizon-s", "0.5", "--physics", "batch"]
    for command in (["evaluate", "--episodes", "2", *arguments], ["fly", *arguments]):
        assert main(command) == 0
        said = capsys.readouterr().out
        assert f"was trained with {weights}, but flies with reward_weights=default" in said
        assert main([*command, "--env", weights.replace("2", "2.0")]) == 0
        assert "was trained" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("trained", "flown", "note"),
    [
        (
            ["end_on_success=False"],
            [],
            "with end_on_success=False, but flies with end_on_success=T",
        ),
        (
            [],
            ["--env", "end_on_success=False"],
            "with end_on_success=True, but flies with end_on_suc",
        ),
        ([], ["--env", "end_on_success=True", "threads=1", "decision_rate=20"], ""),
        ([], ["--interactions", "none"], "with interactions=learned, but flies with"),
        (["force_rate=48", "physics=batch"], ["--force-rate", "48"], ""),
        (
            ["force_rate=48", "physics=batch"],
            [],
            "with force_rate=48, but flies with force_rate=240",
        ),
        (None, ["--env", "end_on_success=False"], ""),
        ([1], [], ""),
        (["foo"], [], ""),
        ({"observe_loss": 0.1}, [], "with observe_loss=0.1, but flies with observe_loss=0.0"),
        ({"observe_loss": 0.1}, ["--observe-loss", "0.1"], ""),
        ({}, ["--observe-delay-s", "0.1"], "with observe_delay_s=0.0, but flies with observe_de"),
        ({"randomization": "mass=0.9:1.1"}, [], "but flies with randomization=default"),
        ({"randomization": "mass=0.9:1.1"}, ["--randomization", "mass=0.9:1.1"], ""),
    ],
)
def test_notes_are_of_options_that_differ(trained, flown, note, tmp_path, capsys):
    shipped = load("swap-dagger")
    assert isinstance(shipped, PolicyAgent)
    limits, env = (trained, []) if isinstance(trained, dict) else ({}, trained)
    config = {**LEARNED, "env": env, **limits}
    write_policy(tmp_path / FILE, replace(shipped.policy, provenance={"config": config}))
    arguments = ["--agent", f"{tmp_path}+filter", "--horizon-s", "0.2", "--episodes", "1"]
    assert main(["evaluate", *arguments, *flown]) == 0
    said = capsys.readouterr().out
    assert ("note: " in said) == bool(note)
    assert note in said


def test_the_return_of_own_rewards_is_in_the_table(capsys, tmp_path):
    task, file = Path(__file__).parents[1] / "examples" / "own_task.py", tmp_path / "a.json"
    words = ["--task", f"{task}:LineTask", "--agent", "fast-line", "--episodes", "3"]
    returns = []
    for weight in (0.1, 1.1):
        given = f"reward_weights={{'upright': {weight}}}"
        assert main(["evaluate", *words, "--json", str(file), "--env", given]) == 0
        assert "return per drone" in capsys.readouterr().out
        report = json.loads(file.read_text())
        returns.append(report["mean_return"])
    # fast-line tilts: per second of an episode, an upright drone would have gained all of it
    assert 0.7 * report["length_s"] < returns[1] - returns[0] < report["length_s"]


SHIFTS = """
from dataclasses import dataclass
import numpy as np
from swarm_envs.tasks.base import Placement, Task

@dataclass(frozen=True)
class Shifts(Task):
    score_names = ("shifts",)

    def draw(self, rng, start=None, goal=None):
        row = np.array([[0.0, 0.5 * i, 1.0] for i in range(len(self.team))])
        return Placement(row, (row + np.array([0.6, 0.0, 0.0]))[None])

    def advance(self, world):
        world.environments["score"] = 3.0
"""


def test_the_score_of_an_own_task_is_shown(tmp_path, capsys):
    file = tmp_path / "shifts.py"
    file.write_text(SHIFTS, encoding="utf-8")
    words = ["--task", f"{file}:Shifts", "--drones", "2", "--agent", "hover", "--horizon-s", "0.2"]
    assert main(["evaluate", *words, "--episodes", "2", "--json", str(tmp_path / "a.json")]) == 0
    assert "shifts (of all episodes)" in capsys.readouterr().out
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["shifts"] == 3.0 and report["intervals"]["shifts"] == [3.0, 3.0]
    assert main(["fly", *words, "--physics", "batch"]) == 0
    assert "  Score     shifts 3" in capsys.readouterr().out


def test_seeds_are_frozen_and_fewer_are_the_first_of_more():
    assert frozen_seeds(7, 3) == frozen_seeds(7, 300)[:3]
    assert not set(frozen_seeds(7, 2048)) & set(frozen_seeds(8, 2048))


def test_statistics_against_what_is_known():
    values = np.arange(8.0)
    values[7] = 1e9
    assert interquartile_mean(values) == pytest.approx(np.mean([2, 3, 4, 5]))
    sample = np.random.default_rng(0).normal(3.0, 2.0, 400)
    low, high = bootstrap_interval(sample, lambda x, axis: x.mean(axis=axis))
    half = 1.96 * sample.std() / 20  # of a mean, by the central limit theorem
    assert (low, high) == pytest.approx((sample.mean() - half, sample.mean() + half), abs=0.02)
    assert bootstrap_interval(np.array([3.0]), lambda x, axis: 2.0 * x.mean(axis)) == [6.0, 6.0]
    assert rate_interval(0, 100) == pytest.approx([0.0, 0.0370], abs=1e-4)  # 3.84 / 103.84
    with pytest.raises(ValueError, match="no episode"):
        score_episodes([])


@pytest.mark.parametrize(("task", "drones"), [
    ("swap_v1", 4), ("ring_v1", 5), ("formation_v1", 8), ("columns_v0", 8), ("delivery_v0", 7),
    ("gates_v0", 3), ("crowd_v0", 16), ("pursuit_v0", 8),
])  # fmt: skip
def test_the_best_agent_succeeds(task, drones):
    agent = load(recommended(task.partition("_v")[0], num_drones=drones))
    env = swarm_envs.make(task, num_drones=drones, **{**agent.requires, "physics": "batch"})
    assert fly_episode(env, agent, 0)["success"]
    env.close()


@pytest.mark.parametrize(("task", "layout", "drones", "best"), [
    ("swap_v1", "random", 4, "crowd-dagger+filter"),
    ("swap_v1", "random", 64, "crowd-dagger+filter"), ("swap_v1", "circle", 4, "orca"),
    ("formation_v1", "shuffle", 8, "crowd-dagger+filter"),
    ("pursuit_v0", "swap-goals", 8, "crowd-dagger+filter"), ("ring_v1", None, 4, "downwash-aware"),
    ("crowd_v0", "forest", 16, "crowd-dagger+filter"),
])  # fmt: skip
def test_the_best_agent_among_obstacles_succeeds(task, layout, drones, best):
    name = recommended(task, num_drones=drones, layout=layout, obstacles=True)
    assert name == best
    agent = load(name)
    given = {"num_drones": drones, "obstacles": "column=1:1:0.15", "physics": "batch"}
    given |= {} if layout is None else {"layout": layout}
    with closing(swarm_envs.make(task, **{**given, **agent.requires})) as env:
        assert fly_episode(env, agent, 0)["success"]


def test_it_is_as_it_was_asked_for():
    learned = load(recommended("swap", num_drones=4, learned=True))
    assert isinstance(getattr(learned, "agent", learned), PolicyAgent)
    assert not load(recommended("swap", num_drones=8, privileged=False)).privileged
    assert load(recommended("swap", num_drones=8, privileged=True)).privileged
    assert recommended("swap", num_drones=16, layout="circle", learned=False) == "roundabout"
    assert recommended("swap", team="SSLL", learned=True) == "swap-dagger"
    assert recommended("swap", team="S*S*LL") == "swap-dagger"
    assert recommended("crowd", obstacles=True) == "crowd-dagger+filter"  # of 16 drones
    assert recommended("swap", num_drones=129, privileged=False) == "roundabout"
    assert recommended("swap", num_drones=128, layout="random") == "roundabout"
    assert recommended("swap", num_drones=8, layout="circle", obstacles=True) == "roundabout"
    assert recommended("ring", num_drones=5) == "downwash-aware"
    assert recommended("ring", num_drones=4, world="hall") == "ring-dagger"
    assert recommended("swap", num_drones=8, layout="circle", world="hall") == recommended(
        "swap", num_drones=8, layout="circle"
    )
    with pytest.raises(ValueError, match=r"learned=True flies 'swap' with 500.*: roundabout"):
        recommended("swap", num_drones=500, learned=True)
    with pytest.raises(ValueError, match="flies 'ring' with 4 drones among obstacles"):
        recommended("ring", num_drones=4, learned=True, obstacles=True)
    with pytest.raises(ValueError, match=r"no task 'swop'; it has swap, ring, formation"):
        recommended("swop", num_drones=2)


def test_it_flies_the_team_that_the_task_has():
    assert recommended("delivery", privileged=False) == "delivery-dagger"  # of large and small ones
    assert recommended("columns", num_drones=8, privileged=False) == "stack-dagger"
    with pytest.raises(
        ValueError, match=r"privileged=False flies 'columns' with 4.*: heavy-on-top$"
    ):
        recommended("columns", num_drones=4, privileged=False)
    with pytest.raises(ValueError, match="unknown layout 'spiral'"):
        recommended("swap", layout="spiral")


def test_fly_with_defaults_succeeds(capsys, tmp_path):
    numbers = tmp_path / "a.json"
    assert main(["fly", "--physics", "batch", "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert found["metrics"]["success"]
    assert found["agent"] == recommended("swap", num_drones=4, layout="random")


def test_a_refusal_names_the_agent_that_can(capsys):
    arguments = ["--layout", "circle", "--drones", "16", "--physics", "batch"]
    assert main(["fly", *arguments, "--agent", "neural-swarm-planner"]) == 2
    best = recommended("swap", num_drones=16, layout="circle")
    assert f"try --agent {best}" in capsys.readouterr().err


def test_recommendations_follow_from_the_results():
    tasks = ("swap-circle-4-v2", "swap-random-SSLL-v2", "robust-ring-5-hall-v2")
    shares = {"orca": 0.75, "hover": 0.25, "swap-dagger": 1.0, "mine.py:Mine": 1.0}
    cells = [
        Cell(task, agent, [
            {"refusal": None, "success": k < 8 * share, "score": 0.5 * (k < 8 * share)}
            for k in range(8)
        ])
        for task in tasks for agent, share in shares.items()
    ]  # fmt: skip
    about = {"tasks": tasks, "agents": {agent: {"privileged": False} for agent in shares}}
    results = Results(about, cells)
    rows = recommendations(results)
    assert [(r["task"], r["layout"], r["drones"], r.get("world")) for r in rows] == [
        ("swap", "circle", 4, None), ("ring", None, 5, "hall"),
    ]  # fmt: skip
    numbers = {"success": 0.75, "score": 0.5, "learned": False, "privileged": False}
    assert rows[0]["agents"]["orca"] == numbers  # half of the scores in the middle are 0.5
    assert list(rows[0]["agents"]) == ["swap-dagger", "orca"]
    assert replaced(rows, results) == rows
    old = [{**rows[0], "agents": {"other": {"success": 1.1, "score": 1.0}, "hover": {}}}]
    assert list(replaced(old, results)[0]["agents"]) == ["other", *rows[0]["agents"]]


TASKS_AND_LAYOUTS = [
    (task, layout) for task in TASKS for layout in options_type(task).task_type.layouts or (None,)
]


@pytest.mark.slow
@pytest.mark.parametrize(("task", "layout"), TASKS_AND_LAYOUTS)
def test_a_recommended_agent_is_never_refused(task, layout):
    tried = 0
    for drones, learned, privileged, obstacles in itertools.product(
        (None, 1, 2, 3, 4, 6, 8, 9, 17, 33), (None, True), (None, False, True), (False, True)
    ):
        given: dict[str, Any] = {"num_drones": drones, "layout": layout}
        wanted: dict[str, Any] = {
            "learned": learned,
            "privileged": privileged,
            "obstacles": obstacles,
        }
        try:
            agent = load(recommended(task, **given, **wanted))
        except ValueError:
            continue  # the task does not take so many, or nobody flies it
        options = {name: value for name, value in given.items() if value is not None}
        if obstacles:
            options["obstacles"] = "column=1:1:0.15"
        with closing(make(task, **{**options, "physics": "batch", **agent.requires})) as env:
            try:
                env.reset(seed=0)
            except RuntimeError:
                continue  # no place is free of the obstacle
            agent.reset(env, 0)
            tried += 1
    assert tried > 10
