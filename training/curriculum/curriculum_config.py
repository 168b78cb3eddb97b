"""Options of a curriculum, and what its rounds fly: readable where torch is not installed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from swarm_envs.arguments import Count, Range, Seed, typed_options
from swarm_envs.training.collection.collect import CollectionConfig
from swarm_envs.training.collection.flight import CalibrationErrors
from swarm_envs.training.collection.log import Label, SensorNoise
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.vehicles import LARGE, parse_team

__all__ = ["CurriculumConfig"]

PAIRS = ("SS", "SL", "LL")  # Teams of two, of every mixture
THREES = ("SSS", "SSL", "SLL", "LLL")  # Teams of three, of every mixture

GAP_SPAN_M = 0.3  # Planes of a swap are from the least gap to this much further apart
WALK_REACH_M = 0.10  # Random walkers repel each other from this much above the round's clearance


@dataclass(frozen=True)
class Stage:
    """Who flies in a round."""

    title: str  # What is new in the stage
    teams: tuple[str, ...]  # Who flies
    compensated: bool  # Whether the pilot knows the model of the round before


STAGES = (
    Stage("one and two drones, not compensated", ("S", "L", *PAIRS), False),
    Stage("two drones, compensated", PAIRS, True),
    Stage("three drones, compensated", THREES, True),
    Stage("three drones, closer", THREES, True),
    Stage("two and three drones, closest", (*PAIRS, *THREES), True),
)
"""The rounds of Sec. IV-D: first two vehicles without, then with the learned model, then more."""


def adds_drones(stages: tuple[Stage, ...], number: int) -> bool:
    """Whether round `number`, counted from 1, flies more drones together than any before."""
    largest = [max(len(parse_team(team)) for team in stage.teams) for stage in stages[:number]]
    return number == 1 or largest[-1] > max(largest[:-1])


UNSEEN_TEAMS = (
    *("SS", "LS", "SL", "LL"),
    *("SSS", "LSS", "SSL", "LLS", "SLL", "LLL"),
    *("SSSSS", "LLSSS", "SSSLL", "SLSLS", "LLLLL"),
)
"""Teams of two, three and five drones, the first on top; no training flight has five."""


_QUICK: Mapping[str, Any] = {
    "flights": 2,
    "duration_s": 6.0,
    "steps": 300,
    "last_steps": 800,
    "episodes": 4,
}
"""What the small version is run with."""


@typed_options
@dataclass(frozen=True, kw_only=True)
class CurriculumConfig:
    """Learn the interaction force in rounds, each closer together with what the last one learned.

    Each round flies random walks and stacked swaps, computes the force from the noisy logs, and
    fits a heterogeneous deep set to all flights so far. How close the next round may plan follows
    from how far drones strayed in this one. Ends with `curriculum.json`, `curriculum.png`, a table,
    and the model `learned.safetensors`. Interrupted and run again, it resumes.
    """

    out: Path
    """folder for the rounds, the model, the report and the picture"""
    seed: Seed = 0
    """seed of every flight and fit"""
    interactions: str = "learned"
    """force model of the environment: `learned`, `wake`, or a path of weights"""
    first_clearance_m: float = 0.25
    """least vertical clearance of two spheres in swaps of the first round, and of the first with
    more drones: nothing is known then, m"""
    least_clearance_m: Annotated[float, Range(0.005, 0.2, unit="m")] = 0.015
    """no round plans a smaller clearance, m"""
    margin: Annotated[float, Range(1.0, 10.0)] = 1.5
    """a round plans at least this many times the error of the vertical gap that is to be expected
    from the round before"""
    flights: Annotated[int, Range(2)] = 4
    """flights of each team and motion in a round"""
    duration_s: Annotated[float, Range(3.0, 600.0, unit="s")] = 12.0
    """length of a flight, s"""
    steps: Count = 1200
    """optimiser steps of the fits between rounds"""
    last_steps: Count = 4000
    """optimiser steps of the last fit"""
    episodes: Count = 20
    """unseen swaps of each team on which the models are evaluated"""
    stages: tyro.conf.Suppress[tuple[Stage, ...]] = STAGES
    """teams of each round"""
    unseen_teams: tyro.conf.Suppress[tuple[str, ...]] = UNSEEN_TEAMS
    """whose swaps the models are evaluated on"""
    label: Label = "differentiated"
    """where the acceleration of the force's label comes from"""
    noise: SensorNoise = SensorNoise()
    """what sensors add to the logs"""
    errors: CalibrationErrors = CalibrationErrors()
    """by how much vehicles differ from their type; the fits then estimate offsets"""
    quick: bool = False
    """a small curriculum of about a minute that shows the way: flights 2, duration_s 6, steps 300,
    last_steps 800, episodes 4, none of which may then be another"""
    json: Path | None = None
    """write `curriculum.json` to this file too"""
    progress: bool = True
    """show progress bars"""

    def __post_init__(self) -> None:
        """Check what the annotations cannot say."""
        if self.interactions == "none":
            raise ValueError("interactions is 'none': there is no force to learn; name another")
        given = [
            n for n, v in _QUICK.items() if getattr(self, n) not in (v, vars(CurriculumConfig)[n])
        ]
        if self.quick and given:
            raise ValueError(
                f"quick sets {', '.join(given)} itself, so leave them out, or leave out quick"
            )
        if not self.least_clearance_m <= self.first_clearance_m <= 0.5:
            raise ValueError(
                f"first_clearance_m is {self.first_clearance_m}, but must be from "
                f"{self.least_clearance_m} to 0.5"
            )

    def sized(self) -> CurriculumConfig:
        """Return the configuration that is run: itself, or its small version if `quick`."""
        if not self.quick:
            return self
        return dataclasses.replace(self, quick=False, **_QUICK)

    def what_is_learned(self) -> dict[str, object]:
        """The options that decide on the result: all but where it goes and what is shown."""
        values = dataclasses.asdict(self.sized())
        return {k: v for k, v in values.items() if k not in ("out", "json", "progress", "quick")}


def collection_config(
    config: CurriculumConfig, number: int, clearance_m: float, feedforward: Path | None
) -> CollectionConfig:
    """What round `number`, counted from 1, flies.

    Swaps keep at least the clearance between the spheres of neighbouring planes, and so the lowest
    plane from the floor, since an uncompensated drone is pressed onto it; random walkers
    repel each other from a clearance 10 cm above it, with the same slopes at like shares of it. The
    pilot has the controller's usual gains: one who holds place in any wake needs no compensation.
    """
    usual, count = MotionRanges(), config.flights
    lowest, reach = 0.12 + clearance_m, WALK_REACH_M + clearance_m
    floor = LARGE.radius + clearance_m
    motion = dataclasses.replace(
        usual,
        clearance_m=clearance_m,
        gap_m=(lowest, lowest + GAP_SPAN_M),
        low_lowest_m=(max(usual.low_lowest_m[0], floor), max(usual.low_lowest_m[1], floor)),
        reach_m=reach,
        strength=usual.strength * (reach / usual.reach_m) ** 3,
    )
    return CollectionConfig(
        teams=config.stages[number - 1].teams,
        walks=count,
        low_walks=count,
        swaps=count,
        low_swaps=count,
        duration_s=config.duration_s,
        interactions=config.interactions,
        feedforward=feedforward,
        pilot="mid",
        label=config.label,
        motion=motion,
        noise=config.noise,
        errors=config.errors,
        seed=1000 * config.seed + number,
    )
