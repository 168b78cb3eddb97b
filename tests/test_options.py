"""Options and arguments: refused by name, explained; commands say alike what is flown."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import pickle
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from docs.extensions.option_tables import expand
from swarm_envs import crowd_v0, formation_v1, gates_v0, make, pursuit_v0, ring_v1, swap_v1
from swarm_envs.agents.safety import Safety
from swarm_envs.arguments import Option, Range, WrongKind, kind_of, options_of, typed
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import GilbertElliott, Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.swarm import UnitOutage
from swarm_envs.baselines.neural_swarm.planner.ao_rrt import SearchConfig
from swarm_envs.baselines.neural_swarm.planner.problem import PlanningBounds
from swarm_envs.baselines.neural_swarm.planner.scp import RefinementOptions
from swarm_envs.baselines.rth3d.flight.smooth import SmoothingConfig
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
from swarm_envs.envs.randomization import Randomization
from swarm_envs.hall import Hall
from swarm_envs.motors import BatteryModel
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ByScore, Success, TrackingSuccess
from swarm_envs.tasks.crowd import CrowdTask
from swarm_envs.tasks.formation import FormationTask
from swarm_envs.tasks.gates import GatesTask
from swarm_envs.tasks.obstacles import Box, Column, buildings, parse_obstacles
from swarm_envs.tasks.pursuit import PursuitTask
from swarm_envs.tasks.ring import FIVE, RingLayout, RingTask
from swarm_envs.tasks.swap import CircleLayout, StackedLayout, SwapTask
from swarm_envs.training.belief.feedforward import FeedforwardConfig
from swarm_envs.training.collection import CollectionConfig
from swarm_envs.training.collection.log import SensorNoise
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.rl.recipes import with_recipe
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.runs import training_blueprint
from swarm_envs.vehicles import SMALL, Vehicle

TEAM = {"team": (SMALL,) * 5}
SETTINGS: dict[type, dict[str, Any]] = {
    **dict.fromkeys((SwapTask, RingTask, FormationTask, CrowdTask), TEAM),
    **dict.fromkeys((PursuitTask, GatesTask), TEAM),
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
    swap_v1.SwapOptions: {},
    ring_v1.RingOptions: {},
    formation_v1.FormationOptions: {},
    crowd_v0.CrowdOptions: {},
    pursuit_v0.PursuitOptions: {},
    gates_v0.GatesOptions: {},
}
"""Classes of settings whose annotations hold every range, and what they must be given."""
OTHERS: dict[type, dict[str, Any]] = {
    **{kind: {} for kind in (MlrDmpcConfig, PlanningBounds, RefinementOptions, SearchConfig)},
    SmoothingConfig: {"distance": 0.3, "box": ((0.0, 0.0, 0.0), (3.0, 3.0, 3.0))},
    Jam: {"first_round": 1, "last_round": 2},
    **{kind: {} for kind in (SensorNoise, LogOptions, CollectionConfig)},
    MotionRanges: {},
    FeedforwardConfig: {"out": Path("belief")},
    FitConfig: {"out": Path("fit"), "data": Path("data")},
}
"""Classes of settings that check some ranges themselves."""
NUMBERS = st.one_of(st.floats(), st.integers(-5, 10**9), st.sampled_from([math.nan, math.inf]))
ANYTHING = st.one_of(
    *(NUMBERS, st.booleans(), st.none(), st.text(max_size=5), st.binary(max_size=5)),
    *(st.tuples(NUMBERS, NUMBERS), st.lists(st.text(max_size=3), max_size=3), st.just({})),
)


@pytest.mark.parametrize("settings", [*SETTINGS, *OTHERS])
@given(data=st.data(), value=ANYTHING)
def test_bad_values_are_refused_by_name(settings, data, value):
    option = data.draw(st.sampled_from(list(options_of(settings).values())))
    given = {**SETTINGS, **OTHERS}[settings] | {option.name: value}
    if option.kind.fits(value):
        return
    with pytest.raises(ValueError) as error:  # a TypeError too, where the type is wrong
        settings(**given)
    told = str(error.value)
    assert option.name in told and f"{value!r:.80}" in told
    assert isinstance(error.value, TypeError) == (not option.kind.has_type(value))
    assert option.kind.words in told or all(repr(name) in told for name in option.kind.names)


@pytest.mark.parametrize("settings", OTHERS)
def test_classes_that_check_ranges_themselves_refuse_by_name(settings):
    for name in options_of(settings):
        for value in (math.nan, math.inf, -math.inf, -1, 0, 0.5, 5e-324, 1e300, 10**30, ""):
            try:
                settings(**{**OTHERS[settings], name: value})
            except ValueError as error:
                told = str(error)
                words = (name, name.rstrip("s"), name.replace("_", " "), f"{value!r:.20}")
                assert any(word in told for word in words)


def test_every_option_says_what_it_is_and_allows_its_default():
    for settings in SETTINGS:
        for option in options_of(settings).values():
            assert re.match(r"\S.* .*\S", option.meaning), option
            if option.default is not dataclasses.MISSING:
                assert option.kind.fits(option.default), option


def test_a_number_with_a_range_is_finite_and_no_truth_value():
    bad = (math.nan, math.inf, -math.inf, -1, True, np.bool_(True), "1", 1j, -1e-300)
    for settings in SETTINGS:
        for option in options_of(settings).values():
            if option.kind.words.startswith(("positive", "an integer")):
                assert not any(map(option.kind.fits, bad)), option


def test_every_number_of_a_fit_has_a_range():
    for settings in (FitConfig, LogOptions, MotionRanges, SensorNoise):
        for option in options_of(settings).values():
            if option.kind.has_type(1):
                assert not option.kind.fits(-1), option.name


BOUNDS: list[tuple[type, str, list[Any], list[Any]]] = [
    (swap_v1.SwapOptions, "num_drones", [1, np.int64(2)], [0, 2.0, 100_001]),
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
    (RingLayout, "phases_rad", [(-1.0, 9.0)], [(0.0,), (0.0, math.inf)]),
    (RingLayout, "lead_s", [(0.0, 0.0), (0.0, 60.0)], [(3.0, 1.0), (-1.0, 1.0)]),
    (CrowdTask, "reach_m", [(1.0, 1.0)], [(2.0, 1.0), (0.0, 1.0), 2.0]),
    (BatteryModel, "capacity_ah", [0.1], [0.0, math.nan]),
    (BatteryModel, "idle_current_a", [0.0, 1.0], [-1.0, math.inf]),
    (Vehicle, "inertia", [(1e-6, 1e-6, 2e-6)], [(1e-6, 1e-6), (1e-6, 0.0, 1e-6)]),
    (formation_v1.FormationOptions, "turn_rad", [(-1.0, 1.0), (0, 0)], [(1.0, 0.0), (0.0,)]),
]


@pytest.mark.parametrize(("settings", "name", "good", "bad"), BOUNDS)
def test_ranges_end_where_they_should(settings, name, good, bad):
    for value in good:
        settings(**{**SETTINGS[settings], name: value})
    for value in bad:
        with pytest.raises(ValueError, match=rf"{name} is {re.escape(repr(value))}, but must be"):
            settings(**{**SETTINGS[settings], name: value})


COMMANDS: dict[type, dict[str, Any]] = {
    FlyOptions: {},
    EvaluateOptions: {},
    GradeOptions: {"assignment": "swap", "agent": ["a.py:A"]},
}


@pytest.mark.parametrize("options", COMMANDS)
def test_commands_refuse_numbers_in_the_words_of_the_command_line(options):
    table: dict[str, Option] = options_of(options)
    counted = [name for name, option in table.items() if "at least" in option.kind.words]
    assert "seed" in counted
    for name in counted:
        flag = f"--{name.replace('_', '-')}"
        with pytest.raises(ValueError, match=f"{flag} is -1, but must be an integer of at least"):
            options(**{**COMMANDS[options], name: -1})


@pytest.mark.parametrize("module", [swap_v1, ring_v1, formation_v1, crowd_v0, pursuit_v0, gates_v0])
def test_a_view_shows_every_option(module):
    for view in (module.parallel_env, module.env, module.blueprint):
        parameters = inspect.signature(view).parameters
        assert all(p.kind is p.KEYWORD_ONLY for p in parameters.values())
        for name in parameters:
            assert re.search(rf"^    {name}: ", view.__doc__, re.MULTILINE)


def test_the_page_of_the_tasks_shows_every_option():
    text = expand("<!-- option table: EnvConfig -->\n\n<!-- option table: SwapOptions -->")
    assert "| `horizon_s` | positive and finite, in s, or None | `None` | Time limit: " in text
    assert "| `num_drones` | an integer of at least 1 and at most 100,000 | `4` |" in text


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
    found = training_blueprint(with_recipe(config, "swap_v1"), "swap_v1", {"num_drones": 3})
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


if TYPE_CHECKING:
    from nowhere import Unknown  # type: ignore[import-not-found]


@typed
def job(
    count: int = 0,
    share: float | None = None,
    name: str = "",
    mode: Literal["a", "b"] = "a",
    yes: bool = True,
    path: Path = Path(),
    sizes: tuple[float, float] = (0.0, 1.0),
    names: tuple[str, ...] = (),
    shape: Sequence[int] = (),
    points: npt.ArrayLike = 0.0,
    array: FloatArray | None = None,
    weights: Mapping[str, float] | None = None,
    watch: Callable[[str], None] | None = None,
    unknown: Unknown = None,
    **others: Any,
) -> dict[str, Any]:
    return locals()


GOOD: list[dict[str, Any]] = [
    {"count": 3},
    {"count": np.int64(3), "share": np.float32(0.5)},
    {"share": 1, "names": ["a"], "sizes": [1, 2.5]},
    {"share": float("nan")},
    {"mode": "b", "yes": np.bool_(False), "shape": np.array([3, 4])},
    {"points": [[0, 1], [2, 3]], "array": np.zeros(3), "weights": {"a": 1.0}},
    {"watch": print, "unknown": object(), "whatever": None, "share": None},
]
BAD: list[tuple[str, Any, str]] = [
    ("count", True, "an integer"),
    ("count", 1.0, "an integer"),
    ("count", "1", "an integer"),
    ("share", "0.5", "a number or None"),
    ("share", 1j, "a number or None"),
    ("name", None, "text"),
    ("mode", 1, "'a' or 'b'"),
    ("yes", 1, "True or False"),
    ("path", "here", "a pathlib.Path"),
    ("sizes", (1.0,), "a tuple: a number, a number"),
    ("names", "abc", "a sequence, each text"),
    ("names", ("a", 1), "a sequence, each text"),
    ("shape", 3, "a sequence, each an integer"),
    ("points", "abc", "an array of numbers"),
    ("points", [[1.0], [1.0, 2.0]], "an array of numbers"),
    ("array", [None], "an array of numbers or None"),
    ("weights", [("a", 1.0)], "a mapping or None"),
    ("watch", "print", "a function or None"),
]


@pytest.mark.parametrize("given", GOOD)
def test_what_fits_goes_through(given):
    found = job(**given)
    assert all(found[name] is value for name, value in given.items() if name in found)


@pytest.mark.parametrize(("name", "value", "words"), BAD)
def test_what_does_not_fit_is_named_with_its_value(name, value, words):
    with pytest.raises(WrongKind) as error:
        job(**{name: value})
    assert str(error.value) == f"{name} is {value!r:.80}, but must be {words}"
    assert isinstance(error.value, TypeError) and isinstance(error.value, ValueError)


def test_text_that_is_none_of_those_that_may_be_is_told_the_nearest():
    with pytest.raises(WrongKind, match=r"unknown mode 'c'; .*valid: 'a', 'b'"):
        job(mode="c")  # type: ignore[arg-type]


def test_arguments_by_place_are_looked_at_too():
    with pytest.raises(WrongKind, match="share is 'x'"):
        job(1, "x")  # type: ignore[arg-type]


def test_what_goes_by_name_alone_is_not_taken_by_place():
    @typed
    def named(*, first: int = 0) -> int:
        return first

    with pytest.raises(TypeError, match="takes 0 positional arguments but 1 was given"):
        named(1)  # type: ignore[call-arg]


@typed
@dataclass(frozen=True)
class Settings:
    size: float
    name: str = "a"


def test_a_class_stays_what_it_was():
    one = Settings(2, name="b")
    assert one == pickle.loads(pickle.dumps(one))  # noqa: S301  # our own
    assert [f.name for f in fields(Settings)] == ["size", "name"]
    assert list(inspect.signature(Settings).parameters) == ["size", "name"]
    with pytest.raises(WrongKind, match="size is None, but must be a number"):
        Settings(None)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'size'"):
        Settings()  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("rule", "words"),
    [
        (Range(), "a finite number"),
        (Range(0.0), "finite and not negative"),
        (Range(1.0, unit="m"), "a finite number of at least 1, in m"),
        (Range(-2.5, above=True), "a finite number above -2.5"),
        (Range(-1.0, 2.0, below=True), "a number in [-1, 2)"),
    ],
)
def test_a_range_names_its_ends(rule, words):
    assert kind_of(Annotated[float, rule]).words == words


def test_integers_beyond_every_float_are_refused_or_taken_without_overflow():
    huge = 10**400
    number, integer = kind_of(Annotated[float, Range(0.0)]), kind_of(Annotated[int, Range(0)])
    assert not number.fits(huge) and number.fits(10**300)
    assert integer.fits(huge)
