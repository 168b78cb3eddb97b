"""Safety filter of any agent: the smallest change of its accelerations that avoids collisions.

Each drone solves a quadratic program based on its own observations: the acceleration that is
nearest to the agent's command, subject to inequalities for neighbors, acceleration limits, walls
and observed obstacles (`swarm_envs.agents.barrier`). If no acceleration satisfies all of them, the
largest violation is minimized; the acceleration limits always hold.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from swarm_envs.agents.barrier import (
    LIMITS,
    WALLS,
    Barrier,
    BarrierWorkspace,
    filter_accelerations,
    new_workspace,
)
from swarm_envs.agents.evaluation import source_digest
from swarm_envs.agents.features import observation_columns
from swarm_envs.agents.protocol import (
    Actions,
    Agent,
    BatchAgent,
    Observations,
    check_requirements,
    check_task,
)
from swarm_envs.compiled import announce_compilation
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_bool, check_integer, check_number
from swarm_envs.state import FloatArray
from swarm_envs.tasks.base import ACCELERATION_LIMIT, Task
from swarm_envs.vehicles import VEHICLES

__all__ = ["ACTED"]

_ONE_PLACE_M = 0.3
ACTED = 1e-3
"""Smallest change of an acceleration that is counted, m/s^2."""


@dataclass(frozen=True, kw_only=True)
class Safety:
    """The parameters of a safety filter; an invalid one raises ValueError."""

    margin_m: float = 0.12
    """The clearance between drones and to obstacles, m; half of it to walls."""
    horizon_s: float = 0.7
    """The time over which the clearance must hold at constant velocities, s."""
    response_s: float = 0.08
    """The response time of a drone to commands, s. Positions and velocities are predicted over this
    time, the drone's own with its current acceleration."""
    rate: float = 8.0
    """The rate in dh/dt >= -rate h for a barrier h, 1/s, at most the decision rate. A smaller rate
    acts earlier and more gently."""
    share: float = 0.5
    """The share of an evasion that this drone contributes: 0.5 if the other has a filter too."""
    downwash: float = 1.3
    """The ratio of vertical to horizontal clearance, at least 1."""
    aside_m: float = 0.03
    """The shift of neighbors to the left in the prediction, m, so that two drones in head-on flight
    pass on the right instead of stopping."""
    walls: bool = True
    """Keep clear of walls, floor and ceiling too."""
    num_neighbors: int = 7
    """The number of observed neighbors, unless the agent observes more."""

    def __post_init__(self) -> None:
        """Raise ValueError if a parameter is invalid."""
        for name in ("margin_m", "response_s", "aside_m"):
            check_number(name, getattr(self, name), at_least=0.0)
        check_number("horizon_s", self.horizon_s, above=0.0, unit="s")
        check_number("rate", self.rate, above=0.0)
        check_number("share", self.share, above=0.0, at_most=1.0)
        check_number("downwash", self.downwash, at_least=1.0)
        check_bool("walls", self.walls)
        check_integer("num_neighbors", self.num_neighbors, at_least=1)
        if self.margin_m < self.aside_m:
            raise ValueError(
                f"margin_m is {self.margin_m}, but must be at least aside_m, {self.aside_m}, by "
                "which drones may pass closer than the margin; reduce aside_m too"
            )

    def barrier(self) -> Barrier:
        """Return the parameters for kernels."""
        return Barrier(
            margin=float(self.margin_m),
            horizon=float(self.horizon_s),
            response=float(self.response_s),
            rate=float(self.rate),
            share=float(self.share),
            stretch=float(self.downwash),
            aside=float(self.aside_m),
            walls=bool(self.walls),
        )


class SafetyFilter:
    """Agent that corrects another agent's actions to avoid collisions.

    By name: `swap-dagger+filter`. The filter of a `swarm_envs.agents.protocol.BatchAgent` has
    `act_batch` too.

    Args:
        agent: an agent with the action `acceleration` and flat observations.
        safety: the parameters of the filter; None for the defaults.

    Raises:
        TypeError: it is no agent.
        ValueError: the agent has another action or observation.
    """

    def __init__(self, agent: Agent, safety: Safety | None = None) -> None:
        if not hasattr(agent, "requires"):
            raise TypeError(
                f"agent is {agent!r:.80}, but must be an Agent with the attribute `requires`"
            )
        self.agent, self.safety = agent, safety or Safety()
        needed = {"action": "acceleration", "observation": "flat"}
        for name, wanted in needed.items():
            if agent.requires.get(name, wanted) != wanted:
                raise ValueError(
                    f"a safety filter needs {name}={wanted!r}, but the agent requires "
                    f"{agent.requires[name]!r}; use it without a filter"
                )
        observed = agent.requires.get("num_neighbors", 0)
        watched = {"num_neighbors": max(observed, self.safety.num_neighbors)}
        self.requires: Mapping[str, Any] = {**agent.requires, **needed, **watched}
        self.privileged = agent.privileged
        content = f"{source_digest(agent)} {self.safety}"
        self.digest = hashlib.sha256(content.encode()).hexdigest()
        if isinstance(agent, BatchAgent):
            self.act_batch = self._act_batch
        self._statistics = _Statistics()
        self._twin: SwarmParallelEnv | None = None

    def check(self, task: Task) -> None:
        """Raise ValueError if the agent does not support a task."""
        check_task(self.agent, task)

    @property
    def avoids_obstacles(self) -> bool:
        """True if the agent itself steers around obstacles that it observes."""
        return getattr(self.agent, "avoids_obstacles", False)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare for an episode.

        An agent that observes fewer neighbors than the filter is reset with a copy of the
        environment that has its number of neighbors, and receives rows with that number.

        Raises:
            ValueError: the environment lacks required options, more than the agent's
                `most_crossing` straight paths cross in one point, or the agent's reset raised it.
        """
        check_requirements(env, self)
        columns = observation_columns({field.name: field.where for field in env.observation_layout})
        watched = columns.num_neighbors
        observed = self.agent.requires.get("num_neighbors", watched)
        first, width = columns.neighbors, columns.neighbor_width
        self._dropped = slice(first + observed * width, first + watched * width)
        self._columns = columns
        self._barrier = self.safety.barrier()
        most = getattr(self.agent, "most_crossing", None)
        if most is not None:
            _check_crossing(env.view, most)
        self._arena = np.array(env.core.task.arena)
        rows = LIMITS + WALLS + columns.num_obstacles + watched
        self._scratch = BarrierWorkspace(
            np.zeros((rows, 3)), np.zeros(rows), np.zeros(3), np.zeros(3), new_workspace(rows)
        )
        self.agent.reset(env if observed == watched else self._twin_of(env, observed, seed), seed)

    def _twin_of(self, env: SwarmParallelEnv, observed: int, seed: int) -> SwarmParallelEnv:
        config = dataclasses.replace(env.core.config, num_neighbors=observed)
        old = self._twin
        if old is None or old.core.task != env.core.task or old.core.config != config:
            self._twin = old = SwarmParallelEnv(env.core.task, config)
        old.reset(seed=seed)
        return old

    def act(self, observations: Observations, view: View | None) -> Actions:
        """Return the agent's actions with the smallest correction that satisfies the filter."""
        rows = np.stack(list(observations.values()))
        given = dict(zip(observations, self._seen(rows), strict=True))
        desired = self.agent.act(given, view)
        actions = self._filter(rows, np.stack([desired[name] for name in observations]))
        return dict(zip(observations, actions, strict=True))

    def _act_batch(self, rows: Float32Array) -> Float32Array:
        """Return filtered actions (..., N, 3) for rows (..., N, row width) of many teams."""
        assert isinstance(self.agent, BatchAgent)
        return self._filter(rows, self.agent.act_batch(self._seen(rows)))

    def _seen(self, rows: Float32Array) -> Float32Array:
        """Return the rows with the number of neighbors that the agent observes."""
        return np.delete(rows, self._dropped, axis=-1)

    def _filter(self, rows: Float32Array, desired: Float32Array) -> Float32Array:
        """Return filtered actions (..., 3) for desired actions (..., 3)."""
        shape = (*rows.shape[:-1], 3)
        if desired.shape != shape or not np.isfinite(desired).all():
            raise ValueError(
                f"the agent's actions must be finite numbers {shape}, but are {desired!r:.200}"
            )
        flat = np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]), dtype=np.float32)
        wanted = np.ascontiguousarray(desired.reshape(-1, 3), dtype=np.float32)
        actions, broken = np.empty_like(wanted), np.empty(len(wanted))
        announce_compilation(filter_accelerations)
        filter_accelerations(
            flat,
            wanted,
            self._barrier,
            self._columns,
            _RATIOS,
            _RADII,
            self._arena,
            self._scratch,
            actions,
            broken,
        )
        self._statistics.take(wanted, actions, broken)
        return actions.reshape(shape)

    def statistics(self) -> dict[str, Any]:
        """Return statistics of the corrections since the filter was made.

        `decisions`: the number of decisions of single drones; `acted`: the fraction that was
        changed; `change_mps2`: the mean and largest of these changes; `unsafe`: the fraction in
        which no acceleration satisfied all inequalities; `worst_broken_mps2`: the largest
        violation.
        """
        return self._statistics.report()


def _check_crossing(view: View, most: int) -> None:
    """Raise ValueError if straight paths of more than `most` drones intersect in one point.

    All drones approach it together, and below some radius no acceleration satisfies all
    inequalities (0.74 m for 16 drones), even if every drone observes all others.
    """
    half = 0.5 * (view.state.position + view.goals)
    apart = np.linalg.norm(half[:, None] - half, axis=-1)
    crossing = int((apart < _ONE_PLACE_M).sum(axis=1).max())
    if crossing > most:
        raise ValueError(
            f"the straight paths of {crossing} drones intersect in one point, but a safety filter "
            f"of this agent supports at most {most}; use the agent 'roundabout'"
        )


class _Statistics:
    """Statistics of the corrections of a filter."""

    def __init__(self) -> None:
        self.decisions = self.acted = self.unsafe = 0
        self.change = self.largest = self.worst = 0.0

    def take(self, desired: Float32Array, given: Float32Array, broken: FloatArray) -> None:
        """Add decisions (R, 3) and violations (R,)."""
        change = ACCELERATION_LIMIT * np.sqrt(np.square(given - desired).sum(axis=-1))
        acted = change > ACTED
        self.decisions += len(change)
        self.acted += int(acted.sum())
        self.unsafe += int((broken > ACTED).sum())
        self.change += float(change[acted].sum())
        self.largest = max(self.largest, float(change.max(initial=0.0)))
        self.worst = max(self.worst, float(broken.max(initial=0.0)))

    def report(self) -> dict[str, Any]:
        """Return the statistics; see `SafetyFilter.statistics`."""
        count = max(self.decisions, 1)
        return {
            "decisions": self.decisions,
            "acted": self.acted / count,
            "change_mps2": {"mean": self.change / max(self.acted, 1), "largest": self.largest},
            "unsafe": self.unsafe / count,
            "worst_broken_mps2": self.worst,
        }


_RATIOS = np.array([vehicle.thrust_to_weight for vehicle in VEHICLES.values()])
_RADII = np.array([vehicle.radius for vehicle in VEHICLES.values()])
