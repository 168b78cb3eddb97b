"""The public face: every function and class that docs and packages offer, each in a valid call.

Classes that hold settings need no entry: their defaults are one. `CALLS` has the others, as small
as they can be; `EXEMPT` says why a name has none. A test holds that every name has one or other.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from swarm_envs import agents, make
from swarm_envs.agents import fly_episode, record_episode
from swarm_envs.agents.scripted import HoverAgent
from swarm_envs.control.config import PositionGains
from swarm_envs.envs.config import EnvConfig
from swarm_envs.interactions import load
from swarm_envs.physics import BatchPhysics
from swarm_envs.vehicles import parse_team
from tests.helpers.imports import ROOT, SOURCES

STARTS, GOALS = np.array([[0.0, 0, 1], [1.0, 0, 1]]), np.array([[0.0, 1, 1], [1.0, 1, 1]])
CORNERS = [[0, 0, 0], [3, 3, 3]]
EXEMPT = {
    "reproduce_figure": "a job of minutes; the command's options are checked",
    "fit": "a job; its configuration is checked",
    "fit_feedforward": "likewise",
    "collect": "likewise",
    "compare_compensation": "likewise",
    "run_curriculum": "likewise",
    "read_flights": "reads what `collect` wrote, by the same configuration",
    "search": "takes a PlanningProblem, which is checked",
    "straight_lines": "likewise",
    "smooth": "takes a SplineFlight, which the planner makes",
    "plot_plan": "takes a SwarmPlan, which the planner makes",
    "interaction_force": "takes logs that `collect` made",
    "interaction_rows": "likewise",
    "next_clearance": "takes what a round of the curriculum found",
    "format_summary": "takes what `reproduce_figure` returned",
    "bullet_available": "takes nothing",
    "Serial": "takes nothing",
    "Agent": "a protocol",
    "DeepSet": "takes a DeepSetSpec, which is checked",
    "Physics": "abstract; its engines are called",
    "Placement": "a tuple that tasks make",
    "PlanNotFound": "an exception",
    "PlanTimeout": "an exception",
    "SwarmParallelEnv": "made by `make`",
    "FadeWindow": "a tuple within settings",
    "Recorder": "takes an environment",
    "Recording": "made by a Recorder",
    "write_replay": "takes a Recording",
    "record_episode": "as `fly_episode`",
    "save_network": "takes a network",
    "save_rows": "takes rows, which are checked",
    "write_table": "takes a table, which is checked",
    "Trajectories": "arrays that the planner makes",
    "GridInstance": "made by `make_instance`",
    "PlanningProblem": "made by `plan_swarm`, whose arguments they are",
    "InteractionModel": "made by `load`",
    "ForceField": "arrays for kernels, made by `load`",
    "Flight": "made by `flight_of` and `flight_along`; what it refuses is in tests/deploy",
    "Pieces": "made by `fit_pieces` and `read_pieces`; likewise",
    "Separation": "a tuple that exports make",
    "fit_flight": "takes a Flight, which is checked",
    "settled": "likewise",
    "export_flight": "likewise",
    "flight_of": "takes a Recording, which is checked",
    "flight_along": "takes a path that a planner makes",
    "fit_pieces": "what it refuses is in tests/deploy",
    "read_pieces": "likewise",
    "write_pieces": "takes Pieces, which are checked",
    "report": "a job of `benchmark`; the command's options are checked",
    "write": "likewise",
    "fly_benchmark": "likewise",
    "choose_tasks": "likewise",
    "evaluate": "a generator of many flights; the command's options are checked",
    "episodes_of": "takes a name and a task of the benchmark's tables",
    "claimed": "takes a folder",
    "kernel": "compiles a function, which numba checks",
}
OWN: tuple[str, ...] = ("make(swap_v0)", "make(ring_v0)", "make(formation_v0)", "make")
OWN += ("env.reset", "env.step")
OWN += ("env.reset options", "vector.step", "BatchPhysics", "BulletPhysics", "physics.step")
OWN += ("forces", "fly_episode", "write_trajectory")
"""Calls that are more than one function with its arguments: see `calls`."""
RESULTS = re.compile(r"(Result|Report|Record|Plan|Table|Rows|Log|Judgement|Closeness|Contacts)$")
"""Classes that functions make and callers read."""


class Call(NamedTuple):
    """A public function in a valid call."""

    function: Callable[..., Any]
    valid: Mapping[str, Any]
    """Its arguments by name."""


@cache
def public() -> dict[str, Any]:
    """Functions and classes that packages export, or that docs and examples import."""
    found = set()
    for module, file in SOURCES.items():
        if file.name == "__init__.py":
            names = getattr(importlib.import_module(module), "__all__", ())
            found |= {(module, name) for name in names}
    for text in _documents():
        for module, names in re.findall(r"from (swarm_envs[\w.]*) import \(?([\w, \n]+)\)?", text):
            found |= {(module, name) for name in re.findall(r"\w+", names)}
    offered = {name: getattr(importlib.import_module(m), name, None) for m, name in sorted(found)}
    return {name: o for name, o in offered.items() if inspect.isfunction(o) or inspect.isclass(o)}


def _documents() -> Iterator[str]:
    folders = (ROOT / "docs", ROOT / "examples")
    files = [file for folder in folders for file in folder.rglob("*")]
    for file in [ROOT / "README.md", *files]:
        if file.suffix in (".md", ".py", ".ipynb") and "extensions" not in file.parts:
            yield file.read_text(encoding="utf-8")


def settings() -> dict[str, Call]:
    """Classes that hold settings, with their required fields from `REQUIRED`."""
    found = {}
    for name, kind in public().items():
        if dataclasses.is_dataclass(kind) and not RESULTS.search(name) and name not in EXEMPT:
            given = REQUIRED.get(name, {})
            fields = [f for f in dataclasses.fields(kind) if f.init]
            found[name] = Call(
                cast(Any, kind), {f.name: given.get(f.name, _default(f)) for f in fields}
            )
    return found


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    return field.default_factory() if callable(field.default_factory) else None


def _flown(task: str, **options: Any) -> object:
    """An environment, and a little flight in it."""
    env = make(task, **options)
    try:
        first = env.reset(seed=0)
        actions = {agent: env.action_space(agent).sample() * 0.0 for agent in env.agents}
        return first, env.step(actions)
    finally:
        env.close()


def _env(**options: Any) -> Any:
    env = make("swap_v0", num_drones=2, physics="batch", interactions="none", **options)
    env.reset(seed=0)
    return env


def _reset(**given: Any) -> object:
    seed = given.pop("seed")
    return _env().reset(seed=seed, options=given.pop("options", given))


def _step(actions: Any) -> object:
    return _env().step(actions)


def _vector_step(actions: Any) -> object:
    import gymnasium

    env = gymnasium.make_vec("swarm_envs/Swap-v0", num_envs=2, num_drones=2, interactions="none")
    env.reset(seed=0)
    return env.step(actions)


def _physics(**given: Any) -> object:
    physics = BatchPhysics(**given)
    return physics.reset()


def _physics_step(**given: Any) -> object:
    physics = BatchPhysics("SS", interactions="none")
    physics.reset()
    return physics.step(**given)


def _recorded(path: Path) -> object:
    from swarm_envs.viewing.trajectory import write_trajectory

    env = _env(horizon_s=0.2, **HoverAgent.requires)
    return write_trajectory(path, record_episode(env, HoverAgent(), 0))


def _fly(seed: Any) -> object:
    return fly_episode(_env(horizon_s=0.2, **HoverAgent.requires), HoverAgent(), seed)


def _simulated(**given: Any) -> None:
    public()["simulate"](**given)  # NaN there says that a drone never arrived


def calls(folder: Path) -> dict[str, Call]:
    """Public functions in valid calls; what they write goes into the folder."""
    shared = dict.fromkeys(EnvConfig.__annotations__)
    shared |= {"physics": "batch", "interactions": "none", "action": "acceleration"}
    shared |= {"precision": "float64", "decision_rate": 48, "force_rate": 240}
    shared |= {"observation": "flat", "num_neighbors": 1}
    shared |= {"end_on_success": True, "deterministic": False, "force_bounds_g": {"S": 5.0}}
    shared |= {"num_drones": 2, "team": None, "obstacles": (), "reward_weights": None}
    shared |= {"render_mode": None}
    own: dict[str, dict[str, Any]] = {
        "swap_v0": {"layout": "random", "stacked": None, "circle": None},
        "ring_v0": {"rings": None},
        "formation_v0": {"layout": None, "letters": None, "shapes": None, "shape_s": 6.0},
    }
    physics: dict[str, Any] = {"team": "SS", "num_envs": 1, "interactions": "none", "arena": None}
    physics |= {"battery": None, "force_rate": 240, "gusts": None, "obstacles": None}
    learned = load("learned")
    found = {
        **{f"make({t})": Call(partial(_flown, t), {**shared, **o}) for t, o in own.items()},
        "make": Call(make, {"task": "swap_v0"}),
        "env.reset": Call(_reset, {"seed": 0, "start": STARTS, "goal": GOALS, "team": "SS"}),
        "env.reset options": Call(_reset, {"seed": 0, "options": {}}),
        "env.step": Call(_step, {"actions": dict.fromkeys(("drone_0", "drone_1"), np.zeros(3))}),
        "vector.step": Call(_vector_step, {"actions": np.zeros((2, 6))}),
        "BatchPhysics": Call(_physics, physics),
        "BulletPhysics": Call(public()["BulletPhysics"], physics),
        "physics.step": Call(
            _physics_step, {"commands": np.full((1, 2, 4), 0.08), "external_force": None}
        ),
        "forces": Call(
            learned.forces, {"position": STARTS[None], "velocity": 0 * STARTS[None], "team": "SS"}
        ),
        "fly_episode": Call(_fly, {"seed": 0}),
        "agents.load": Call(agents.load, {"name": "hover"}),
        "write_trajectory": Call(_recorded, {"path": folder / "flight.npz"}),
    }
    found |= {name: Call(public()[name], given) for name, given in GIVEN.items()}
    return found | {"simulate": Call(_simulated, GIVEN["simulate"])}


PLAN: dict[str, Any] = {"starts": CORNERS, "goals": CORNERS[::-1], "shape": (6, 6, 6)}
GIVEN: dict[str, dict[str, Any]] = {
    "parse_team": {"team": "SSL"},
    "load": {"name": "learned"},
    "load_belief": {"truth": "learned"},
    "SafetyFilter": {"agent": HoverAgent(), "safety": None},
    "rest_to_rest": {"start": STARTS, "goal": GOALS, "duration": 1.0, "t": 0.5},
    "error_ball": {"gains": PositionGains(1.5, 2.5, 0.5), "mass": 0.03, "error_rate": 0.1},
    "plan": {**PLAN, "obstacles": None, "method": "auto", "seed": 0, "time_limit": None},
    "validate": {"paths": [CORNERS, CORNERS], **PLAN, "goals": CORNERS, "obstacles": None},
    "max_density": {"shape": (6, 6, 6), "obstacles": None},
    "building_columns": {"shape": (6, 6, 6)},
    "make_instance": {"family": "uniform", "shape": (6, 6, 6), "count": 4, "seed": 0},
    "simulate": {
        **{"starts": STARTS, "targets": GOALS, "compute_units": 1, "trigger": "HT", "loss": 0.0},
        **{"recovery": True, "seed": 0, "duration_s": 0.4, "config": None, "solver": "daqp"},
        **{"measure": "end", "informed": True, "outages": (), "joins": None, "leaves": None},
        **{"obstacles": None, "stop_on_arrival": True, "progress": False},
    },
    "MlrDmpcSwarm": {
        **{"starts": STARTS, "targets": GOALS, "config": None, "compute_units": 1},
        **{"trigger": "HT", "loss": 0.0, "recovery": True, "seed": 0, "solver": "daqp"},
    },
    "MlrDmpcAgent": {
        **{"compute_units": None, "trigger": "HT", "loss": 0.0, "recovery": True},
        **{"controller": None, "config": None},
    },
    "TrackingAgent": {"controller": None, "decision_rate": 48},
    "PlanAgent": {"belief": None, "decision_rate": 48},
    "plan_swarm": {
        **{"starts": STARTS, "goals": GOALS, "team": "SS", "model": "none", "bounds": None},
        **{"seed": 0, "plane": "xyz", "dt": 0.1, "max_duration": 5.0, "time_limit": 0.05},
        **{"attempts": 1, "initial": None, "search": None, "options": None, "progress": False},
    },
    "SharedPolicyVecEnv": {"task": "swap_v0", "num_envs": 1, "seed": 0, "num_drones": 2},
    "read_trajectory": {"path": Path("no.npz")},
    "read_logs": {"path": Path("no.csv")},
    "read_table": {"path": Path("no.csv")},
    "read_rows": {"path": Path("no.npz")},
    "load_network": {"path": Path("no.safetensors")},
}
"""Arguments of those that are called as they are."""
REQUIRED: dict[str, dict[str, Any]] = {
    "GilbertElliott": {"turns_bad": 0.1, "turns_good": 0.5},
    "Jam": {"first_round": 1, "last_round": 2},
    "UnitOutage": {"unit": 0, "first_round": 1},
    "SmoothingConfig": {"distance": 0.3, "box": ((0.0, 0.0, 0.0), (3.0, 3.0, 3.0))},
    "DeepSetSpec": {"types": ("S",)},
    "FitConfig": {"out": Path("fit"), "data": Path("data")},
    "CurriculumConfig": {"out": Path("curriculum")},
    "FeedforwardConfig": {"out": Path("belief")},
    "Job": {"function": "module:function", "arguments": {}},
    "SwapTask": {"team": parse_team("SS")},
}
"""Fields of settings that have no default."""
