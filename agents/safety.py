"""A filter around any agent: the least change to its accelerations that keeps drones apart.

Each drone solves a program of its own, from what it observes itself: the nearest acceleration to
the one that its agent asks for, subject to one inequality a neighbour, the limits of acceleration,
the walls and the obstacles that are observed (`swarm_envs.agents.barrier`). Where no acceleration
satisfies all, the one is taken that breaks the worst of them the least; the limits of acceleration
are never broken.
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
"""A change of an acceleration counts from this size on, m/s^2."""


@dataclass(frozen=True, kw_only=True)
class Safety:
    """How much safety a filter keeps. Raises ValueError for what cannot be."""

    margin_m: float = 0.12
    """Distance to keep beyond the sum of radii, m; and from obstacles; from walls half of it."""
    horizon_s: float = 0.7
    """How far ahead that distance is kept, if both fly straight on, s."""
    response_s: float = 0.08
    """Time until a drone follows its command, s: positions and velocities are predicted as
    far, one's own with the acceleration that its thrust gives it."""
    rate: float = 8.0
    """Share of what is left of safety that may be used up a second, 1/s; at most the rate of
    decisions. Less acts earlier, and more gently."""
    share: float = 0.5
    """Of each evasion, the share that this drone makes: a half if the other has a filter too."""
    downwash: float = 1.3
    """By how much farther drones keep below and above each other than side by side; 1 for equal."""
    aside_m: float = 0.03
    """How far to the left a neighbour is taken to be, so that both of a pair pass on the right, m:
    two that meet head on would otherwise stop each other."""
    walls: bool = True
    """Whether walls, floor and ceiling are kept away from too."""
    num_neighbors: int = 7
    """How many neighbours are watched, if the agent does not itself observe more."""

    def __post_init__(self) -> None:
        """Refuse to let neighbours be passed nearer than the sum of radii."""
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
                f"margin_m is {self.margin_m}, but must be at least aside_m, {self.aside_m}: so "
                "much nearer than that margin a neighbour may be passed; give a smaller aside_m too"
            )

    def barrier(self) -> Barrier:
        """Return the same as kernels take it."""
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
    """Flies as an agent does, but keeps its drones apart. By name: `swap-dagger+filter`.

    An agent that acts on arrays (`swarm_envs.agents.protocol.BatchAgent`) still does so: then the
    filter has `act_batch` too.

    Args:
        agent: whose action is `acceleration`, and who observes rows.
        safety: how much of it.

    Raises:
        TypeError: it is no agent.
        ValueError: the agent acts otherwise.
    """

    def __init__(self, agent: Agent, safety: Safety | None = None) -> None:
        if not hasattr(agent, "requires"):
            raise TypeError(
                f"agent is {agent!r:.80}, but must be an Agent, which says what it requires"
            )
        self.agent, self.safety = agent, safety or Safety()
        needed = {"action": "acceleration", "observation": "flat"}
        for name, wanted in needed.items():
            if agent.requires.get(name, wanted) != wanted:
                raise ValueError(
                    f"a safety filter needs {name}={wanted!r}, but {type(agent).__name__} requires "
                    f"{agent.requires[name]!r}; fly it without a filter"
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
        """Refuse a task that the agent refuses."""
        check_task(self.agent, task)

    @property
    def avoids_obstacles(self) -> bool:
        """True if it flies around obstacles that it observes, and is not only kept from them."""
        return getattr(self.agent, "avoids_obstacles", False)

    def reset(self, env: SwarmParallelEnv, seed: int) -> None:
        """Prepare for an episode.

        Where the agent observes fewer neighbours than are watched, it is prepared with a twin of
        the environment, and given rows, in which there are as many as it requires.

        Raises:
            ValueError: the environment lacks what is required; the agent flies straight, and more
                than its `most_crossing` ways cross in one place; or as the agent's reset.
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
        """What the agent asks for, changed as little as safety allows."""
        rows = np.stack(list(observations.values()))
        given = dict(zip(observations, self._seen(rows), strict=True))
        asked = self.agent.act(given, view)
        actions = self._filter(rows, np.stack([asked[name] for name in observations]))
        return dict(zip(observations, actions, strict=True))

    def _act_batch(self, rows: Float32Array) -> Float32Array:
        """The same for rows (..., N, row width) of many teams."""
        assert isinstance(self.agent, BatchAgent)
        return self._filter(rows, self.agent.act_batch(self._seen(rows)))

    def _seen(self, rows: Float32Array) -> Float32Array:
        """The rows as the agent observes them."""
        return np.delete(rows, self._dropped, axis=-1)

    def _filter(self, rows: Float32Array, asked: Float32Array) -> Float32Array:
        """Safe actions near those asked for, both (..., 3)."""
        shape = (*rows.shape[:-1], 3)
        if asked.shape != shape or not np.isfinite(asked).all():
            raise ValueError(
                f"the agent's actions must be finite numbers {shape}, but are {asked!r:.200}"
            )
        flat = np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]), dtype=np.float32)
        wanted = np.ascontiguousarray(asked.reshape(-1, 3), dtype=np.float32)
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
        """How often and how much the filter has acted since it was made.

        `decisions` of single drones; `acted`, the share that was changed; `change_mps2`, mean and
        largest change of these; `unsafe`, the share in which no acceleration satisfied every
        inequality, and `worst_broken_mps2`, by how much at most.
        """
        return self._statistics.report()


def _check_crossing(view: View, most: int) -> None:
    """Refuse straight ways of too many drones through one place.

    All of them contract together, each pressed on by those behind it, and from some radius on no
    acceleration satisfies every inequality (0.74 m for 16 drones); to watch all others does not
    help.
    """
    half = 0.5 * (view.state.position + view.goals)
    apart = np.linalg.norm(half[:, None] - half, axis=-1)
    crossing = int((apart < _ONE_PLACE_M).sum(axis=1).max())
    if crossing > most:
        raise ValueError(
            f"{crossing} drones that fly straight would meet in one place, but of this agent a "
            f"safety filter keeps at most {most} apart there; the agent 'roundabout' flies this"
        )


class _Statistics:
    """What a filter has done."""

    def __init__(self) -> None:
        self.decisions = self.acted = self.unsafe = 0
        self.change = self.largest = self.worst = 0.0

    def take(self, asked: Float32Array, given: Float32Array, broken: FloatArray) -> None:
        """Count some decisions."""
        change = ACCELERATION_LIMIT * np.sqrt(np.square(given - asked).sum(axis=-1))
        acted = change > ACTED
        self.decisions += len(change)
        self.acted += int(acted.sum())
        self.unsafe += int((broken > ACTED).sum())
        self.change += float(change[acted].sum())
        self.largest = max(self.largest, float(change.max(initial=0.0)))
        self.worst = max(self.worst, float(broken.max(initial=0.0)))

    def report(self) -> dict[str, Any]:
        """As `SafetyFilter.statistics`."""
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
