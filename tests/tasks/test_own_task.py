"""Tasks of one's own: plain NumPy rules count as kernels do, in Python and on the command line."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest

import swarm_envs
from examples import own_task
from swarm_envs.cli import main
from swarm_envs.compiled import kernel
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.options import batch_of, blueprint_of, task_class
from swarm_envs.tasks.base import Placement, Task
from swarm_envs.tasks.rewards import REWARD_NAMES, REWARD_WEIGHTS, write_terms
from swarm_envs.tasks.swap import StackedLayout, SwapTask
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.runs import parts_of, training_blueprint
from swarm_envs.training.rl.validation import with_defaults
from swarm_envs.vehicles import parse_team, team_string

FILE = Path(own_task.__file__)
UPRIGHT = {**REWARD_WEIGHTS, "upright": 0.3}


@kernel
def write_upright_terms(drones, environments, settings, out):
    write_terms(drones, environments, settings, out)
    for e in range(out.shape[1]):
        for i in range(out.shape[2]):
            q = drones[e, i].quaternion
            out[7, e, i] = 1.0 - 2.0 * (q[0] * q[0] + q[1] * q[1])


@dataclass(frozen=True)
class CompiledSwap(SwapTask):
    name = "upright_v0"
    default_weights = UPRIGHT
    reward_names = (*REWARD_NAMES, "upright")
    write_reward_terms = staticmethod(write_upright_terms)


@dataclass(frozen=True)
class OwnSwap(SwapTask):
    """The same reward, and the rule of success, as methods."""

    name = "own_v0"
    default_weights = UPRIGHT

    def reward_terms(self, world):
        q = world.drones["quaternion"]
        return {"upright": 1.0 - 2.0 * (q[..., 0] * q[..., 0] + q[..., 1] * q[..., 1])}


class Arrives:
    """The shared rule of success: all within 0.1 m for 0.5 s."""

    def success(self, world):
        time, arrival = world.environments["time"], world.drones["arrival"]
        near = np.linalg.norm(world.drones["position"] - world.drones["goal"], axis=-1) < 0.1
        since = np.where(near, np.minimum(arrival, time[:, None]), np.inf)
        world.drones["arrival"] = since
        return time - since.max(axis=1) >= 0.5 - 1e-9


@dataclass(frozen=True)
class Plain(Task):
    """A task that defines no more than its draw."""

    def draw(self, rng, start=None, goal=None):
        row = np.zeros((len(self.team), 3))
        row[:, 1], row[:, 2] = np.arange(len(self.team)) - 1.0, 1.0
        return Placement(row, (row + np.array([0.6, 0.0, 0.0]))[None])


@dataclass(frozen=True)
class Endless(Plain):
    """A goal that jumps to the other side when it is reached."""

    score_names = ("reached",)

    def advance(self, world):
        drones = world.drones
        there = drones["distance"] < 0.1
        drones["goal"][there, 0] = 0.6 - drones["goal"][there, 0]
        world.environments["score"] += there.sum(axis=1)


def fly(task, count=6, steps=60, **options):
    """Rewards (T, E, N), ends, and metrics of drones that fly to their goals."""
    made = batch_of(task, num_drones=3, decision_rate=20, interactions="none", **options)
    core = SwarmCore(made.task, made.config, count)
    core.reset(list(range(count)))
    rewards, ends, drones = [], [], core.world.drones
    for _ in range(steps):
        pull = 3.0 * (drones["goal"] - drones["position"]) - 3.0 * drones["velocity"]
        result = core.step(np.clip(pull / 5.0, -1.0, 1.0))
        rewards.append(result.rewards.copy())  # the next step overwrites them
        ends.append(result.terminated.copy())
    found = core.metrics_of(range(count))
    core.close()
    return np.array(rewards), np.array(ends), found


@pytest.mark.parametrize("threads", [1, 2])
def test_a_reward_in_numpy_is_that_of_a_kernel(threads):
    ours, compiled = fly(OwnSwap, threads=threads), fly(CompiledSwap)
    np.testing.assert_array_equal(ours[0], compiled[0])
    assert ours[2] == compiled[2]


def test_success_in_numpy_ends_episodes_as_the_shared_rule_does():
    @dataclass(frozen=True)
    class OwnEnd(Arrives, CompiledSwap):
        """The shared rule as a method."""

    ours, shared = fly(OwnEnd, steps=120), fly(CompiledSwap, steps=120)
    np.testing.assert_array_equal(ours[1], shared[1])
    assert [m["success"] for m in ours[2]] == [m["success"] for m in shared[2]]
    assert any(m["success"] for m in ours[2])
    np.testing.assert_array_equal(ours[0], shared[0])


def test_goals_that_move_are_no_progress_and_are_scored():
    assert Endless.name == "endless_v0"
    rewards, _, metrics = fly(Endless, steps=160)
    assert all(m["reached"] >= 6 and not m["success"] for m in metrics)
    assert np.abs(rewards).max() < 0.2, "a jump of the goal by 0.6 m would be -0.3"


@pytest.mark.parametrize(
    ("method", "given", "message"),
    [
        ("success", lambda self, world: True, r"booleans of shape \(6,\)"),
        ("reward_terms", lambda self, world: None, "result of reward_terms .* must be a Mapping"),
        ("reward_terms", lambda self, world: {}, "weights for \\['upright'\\]"),
        (
            "reward_terms",
            lambda self, world: {"upright": 1.0},
            "'upright' of task 'wrong_v0' has shape",
        ),
        ("reward_terms", lambda self, world: {"uprigth": 1.0}, "no weight.* mean 'upright'"),
        ("success", staticmethod(lambda world: {}), "success of task .* must be a method"),
        ("reward_terms", staticmethod(lambda world: {}), "reward_terms of task .* be a method"),
    ],
)
def test_rules_are_methods_whose_results_are_checked(method, given, message):
    task: Any = dataclass(frozen=True)(type("Wrong", (OwnSwap,), {method: given}))
    with pytest.raises(ValueError, match=message):
        fly(task, steps=1)


def test_options_are_the_fields_of_the_class_and_its_docstrings_explain_them():
    env = swarm_envs.make(own_task.LineTask, num_drones=3, spacing_m=0.4)
    env.reset(seed=0)
    goals = np.sort(env.view.goals[:, 1])
    np.testing.assert_allclose(np.diff(goals), 0.4)
    with pytest.raises(TypeError, match="'spacing'; did you mean 'spacing_m'"):
        swarm_envs.make(own_task.LineTask, spacing=0.4)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (int, "must be a name such as 'swap_v1', or a class that inherits"),
        (type("Bare", (OwnSwap,), {}), "Bare is no dataclass; decorate it by @dataclass"),
        (dataclass(frozen=True)(type("Still", (Task,), {})), "Still lacks draw; add the method"),
    ],
)
def test_the_broken_rule_of_a_class_is_named(kind, message):
    with pytest.raises(ValueError, match=message):
        swarm_envs.make(kind)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda start: (start, start[None]), r"returned a tuple, but must return a Placement"),
        (lambda start: Placement(start, start), r"shape \(2, 3\).*goals\[None\] for one stage"),
        (lambda start: Placement(start, np.stack([start, start])), r"must have shape \(1, 2, 3\)"),
    ],
)
def test_what_draw_returns_is_checked(given, message):
    start = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    kind = type("Drawn", (OwnSwap,), {"draw": lambda self, *_: given(start)})
    env = swarm_envs.make(dataclass(frozen=True)(kind), num_drones=2, physics="batch")
    with pytest.raises(ValueError, match=message):
        env.reset(seed=0)


@dataclass(frozen=True)
class Tower(Endless):
    """One above another, strong ones, so many decisions a second."""

    decision_rate: int = 0
    """An option of every task, which this one reads too."""
    gap_m: float | None = 0.5
    """Distance between neighbors, m; None: 0.4."""

    defaults: ClassVar[dict[str, Any]] = {"num_drones": 2, "world": "hall", "decision_rate": 40}

    @classmethod
    def default_team(cls, options):
        return parse_team("S*" * options.num_drones)


def test_a_task_with_a_derived_field_flies_with_another_team():
    made = make_dataclass(
        "Derived", [("count", int, field(init=False, default=7))], bases=(OwnSwap,), frozen=True
    )
    task = made(team=parse_team("SS")).with_team(parse_team("LL"))
    assert (team_string(task.team), task.count) == ("LL", 7)


def test_a_task_has_defaults_and_a_team_of_its_own():
    made = blueprint_of(Tower, gap_m=None)
    assert team_string(made.task.team) == "S*S*" and made.config.world == "hall"
    assert (made.task.decision_rate, made.config.decision_rate) == (40, 40)  # type: ignore[attr-defined]
    assert made.task.gap_m is None  # type: ignore[attr-defined]
    given = blueprint_of(Tower, team="LL", world="ideal", decision_rate=20)
    assert team_string(given.task.team) == "LL" and given.config.world == "ideal"
    assert given.task.decision_rate == 20  # type: ignore[attr-defined]
    wrong: Any = dataclass(frozen=True)(type("Wrong", (Endless,), {"defaults": {"wrld": "hall"}}))
    with pytest.raises(ValueError, match="defaults of Wrong 'wrld'; did you mean 'world'"):
        swarm_envs.make(wrong)
    taken: Any = make_dataclass("Taken", [("hall", float, 1.0)], bases=(Endless,), frozen=True)
    with pytest.raises(ValueError, match="Taken has a field 'hall', but environments already have"):
        swarm_envs.make(taken)


def test_ids_are_registered():
    team = gymnasium.make("swarm_envs/Line-v0", num_drones=2, physics="batch")
    assert gymnasium.make("swarm_envs/LineSolo-v0").action_space.shape == (3,)
    assert team.action_space.shape == (6,)
    batch = gymnasium.make_vec("swarm_envs/Line-v0", num_envs=3)
    assert batch.action_space.shape == (3, 12)


def test_commands_fly_evaluate_and_train_it(tmp_path, capsys):
    pytest.importorskip("stable_baselines3")
    task = ["--task", f"{FILE}:LineTask", "--drones", "2", "--env", "spacing_m=0.7"]
    file = tmp_path / "flight.npz"
    assert main(["fly", *task, "--agent", "fast-line", "--trajectory", str(file)]) == 0
    assert "line_v0, team SS" in capsys.readouterr().out
    goals = np.load(file)["goal"][0]
    assert np.linalg.norm(goals[1] - goals[0]) == pytest.approx(0.7)
    tiny = ["--algo", "dagger", "--dagger.teacher", "fast-line", "--steps", "400", "--no-progress"]
    tiny += ["--environments", "8", "--evaluation-episodes", "2", "--hidden", "8"]
    run = str(tmp_path / "run")
    assert main(["train", *task, *tiny, "--out", run]) == 0
    assert main(["evaluate", *task, "--agent", "fast-line", run, "--episodes", "2"]) == 0
    printed = capsys.readouterr().out
    assert "to evaluate it: " in printed and "--env spacing_m=0.7" in printed
    assert re.search(r"fast-line +100.0%", printed)
    assert main(["fly", "--task", f"{FILE}:LinTask"]) == 2
    assert "did you mean 'LineTask'" in capsys.readouterr().err


def test_a_subclass_of_a_task_with_a_curriculum_is_trained_as_it_is():
    task = blueprint_of(OwnSwap, num_drones=4).task
    assert SwapTask.learning is not None
    assert SwapTask.learning.curriculum(task, "random") is task


@pytest.mark.parametrize("base", ["swap_v1", "formation_v1", "crowd_v0"])
def test_a_subclass_with_a_method_success_can_be_trained(base):
    def success(self, world):
        return world.environments["reached"] > 0

    task: Any = dataclass(frozen=True)(type("Own", (task_class(base),), {"success": success}))
    config = with_defaults(RlConfig(out=FILE.parent, algo="dagger"), task)
    trained = training_blueprint(config, task, config.teams[0]).task
    parts = parts_of(config, task, trained).values()
    assert all(type(part) is task and part.success.__func__ is success for _, part in parts)


@pytest.mark.parametrize("method", ["success", "advance", "reward_terms"])
def test_an_error_in_a_rule_states_the_shapes_of_the_arrays(method):
    def broken(self, world):
        return np.ones(4) + world.drones["position"]

    task: Any = dataclass(frozen=True)(type("Broken", (OwnSwap,), {method: broken}))
    message = rf"{method} of task 'broken_v0' raised ValueError: .* broadcast .*\(line .*6, 3"
    with pytest.raises(ValueError, match=message) as raised:
        fly(task, steps=1)
    assert raised.value.__cause__ is not None


@pytest.mark.parametrize(
    ("method", "signature"),
    [("draw", "self, generator, drones"), ("reward_terms", "self"), ("success", "self, world, n")],
)
def test_methods_with_other_parameters_are_refused_where_the_class_is_defined(method, signature):
    wrong: dict[str, Any] = {}
    exec(f"def {method}({signature}): ...", wrong)
    with pytest.raises(ValueError, match=f"{method} of Wrong must be a function of self, "):
        type("Wrong", (OwnSwap,), {method: wrong[method]})


@pytest.mark.parametrize(
    ("value", "kind"),
    [("fast", "float"), ([0.1], "float"), (True, "float"), (1.5, "int"), (1, "bool"), (2, "str")],
)
def test_options_of_a_wrong_type_are_refused(value, kind):
    default = {"float": 1.0, "int": 1, "bool": True, "str": ""}[kind]
    for annotation in (kind, type(default)):
        own = [("own", annotation, default)]
        task: Any = make_dataclass("Own", own, bases=(Plain,), frozen=True)
        swarm_envs.make(task, own=default).close()
        with pytest.raises(ValueError, match=re.escape(f"own is {value!r}, but must be of type")):
            swarm_envs.make(task, own=value)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("episode_s", "3", "episode_s is '3', but must be positive and finite, in s"),
        ("num_stages", 0, "num_stages is 0, but must be an integer of at least 1"),
        ("num_stages", 2, "num_stages of own_v0 is 2, but stages change by time, and its motion"),
        ("motion", 3, "motion is 3, but must be a Motion"),
        ("score_names", "abc", "score_names is 'abc', but must be a tuple"),
        ("success", None, "success is None, but must be a Success or "),
    ],
)
def test_members_of_a_wrong_type_are_refused(name, value, message):
    task: Any = dataclass(frozen=True)(type("Own", (Plain,), {name: value}))
    with pytest.raises(ValueError, match=message):
        swarm_envs.make(task)


def test_draw_may_return_lists():
    def draw(self, rng, start=None, goal=None):
        return Placement(*(part.tolist() for part in Plain.draw(self, rng)[:2]))

    task: Any = dataclass(frozen=True)(type("Own", (Plain,), {"draw": draw}))
    places = [
        blueprint_of(kind, num_drones=3).task.place(np.random.default_rng(0))
        for kind in (task, Plain)
    ]
    assert all(np.array_equal(a, b) for a, b in zip(places[0][:2], places[1][:2], strict=True))
    assert places[0].start.dtype == np.float64


@pytest.mark.parametrize("base", [Plain, SwapTask])
@pytest.mark.parametrize("wrap", [lambda rule: rule, lambda rule: classmethod(rule)])
def test_references_at_rest_follow_the_goals_that_advance_sets(base, wrap):
    task: Any = dataclass(frozen=True)(type("Own", (base,), {"advance": wrap(Endless.advance)}))
    env = swarm_envs.make(task, num_drones=3, interactions="none", physics="batch")
    env.reset(seed=0)
    view, before = env.view, env.view.goals.copy()
    assert np.array_equal(view.reference(0.0).position, before)
    while (view.goals == before).all():
        pull = 3.0 * (view.goals - view.state.position) - 3.0 * view.state.velocity
        env.step(dict(zip(env.agents, np.clip(pull / 5.0, -1.0, 1.0).astype("f4"), strict=True)))
    assert np.array_equal(view.reference(1.0).position, view.goals)
    env.close()


@pytest.mark.parametrize("command", ["fly", "evaluate --episodes 1 --workers 1"])
@pytest.mark.parametrize("name", ["push", "main"])
def test_the_traceback_of_an_error_in_an_own_file_begins_in_it(name, command, tmp_path, capsys):
    file = tmp_path / "push.py"
    file.write_text("def push(position, velocity, types):\n    return position / unknown\n")
    (tmp_path / "main.py").write_text("from push import push\n")
    given = [*command.split(), "--agent", "straight-line", "--drones", "2"]
    assert main([*given, "--interactions", f"{tmp_path / name}.py:push"]) == 1
    shown = capsys.readouterr()
    assert shown.err.count('File "') == 1 and f'{file}", line 2, in push' in shown.err
    assert "NameError: name 'unknown' is not defined" in shown.err + shown.out


@pytest.mark.parametrize(("table", "field"), [("drones", "goal"), ("environments", "score")])
def test_goals_and_scores_that_are_not_finite_are_refused(table, field):
    def advance(self, world):
        getattr(world, table)[field][0] = np.nan

    task: Any = dataclass(frozen=True)(type("Wrong", (Endless,), {"advance": advance}))
    with pytest.raises(ValueError, match=f"{field} after advance of task 'wrong_v0' is nan"):
        fly(task, steps=1)


def test_names_of_the_package_are_not_taken_over():
    task: Any = dataclass(frozen=True)(type("MySwap", (SwapTask,), {}))
    with pytest.raises(ValueError, match="MySwap is 'swap_v1', which is a task of the pack"):
        swarm_envs.register_task(task)
    with pytest.raises(ValueError, match="Bare is no dataclass"):
        swarm_envs.register_task(type("Bare", (SwapTask,), {}))


def test_an_own_subclass_has_its_own_name_and_ids():
    narrow: Any = dataclass(frozen=True)(type("NarrowTask", (Endless,), {}))
    swap: Any = type("NarrowSwap", (SwapTask,), {})
    assert (narrow.name, swap.name) == ("narrow_v0", "swap_v1")
    swarm_envs.register_task(narrow)
    swarm_envs.register_task(narrow)  # again, as when a cell of a notebook runs twice
    other: Any = dataclass(frozen=True)(type("OtherTask", (Endless,), {"name": "narrow_v0"}))
    with pytest.raises(ValueError, match="'narrow_v0', which is registered for NarrowTask; give"):
        swarm_envs.register_task(other)
    other.name = "swap-v1"
    with pytest.raises(ValueError, match="'swap-v1', which is registered for another environment"):
        swarm_envs.register_task(other)


@pytest.mark.parametrize("name", ["succes", "reward_term", "default_weight", "score_name"])
def test_misspelled_members_are_refused(name):
    values: tuple[Any, ...] = (lambda self, world: None, ())
    for value in values:
        with pytest.raises(TypeError, match=f"defines '{name}', which .* mean '{name}s'"):
            swarm_envs.make(dataclass(frozen=True)(type("Wrong", (Plain,), {name: value})))
        for own in ("_draw", "draws", "layout", f"_{name}"):
            swarm_envs.make(dataclass(frozen=True)(type("Right", (Plain,), {own: value}))).close()


def test_options_may_have_any_name_and_be_computed_late():
    @dataclass(frozen=True)
    class Own(Plain):
        advanced: bool = False
        episodes: int = 3
        middle: float = None  # type: ignore[assignment]
        pairs: int = field(init=False)

        def __post_init__(self):
            super().__post_init__()
            object.__setattr__(self, "pairs", len(self.team) // 2)

    env = swarm_envs.make(Own, episodes=np.int64(4), advanced=np.bool_(True))
    assert (env.core.task.episodes, env.core.task.pairs) == (4, 2)  # type: ignore[attr-defined]
    env.close()


def test_an_edited_task_is_flown_again(tmp_path, capsys):
    file = tmp_path / "line.py"
    file.write_text(FILE.read_text(), encoding="utf-8")
    words = ["evaluate", "--task", f"{file}:LineTask", "--agent", "fast-line", "--episodes", "2"]
    words += ["--interactions", "none", "--out", str(tmp_path / "out")]
    assert main(words) == 0 and main(words) == 0
    assert "resumes after 2 of 2 episodes" in capsys.readouterr().out
    file.write_text(FILE.read_text().replace("spacing_m: float = 0.5", "spacing_m: float = 0.3"))
    assert main(words) == 0
    assert "resumes after" not in capsys.readouterr().out


def test_a_task_without_weights_has_those_of_swap():
    rewards, _, _ = fly(Plain)
    assert np.abs(rewards).max() > 0.0
    assert swarm_envs.make(Plain, physics="batch").core.task.reward_weights == REWARD_WEIGHTS


def test_a_dictionary_is_the_record_of_an_option():
    given = {"radius_m": [0.5, 0.5], "duration_s": [4.0, 4.0]}
    made = batch_of("swap_v1", team="L2S", layout="stacked", stacked=given).task
    assert isinstance(made, SwapTask) and made.stacked == StackedLayout(
        radius_m=(0.5, 0.5), duration_s=(4.0, 4.0)
    )
    with pytest.raises(ValueError, match="field of stacked 'radius'; did you mean 'radius_m'"):
        batch_of("swap_v1", team="L2S", layout="stacked", stacked={"radius": 0.5})
