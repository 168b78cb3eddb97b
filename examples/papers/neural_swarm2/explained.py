"""The share of the variance of the true force that a model explains, in simulation.

`generalisation` evaluates it on swarms that are larger than those to which a model was fitted
(Neural-Swarm2, Fig. 5(g, h) and Sec. VII-C: trained with at most three drones, used with up to
sixteen).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from swarm_envs.errors import check_integer
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.vehicles import GRAM_FORCE, Vehicle, parse_team

__all__ = ["explained_variance", "generalisation"]

TEAMS = ("SS", "SL", "SSL", "SSSS", "SSLL", "SSSSS", "SSSLL", "S" * 16, "S" * 12 + "L" * 4)
"""Teams of two and three drones, and of the 4, 5 and 16 that no flight had."""

LATERAL_SPREAD_M = 0.12
"""Standard deviation of x and y between a drone and the one it was placed by: a wake's width."""
CLIMB_M = (0.2, 0.6)
"""Vertical distance to that drone, either way: that of drones that swap (Sec. VII-E)."""
LOWEST_M = (0.3, 0.8)  # Height of the lowest drone
SPEED = 0.25
"""Standard deviation of each component of the velocity, m/s: 99 % of the measured speeds are below
0.67 m/s."""
_TRIES = 10_000


def explained_variance(
    model: InteractionModel,
    truth: InteractionModel,
    position: FloatArray,
    velocity: FloatArray,
    team: str | Sequence[Vehicle],
) -> float:
    """Share of the variance of the true vertical force that a model explains.

    1 - mean((f - f_true)^2) / var(f_true) over every drone of every state, f being f_a,z. A
    constant error counts: no mean is taken off the residual. Positions and velocities (E, N, 3) are
    in m and m/s, world frame, of the same N vehicles in every state.

    Raises:
        ValueError: shapes do not fit, a type is unknown to a model, or the true force is the same
            everywhere.
    """
    true = truth.forces(position, velocity, team)[..., 2]
    error = model.forces(position, velocity, team)[..., 2] - true
    variance = float(true.var())
    if variance == 0.0:
        raise ValueError(
            f"the true force of {truth.name!r} is {true.flat[0]:g} N in all {true.size} states, "
            "but must vary; give states in which drones are near each other"
        )
    return 1.0 - float(np.mean(error**2)) / variance


def random_states(
    team: str | Sequence[Vehicle], states: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Swarms in close flight: positions (E, N, 3), m, and velocities, m/s, world frame.

    Each drone stands over or under one that was placed before it. Spheres of no two drones overlap:
    they keep the sum of their radii.

    Raises:
        RuntimeError: there was no room for a drone.
    """
    vehicles = parse_team(team)
    position = np.zeros((states, len(vehicles), 3))
    for swarm in position:
        order = rng.permutation(len(vehicles))
        for placed in range(1, len(vehicles)):
            swarm[order[placed]] = _free_place(vehicles, swarm, order, placed, rng)
        swarm[:, 2] += rng.uniform(*LOWEST_M) - swarm[:, 2].min()
    return position, rng.normal(0.0, SPEED, position.shape)


def _free_place(
    vehicles: Sequence[Vehicle],
    swarm: FloatArray,
    order: IntArray,
    placed: int,
    rng: np.random.Generator,
) -> FloatArray:
    there, own = order[:placed], vehicles[order[placed]]
    reach = np.array([vehicles[j].radius + own.radius for j in there])
    for _ in range(_TRIES):
        climb = rng.uniform(*CLIMB_M) * rng.choice([-1.0, 1.0])
        offset = np.array([*rng.normal(0.0, LATERAL_SPREAD_M, 2), climb])
        place: FloatArray = swarm[rng.choice(there)] + offset
        if (np.linalg.norm(swarm[there] - place, axis=1) > reach).all():
            return place
    raise RuntimeError(f"no room for drone {placed + 1} after {_TRIES} tries")


def generalisation(
    model: InteractionModel,
    truth: InteractionModel,
    teams: Sequence[str] = TEAMS,
    seed: int = 0,
    states: int = 500,
) -> list[dict[str, Any]]:
    """Explained variance of the true vertical force by team, over random states in close flight.

    `explained` is its share, at most 1; below 0 a constant would do better. With it are given the
    root mean squares of error and force, g, and the neighbours in a drone's volume. Each team has
    states of its own, drawn from the seed, whatever the other teams are.

    Raises:
        ValueError: a number or a team is out of range, or a type is unknown to a model.
    """
    check_integer("states", states, 1)
    check_integer("seed", seed, 0)
    return [_explained(model, truth, team, seed, states) for team in teams]


def _explained(
    model: InteractionModel, truth: InteractionModel, team: str, seed: int, states: int
) -> dict[str, Any]:
    rng = np.random.default_rng([seed, *team.encode()])
    position, velocity = random_states(team, states, rng)
    true, said = (m.forces(position, velocity, team)[..., 2] / GRAM_FORCE for m in (truth, model))
    apart = np.abs(position[:, :, None] - position[:, None])
    inside = (apart < INTERACTION_VOLUME).all(axis=-1)
    return {
        "team": team,
        "drones": position.shape[1],
        "states": states,
        "explained": explained_variance(model, truth, position, velocity, team),
        "rms_error_g": float(np.sqrt(np.mean((said - true) ** 2))),
        "rms_force_g": float(np.sqrt(np.mean(true**2))),
        "mean_neighbours": float(inside.sum(axis=-1).mean() - 1.0),
    }
