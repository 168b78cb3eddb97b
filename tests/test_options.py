"""Options and arguments: refused by name, explained; commands say alike what is flown."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import re
from contextlib import nullcontext
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import swarm_envs
from docs.tables.option_tables import settings_table
from docs.tables.task_pages import task_page
from swarm_envs import TASKS as NAMES
from swarm_envs import make
from swarm_envs.agents.safety import Safety
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import GilbertElliott, Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import UnitOutage
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds
from swarm_envs.cli import main
from swarm_envs.commands.evaluate import EvaluateOptions
from swarm_envs.commands.fly import FlyOptions
from swarm_envs.commands.grade import GradeOptions
from swarm_envs.control.config import (
    MID,
    ControllerConfig,
    Indi,
    MomentumObserver,
    NeuralFly,
    PositionGains,
)
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.options import TaskOptions, field_docstrings, options_type, task_class
from swarm_envs.envs.randomization import Randomization
from swarm_envs.errors import check_integer, check_interval, check_number
from swarm_envs.hall import Hall
from swarm_envs.motors import BatteryModel
from swarm_envs.tasks.base import ByScore, Success, TrackingSuccess
from swarm_envs.tasks.crowd import CrowdTask
from swarm_envs.tasks.formation import FormationTask
from swarm_envs.tasks.gates import GatesTask
from swarm_envs.tasks.obstacles import Box, Column, buildings, parse_obstacles
from swarm_envs.tasks.pursuit import PursuitTask
from swarm_envs.tasks.ring import FIVE, RingLayout, RingTask
from swarm_envs.tasks.swap import CircleLayout, StackedLayout, SwapTask
from swarm_envs.training.belief import FeedforwardConfig
from swarm_envs.training.collection import CollectionConfig
from swarm_envs.training.collection.log import SensorNoise
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.runs import training_blueprint
from swarm_envs.training.rl.validation import with_defaults
from swarm_envs.vehicles import SMALL, Vehicle

TEAM = {"team": (SMALL,) * 5}
OPTIONS = {task: options_type(task) for task in NAMES}
SETTINGS: dict[type, dict[str, Any]] = {
    **dict.fromkeys((SwapTask, RingTask, FormationTask, CrowdTask), TEAM),
    PursuitTask: TEAM,
    GatesTask: {"team": (SMALL,) * 3},
    ByScore: {"radius": 0.1, "least": 1.0},
    **{kind: {} for kind in (StackedLayout, CircleLayout, Success, TrackingSuccess)},
    **{kind: {} for kind in (Randomization, Hall, BatteryModel, ControllerConfig)},
    **{kind: {} for kind in (MomentumObserver, Indi, NeuralFly)},
    RingLayout: dataclasses.asdict(FIVE),
    PositionGains: dataclasses.asdict(MID),
    Vehicle: dataclasses.asdict(SMALL),
    **{kind: {} for kind in (Safety, LossModel)},
    GilbertElliott: {"turns_bad": 0.1, "turns_good": 0.5},
    UnitOutage: {"unit": 0, "first_round": 1},
    Column: {"center": (0.0, 0.0), "radius": 0.2},
    EnvConfig: {},
    **{kind: {} for kind in OPTIONS.values()},
}
"""Classes of settings whose every field is explained, and what they must be given."""
OTHERS: dict[type, dict[str, Any]] = {
    **{kind: {} for kind in (MlrDmpcConfig, PlanningBounds, SearchConfig)},
    Jam: {"first_round": 1, "last_round": 2},
    **{kind: {} for kind in (SensorNoise, LogOptions, CollectionConfig)},
    MotionRanges: {},
    FeedforwardConfig: {"out": Path("belief")},
    FitConfig: {"out": Path("fit"), "data": Path("data")},
}
"""Classes of settings that are not told about on a page of their own."""
TRAINING = (SensorNoise, LogOptions, CollectionConfig, MotionRanges)
ALL = {k: v for k, v in {**SETTINGS, **OTHERS}.items() if k not in TRAINING}
NOT_AN_INTEGER = (True, 1.5, "1", math.nan, 1j, b"")
NOT_A_NUMBER = (True, np.bool_(True), "1", math.nan, math.inf, -math.inf, 1j, 10**400)
NOT_A_FLAG = (1, 0.0, "yes", ())
NOT_SEVERAL_NUMBERS: tuple[Any, ...] = ("ab", 3, (math.nan, math.nan), (1.0,), {})
CLASSES = {"ControllerConfig", "Hall", "BatteryModel", "RingLayout", "Success", "PositionGains"}


def refused_by(option: dataclasses.Field[Any]) -> list[Any]:
    """Values that no option of such a type can have, whatever its range."""
    words = set(re.findall(r"\w+", str(option.type)))
    kinds = (("int", NOT_AN_INTEGER), ("float", NOT_A_NUMBER), ("bool", NOT_A_FLAG))
    if words & {"Factor", "Shares"} or str(option.type).startswith("tuple[float"):
        return [*NOT_SEVERAL_NUMBERS]
    bad = [value for kind, values in kinds if words <= {kind, "None"} for value in values]
    bad += [1.5, b""] if words & CLASSES or "Literal" in words else []
    return bad


def constructed(settings: type, **given: Any) -> Any:
    """An object with these options; of a task's options, what the task is made from."""
    made = settings(**{**ALL[settings], **given})
    return made.blueprint() if isinstance(made, TaskOptions) else made


@pytest.mark.parametrize("settings", ALL)
def test_values_of_another_kind_are_refused_by_name(settings):
    checked = 0
    for option in fields(settings):
        for value in refused_by(option):
            with pytest.raises(ValueError) as error:
                constructed(settings, **{option.name: value})
            told = str(error.value)
            assert option.name in told or option.name.rstrip("_m") in told, (option.name, told)
            assert f"{value!r:.20}" in told or re.search("shape|nan", told), (
                option.name,
                value,
                told,
            )
            checked += 1
    assert checked or settings is FitConfig


@pytest.mark.parametrize("settings", ALL)
def test_numbers_are_taken_or_refused_by_name(settings):
    for name in [option.name for option in fields(settings)]:
        for value in (math.nan, math.inf, -math.inf, -1, 0, 0.5, 5e-324, 1e300, 10**30, ""):
            try:
                constructed(settings, **{name: value})
            except ValueError as error:
                told = str(error)
                words = (name, name.rstrip("s"), name.replace("_", " "), f"{value!r:.20}")
                assert any(word in told for word in words)
            except TypeError as error:
                assert name in str(error)


def test_every_option_says_what_it_is_and_allows_its_default():
    for settings in SETTINGS:
        constructed(settings)
        for meaning in field_docstrings(settings).values():
            assert re.match(r"\S.* .*\S", meaning), settings


@given(
    value=st.one_of(st.floats(), st.integers(), st.booleans(), st.text(), st.none(), st.binary()),
    low=st.floats(-10.0, 10.0),
    high=st.floats(-10.0, 10.0),
)
def test_a_number_is_taken_in_its_range_alone(value, low, high):
    fits = isinstance(value, int | float) and not isinstance(value, bool)
    fits = fits and low < value <= high
    with nullcontext() if fits else pytest.raises(ValueError, match=r"x is .* but must be"):
        check_number("x", value, above=low, at_most=high)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "a finite number"),
        ({"at_least": 0.0}, "finite and not negative"),
        ({"above": 0.0, "unit": "m"}, "positive and finite, in m"),
        ({"at_least": 1.0, "unit": "m"}, "a finite number of at least 1, in m"),
        ({"above": -2.5}, "a finite number above -2.5"),
        ({"at_least": -1.0, "below": 2.0}, r"a number in [-1, 2)"),
        ({"above": 0.0, "at_most": 2.0}, r"a number in (0, 2]"),
    ],
)
def test_a_refusal_names_the_ends_of_the_range(given, words):
    with pytest.raises(ValueError, match=re.escape(f"x is nan, but must be {words}") + "$"):
        check_number("x", math.nan, **given)
    check_number("x", np.float32(1.5), **given)


def test_an_interval_holds_two_numbers_in_order():
    for bad in ((True, True), (2.0, 1.0), (0.0, 1.0), (1.0, 9.0), (1.0, "2"), 1.0, (1.0, 1.5, 2.0)):
        with pytest.raises(ValueError, match=r"x is .*, but must be \(low, high\) with 0 < low"):
            check_interval("x", bad, above=0.0, at_most=8.0)
    check_interval("x", [1, np.float64(8.0)], above=0.0, at_most=8.0)


def test_integers_beyond_every_float_are_refused_or_taken_without_overflow():
    with pytest.raises(ValueError, match="x is 1000"):
        check_number("x", 10**400, at_least=0.0)
    check_number("x", 10**300, at_least=0.0)
    assert check_integer("x", 10**400, at_least=0) == 10**400
    assert check_integer("x", np.int64(3), at_least=3, at_most=3) == 3


BOUNDS: list[tuple[type, str, list[Any], list[Any]]] = [
    (OPTIONS["swap_v1"], "num_drones", [1, np.int64(2)], [0, 2.0, 100_001]),
    (EnvConfig, "decision_rate", [1, 48, 240], [0, -48, 50, 48.0, 480]),
    (EnvConfig, "num_neighbors", [0, 10_000], [-1, 10_001, 1.5]),
    (EnvConfig, "horizon_s", [1, 0.1, None], [0.0, -1.0, "8"]),
    (ControllerConfig, "min_vertical_thrust_fraction", [0.2, 0.99], [0.0, 1.0, math.nan]),
    (ControllerConfig, "rate_yaw", [0.1, 7], [0.0, -1.0]),
    (PositionGains, "velocity", [0.5], [0.0, -2.0]),
    (MomentumObserver, "bandwidth_hz", [0.1, 20], [0.0, 20.5, math.nan]),
    (NeuralFly, "force_drift", [0.0, 5.0], [-1.0, math.inf]),
    (ControllerConfig, "adaptation", [None, Indi(), NeuralFly()], ["indi", 3.0]),
    (ControllerConfig, "gains", [MID], ["mid", None]),
    (Safety, "downwash", [1, 1.3], [0.5, -1.0, math.inf]),
    *((task, "team", [TEAM["team"]], [(), []]) for task in (SwapTask, RingTask, FormationTask)),
    (Randomization, "mass", [(1.0, 1.0), [0.9, 1.1]], [(1.2, 0.8), 1.1, (0.0, 1.0), (1.0,)]),
    (Randomization, "battery", [(0.5, 1.0)], [(0.5, 1.2)]),
    (Randomization, "gust_acceleration", [0.0, 1.0], [-1.0]),
    (Randomization, "gust_time_s", [0.1], [0.0]),
    (Hall, "frame_rate_hz", [1.0, 240], [0.0, 241.0, math.nan]),
    (Hall, "frame_loss", [0.0, 0.9], [1.0, -0.1]),
    (Hall, "residual_time_s", [0.1], [0.0, math.inf]),
    (EnvConfig, "world", ["ideal", "hall", Hall()], [1, None]),
    (StackedLayout, "radius_m", [(0.5, 0.5)], [(0.7, 0.5), (0.0, 0.3), (3.0, math.inf)]),
    (RingLayout, "horizontal_m", [(0.5, 0.6)], [(0.0, 1.0), (1.0, math.nan), (1.0,)]),
    (RingLayout, "upright_speed_m_s", [0.4, None], [0.0, -1.0, math.nan]),
    (RingLayout, "phases_rad", [(-1.0, 9.0)], [(0.0,), (0.0, math.inf)]),
    (RingLayout, "lead_s", [(0.0, 0.0), (0.0, 60.0)], [(3.0, 1.0), (-1.0, 1.0)]),
    (CrowdTask, "reach_m", [(1.0, 1.0)], [(2.0, 1.0), (0.0, 1.0), 2.0]),
    (BatteryModel, "capacity_ah", [0.1], [0.0, math.nan]),
    (BatteryModel, "idle_current_a", [0.0, 1.0], [-1.0, math.inf]),
    (Vehicle, "inertia", [(1e-6, 1e-6, 2e-6)], [(1e-6, 1e-6), (1e-6, 0.0, 1e-6)]),
    (OPTIONS["formation_v1"], "turn_rad", [(-1.0, 1.0), (0, 0)], [(1.0, 0.0), (0.0,)]),
]


@pytest.mark.parametrize(("settings", "name", "good", "bad"), BOUNDS)
def test_ranges_end_where_they_should(settings, name, good, bad):
    for value in good:
        constructed(settings, **{name: value})
    for value in bad:
        with pytest.raises(ValueError, match=rf"{name} (is )?{re.escape(repr(value))}"):
            constructed(settings, **{name: value})


COMMANDS: dict[type, dict[str, Any]] = {
    FlyOptions: {},
    EvaluateOptions: {},
    GradeOptions: {"assignment": "swap", "agent": ["a.py:A"]},
}


@pytest.mark.parametrize("options", COMMANDS)
@pytest.mark.parametrize("name", ["seed", "episodes", "drones"])
def test_commands_refuse_numbers_in_the_words_of_the_command_line(options, name):
    if name not in {field.name for field in fields(options)}:
        return
    with pytest.raises(ValueError, match=f"--{name} is -1, but must be an integer of at least"):
        options(**{**COMMANDS[options], name: -1})


@pytest.mark.parametrize("task", NAMES)
def test_a_view_shows_every_option(task):
    module, kind = getattr(swarm_envs, task), task_class(task)
    assert inspect.getdoc(module) == inspect.getdoc(kind)
    given = {f.name for f in fields(kind)} - {"success"}
    for view in (module.parallel_env, module.env, module.blueprint):
        parameters = inspect.signature(view).parameters
        assert parameters.keys() == given | {f.name for f in fields(TaskOptions)}
        assert all(p.kind is p.KEYWORD_ONLY for p in parameters.values())
        for name, value in kind.defaults.items():
            assert parameters[name].default == value
        for name in parameters:
            assert re.search(rf"^    {name} \(.*\): ", view.__doc__, re.MULTILINE)


def test_the_page_of_the_tasks_shows_every_option():
    text = settings_table("EnvConfig")
    assert "| `horizon_s` | `float \\| None` | `None` | Time limit: " in text
    page = task_page("pursuit_v0")
    assert "| `num_drones` | `int \\| None` | `8` |" in page
    assert "| `change_s` | `float` | `5.0` | Time between two swaps of goals, s. |" in page


WORDS = [
    *("--world", "hall", "--randomization", "mass=0.95:1.05", "--on-contact", "end_pair"),
    *("--obstacles", "column=1.8:1.8:0.1"),
]
"""On every command."""
CREW = ["--neighbors", "2", "--team", "SSL"]


def test_text_says_what_objects_say():
    text = "mass=0.9:1.1, gust_acceleration=1"
    ranges = Randomization(mass=(0.9, 1.1), gust_acceleration=1.0)
    assert Randomization.of(text) == ranges
    assert make("swap_v1", randomization=text, physics="batch").core.ranges == ranges
    standing = parse_obstacles("buildings=2:1,column=1:-1:0.15,box=0:0:0:1:1:2")
    assert standing == (
        *buildings(2, 1),
        Column((1.0, -1.0), 0.15),
        Box((0.0, 0.0, 0.0), (1.0, 1.0, 2.0)),
    )


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("randomization", "mas=0.9:1.1", "did you mean 'mass'"),
        ("randomization", "mass", "must be names with numbers"),
        ("randomization", "mass=1.1:0.9", "mass"),
        ("obstacles", "buildings", "must be names with numbers, such as buildings=2:2"),
        ("obstacles", "tree=1:2:3", "unknown obstacle 'tree'"),
        ("obstacles", "column=1:2", "must have 3"),
        ("obstacles", "buildings=1.5:2", "two integers"),
    ],
)
def test_text_that_says_nothing_is_refused(option, text, said):
    with pytest.raises(ValueError, match=said):
        make("swap_v1", physics="batch", **{option: text})


@pytest.mark.slow
def test_fly_and_evaluate_take_them(tmp_path):
    file = tmp_path / "report.json"
    given = [*WORDS, *CREW, "--agent", "straight-line", "--horizon-s", "0.5"]
    assert main(["fly", "--physics", "batch", *given]) == 0
    assert main(["evaluate", "--episodes", "2", "--json", str(file), *given]) == 0
    report = json.loads(file.read_text())
    asked = {"world": "hall", "on_contact": "end_pair", "num_neighbors": 2, "team": "SSL"}
    assert asked.items() <= report.items()
    assert report["agents"][0]["success_rate"] == 0.0


def test_train_flies_them(tmp_path):
    config = RlConfig(
        out=tmp_path,
        world="hall",
        randomization="mass=0.95:1.05",
        on_contact="end_pair",
        obstacles="column=1.8:1.8:0.1",
    )
    found = training_blueprint(with_defaults(config, "swap_v1"), "swap_v1", {"num_drones": 3})
    assert found.config.hall is not None and found.config.on_contact == "end_pair"
    assert found.config.ranges == Randomization(mass=(0.95, 1.05))
    assert found.task.obstacles == (Column((1.8, 1.8), 0.1),)
    assert found.task.reward_weights["at_goal"] == pytest.approx(2.0 / 3.5)


@pytest.mark.parametrize("command", ["fly", "evaluate", "train"])
def test_a_team_and_another_number_of_drones_contradict_each_other(command, tmp_path, refused):
    said = refused(command, "--team", "SSL", "--drones", "5", "--out", tmp_path / "out")
    assert "--drones is 5, but --team SSL has 3; give one of them" in said
    assert not [*tmp_path.iterdir()]
    assert FlyOptions(team="SSL", drones=3).setting()["team"] == "SSL"


@pytest.mark.parametrize("command", ["fit", "train", "fly", "evaluate", "benchmark"])
def test_the_help_begins_with_what_matters_most(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    said = capsys.readouterr().out
    first = {"fit": ["data", "out"], "fly": ["task"], "evaluate": ["task"]}.get(command, ["out"])
    assert re.findall(r"--([a-z-]+)", said.split("--help")[-1])[: len(first)] == first
