"""States with which an exported policy tests itself, and what the policy does in them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from swarm_envs.agents.feature_sets import FEATURE_SETS, REFERENCE
from swarm_envs.agents.networks import act
from swarm_envs.agents.policy_file import Policy
from swarm_envs.c_text import rows
from swarm_envs.envs.observation import Float32Array, observation_layout, observation_width
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

SAMPLES = 16
"""States in the header's self-test."""
MORE = 2
"""So many others beyond those that the policy sees."""


class KnownState(NamedTuple):
    """What one drone knows: of all drones, itself first, and of itself alone. World frame, SI."""

    position: Float32Array
    """(M, 3) m."""
    velocity: Float32Array
    """(M, 3) m/s."""
    goal: Float32Array
    """(M, 3) m."""
    types: npt.NDArray[np.int64]
    """(M,) index among `VEHICLES`."""
    up: Float32Array
    """(3,) direction of thrust."""
    thrust: np.float32
    """Share of the largest."""
    setpoint: Float32Array
    """(3,) m."""
    task: Float32Array
    """(1,) share of the clock that is left; or (9,) the reference's position, velocity and
    acceleration."""


def draw_state(policy: Policy, others: int, rng: np.random.Generator) -> KnownState:
    """A state as might be met in flight, with so many others."""
    note, count = policy.note, 1 + others
    known = [k for k, token in enumerate(VEHICLES) if not note.types or token in note.types]
    position = rng.uniform([-1.0, -1.0, 0.4], [1.0, 1.0, 2.0], (count, 3))
    velocity = rng.normal(0.0, 0.5, (count, 3))
    up = rng.normal([0.0, 0.0, 1.0], 0.2)
    task = np.array([rng.uniform()])
    if note.features == REFERENCE:
        near = position[0] + rng.normal(0.0, 0.1, 3)
        task = np.concatenate([near, rng.normal(0.0, 0.5, 3), rng.normal(0.0, 0.8, 3)])
    goal = rng.uniform([-1.5, -1.5, 0.5], [1.5, 1.5, 2.0], (count, 3))
    return KnownState(
        position.astype(np.float32),
        velocity.astype(np.float32),
        goal.astype(np.float32),
        np.asarray(rng.choice(known, count)),
        (up / np.linalg.norm(up)).astype(np.float32),
        np.float32(rng.uniform(0.3, 0.8)),
        (position[0] + rng.normal(0.0, 0.05, 3)).astype(np.float32),
        task.astype(np.float32),
    )


def observation_row(policy: Policy, state: KnownState) -> Float32Array:
    """(width,) what an environment would tell a drone in a state, as far as policies look at it."""
    note = policy.note
    layout = {f.name: f.where for f in observation_layout(note.num_neighbors)}
    row = np.zeros(observation_width(note.num_neighbors))
    position, velocity, goal = (np.asarray(part, np.float64) for part in state[:3])
    codes = np.eye(len(VEHICLES))[state.types]
    row[layout["self.position"]] = position[0]
    row[layout["self.velocity"]] = velocity[0] / SPEED_LIMIT
    row[layout["self.attitude"]][2::3] = state.up
    row[layout["self.thrust"]] = state.thrust
    row[layout["self.setpoint_offset"]] = state.setpoint - position[0]
    row[layout["self.type"]] = codes[0]
    distance = np.square(position[1:] - position[0]).sum(axis=1)
    for k, j in enumerate(1 + np.argsort(distance, kind="stable")[: note.num_neighbors]):
        told = (position[j] - position[0], (velocity[j] - velocity[0]) / SPEED_LIMIT)
        entries = dict(zip(("position", "velocity"), told, strict=True))
        entries |= {"goal": goal[j] - position[j], "type": codes[j], "mask": np.ones(1)}
        for name, values in entries.items():
            row[layout[f"neighbor_{k}.{name}"]] = values
    if note.features == REFERENCE:
        scales = (1.0, SPEED_LIMIT, ACCELERATION_LIMIT)
        wanted = np.asarray(state.task, np.float64).reshape(3, 3) - [
            position[0],
            np.zeros(3),
            np.zeros(3),
        ]
        for name, values, scale in zip(_MOTIONS, wanted, scales, strict=True):
            row[layout[f"task.reference_{name}"]] = values / scale
    else:
        row[layout["task.goal"]] = goal[0] - position[0]
        row[layout["task.time_left"]] = state.task
    return row.astype(np.float32)


_MOTIONS = ("position", "velocity", "acceleration")


def decide(policy: Policy, states: list[KnownState]) -> Float32Array:
    """(S, width) the policy's actions in so many states."""
    note = policy.note
    told = np.stack([observation_row(policy, state) for state in states])
    values = FEATURE_SETS[note.features].make(told, note.num_neighbors)
    actions: Float32Array = np.clip(act(policy.networks, values, note.sizes), -1.0, 1.0)
    return actions


def samples(policy: Policy, rng: np.random.Generator) -> dict[str, str]:
    """Words of the header's self-test: none to more others than are seen."""
    note = policy.note
    drones, kinds, numbers, states = 1 + note.num_neighbors + MORE, [], [], []
    for n in range(SAMPLES):
        others = n % drones
        state = draw_state(policy, others, rng)
        states.append(state)
        moving = np.concatenate([state.position, state.velocity, state.goal], axis=1)
        whole = np.zeros((drones, 9), np.float32)
        whole[: len(moving)] = moving
        own = [state.up, [state.thrust], state.setpoint, state.task]
        numbers.append(np.concatenate([whole.ravel(), *own]).astype(np.float32))
        kinds.append([others, *state.types, *[state.types[0]] * (drones - 1 - others)])
    own_lines = ["        own.time_left = *s++;"]
    if note.features == REFERENCE:
        line = "        for (k = 0; k < 3; k++) own.reference_{0}[k] = *s++;"
        own_lines = [line.format(name) for name in _MOTIONS]
    return {
        "drones": str(drones),
        "kinds": str(1 + drones),
        "numbers": str(len(numbers[0])),
        "test_kinds": rows(np.array(kinds, dtype=np.int64)),
        "test_states": rows(np.array(numbers)),
        "test_actions": rows(decide(policy, states)),
        "test_own": "\n".join(own_lines),
    }
