"""Public functions that take values of users, each in a valid call, as small as it can be."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swarm_envs import agents, make, task_family
from swarm_envs.agents import fly_episode, record_episode
from swarm_envs.agents.scripted import HoverAgent
from swarm_envs.baselines import mlr_dmpc, neural_swarm, rth3d
from swarm_envs.baselines.neural_swarm.agent import PlanAgent
from swarm_envs.baselines.neural_swarm.theorem import error_ball
from swarm_envs.control.config import PositionGains
from swarm_envs.deploy import evaluate, flight_along, read_pieces, settled
from swarm_envs.deploy.pieces import Pieces
from swarm_envs.envs.config import EnvConfig
from swarm_envs.interactions import load
from swarm_envs.physics import BatchPhysics, BulletPhysics
from swarm_envs.training import SharedPolicyVecEnv
from swarm_envs.training.flight_logs.read import read_logs
from swarm_envs.training.flight_table import read_table
from swarm_envs.training.force_model import load_network
from swarm_envs.training.interaction_rows import read_rows
from swarm_envs.trajectories import ramped_line, rest_to_rest
from swarm_envs.vehicles import parse_team, team_string
from swarm_envs.viewing.trajectory import read_trajectory
from tests.helpers.sources import SOURCES

STARTS, GOALS = np.array([[0.0, 0, 1], [1.0, 0, 1]]), np.array([[0.0, 1, 1], [1.0, 1, 1]])
CORNERS = [[0, 0, 0], [3, 3, 3]]


class Call(NamedTuple):
    """A public function in a valid call."""

    function: Callable[..., Any]
    valid: Mapping[str, Any]  # Its arguments by name


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

    env = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=2, num_drones=2, interactions="none")
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
    mlr_dmpc.simulate(**given)  # NaN there says that a drone never arrived


def calls(folder: Path) -> dict[str, Call]:
    """Public functions in valid calls; what they write goes into the folder."""
    shared = dict(vars(EnvConfig()))
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
        "BulletPhysics": Call(BulletPhysics, physics),
        "physics.step": Call(
            _physics_step, {"commands": np.full((1, 2, 4), 0.08), "external_force": None}
        ),
        "forces": Call(
            learned.forces, {"position": STARTS[None], "velocity": 0 * STARTS[None], "team": "SS"}
        ),
        "fly_episode": Call(_fly, {"seed": 0}),
        "agents.load": Call(agents.load, {"name": "hover"}),
        "agents.recommended": Call(
            agents.recommended,
            {"task": "swap", "num_drones": 4, "learned": None, "privileged": None},
        ),
        "write_trajectory": Call(_recorded, {"path": folder / "flight.npz"}),
    }
    found |= {function.__name__: Call(function, given) for function, given in GIVEN.items()}
    return found | {"simulate": Call(_simulated, GIVEN[mlr_dmpc.simulate])}


def _line(t: float) -> Any:
    return rest_to_rest(STARTS, GOALS, 1.0, t)


PIECES = Pieces(np.ones(1), np.zeros((1, 4, 8)))
PLAN: dict[str, Any] = {"starts": CORNERS, "goals": CORNERS[::-1], "shape": (6, 6, 6)}
GIVEN: dict[Callable[..., Any], dict[str, Any]] = {
    parse_team: {"team": "SSL"},
    task_family: {"task": "swap_v1"},
    team_string: {"team": parse_team("SSL")},
    evaluate: {"pieces": PIECES, "time": [0.5], "derivative": 0, "single": False},
    flight_along: {"reference": _line, "duration_s": 1.0, "team": "SS", "rate": 200.0},
    settled: {"flight": flight_along(_line, 1.0, "SS"), "seconds": 1.0},
    read_pieces: {"path": Path("no.csv")},
    load: {"name": "learned"},
    neural_swarm.load_belief: {"truth": "learned"},
    agents.SafetyFilter: {"agent": HoverAgent(), "safety": None},
    rest_to_rest: {"start": STARTS, "goal": GOALS, "duration": 1.0, "t": 0.5},
    ramped_line: {"start": STARTS, "goal": GOALS, "duration": 1.0, "t": 0.5, "ramp": 0.2},
    error_ball: {"gains": PositionGains(1.5, 2.5, 0.5), "mass": 0.03, "error_rate": 0.1},
    rth3d.plan: {
        **{**PLAN, "obstacles": None, "method": "auto", "seed": 0, "time_limit": None},
        **{"configurations": None, "objective": "makespan"},
    },
    rth3d.plan_lifelong: {
        **{**PLAN, "goals": [[corner] for corner in CORNERS]},
        **{"steps": 20, "obstacles": None, "seed": 0},
    },
    rth3d.validate: {"paths": [CORNERS, CORNERS], **PLAN, "goals": CORNERS, "obstacles": None},
    rth3d.max_density: {"shape": (6, 6, 6), "obstacles": None},
    rth3d.building_columns: {"shape": (6, 6, 6)},
    rth3d.make_instance: {"family": "uniform", "shape": (6, 6, 6), "count": 4, "seed": 0},
    mlr_dmpc.simulate: {
        **{"starts": STARTS, "targets": GOALS, "compute_units": 1, "trigger": "HT", "loss": 0.0},
        **{"recovery": True, "seed": 0, "duration_s": 0.4, "config": None, "solver": "daqp"},
        **{"measure": "end", "informed": True, "outages": (), "joins": None, "leaves": None},
        **{"obstacles": None, "stop_on_arrival": True, "progress": False},
    },
    mlr_dmpc.MlrDmpcSwarm: {
        **{"starts": STARTS, "targets": GOALS, "config": None, "compute_units": 1},
        **{"trigger": "HT", "loss": 0.0, "recovery": True, "seed": 0, "solver": "daqp"},
    },
    mlr_dmpc.MlrDmpcAgent: {
        **{"compute_units": None, "trigger": "HT", "loss": 0.0, "recovery": True},
        **{"controller": None, "config": None},
    },
    neural_swarm.TrackingAgent: {"controller": None, "decision_rate": 48},
    PlanAgent: {"belief": None, "decision_rate": 48},
    neural_swarm.plan_swarm: {
        **{"starts": STARTS, "goals": GOALS, "team": "SS", "model": "none", "bounds": None},
        **{"seed": 0, "plane": "xyz", "dt": 0.1, "max_duration": 5.0, "time_limit": 0.05},
        **{"attempts": 1, "initial": None, "search": None, "options": None, "progress": False},
    },
    SharedPolicyVecEnv: {"task": "swap_v0", "num_envs": 1, "seed": 0, "num_drones": 2},
    read_trajectory: {"path": Path("no.npz")},
    read_logs: {"path": Path("no.csv")},
    read_table: {"path": Path("no.csv")},
    read_rows: {"path": Path("no.npz")},
    load_network: {"path": Path("no.safetensors")},
}
"""Arguments of those that are called as they are."""

NOT_CALLED: dict[str, tuple[str, ...]] = {
    "takes what another function has made, not values of users": (
        *("plot_plan", "report", "flight_of", "export_flight"),
        *("write_replay", "write_table", "save_network", "save_rows"),
        *("interaction_force", "interaction_rows"),
    ),
    "takes settings, which tests/test_options.py gives bad values": (
        *("collect", "fit", "search"),
    ),
    "begins as `fly_episode` does, which is called": ("record_episode",),
    "takes no argument": ("bullet_available",),
}
"""Listed functions that are not called with hostile values, by the reason."""


SINGLE_MODULES = ("swarm_envs.vehicles", "swarm_envs.trajectories")
"""Modules that users import from and that are no packages."""


def listed_functions() -> set[str]:
    """Names of the functions that the modules of docs/public.md list."""
    found = set()
    for module, file in SOURCES.items():
        if file.name == "__init__.py" or module in SINGLE_MODULES:
            home = import_module(module)
            names = getattr(home, "__all__", ())
            found |= {name for name in names if inspect.isfunction(getattr(home, name))}
    return found
