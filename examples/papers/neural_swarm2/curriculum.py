"""The curriculum of Sec. IV-D: fit a model, fly closer with its compensation, fit again.

Drones without compensation cannot fly close to each other, since downwash drives them apart. In the
first round one and two drones fly far apart, and a model is fitted; with it as feed-forward they
fly closer in the next round; then three drones.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from examples.papers.common import markdown, write_json
from examples.papers.neural_swarm2.curriculum_plots import plot_curriculum
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.belief import SwapTrial, fly_swaps, simulated_fit_config
from swarm_envs.training.collection.collect import CollectionConfig, collect, was_cut_short
from swarm_envs.training.collection.motion import MotionRanges
from swarm_envs.training.collection.table import CollectedFlight, interaction_rows
from swarm_envs.training.force_model import fit
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.training.provenance import file_sha256, json_ready
from swarm_envs.vehicles import GRAM_FORCE, LARGE, parse_team

PAIRS = ("SS", "SL", "LL")  # teams of two, of every mixture
THREES = ("SSS", "SSL", "SLL", "LLL")  # teams of three, of every mixture
FIRST_CLEARANCE_M = 0.25
"""Least vertical clearance of two spheres in swaps of the first round, and of the first with more
drones: nothing is known then."""
LEAST_CLEARANCE_M = 0.015  # no round plans a smaller clearance
MARGIN = 1.5  # a round plans at least this many times the expected error of the vertical gap
LARGEST_STEP = 0.3
"""A round plans at least this share of the last one's clearance, so that models extrapolate
little."""
GAP_SPAN_M = 0.3  # planes of a swap are from the least gap to this much further apart
WALK_REACH_M = 0.10  # random walkers repel each other from this much above the round's clearance
PASSING_M = 0.2  # drones pass each other while they are so near laterally: within a wake's width
QUANTILE = 0.95  # of the swaps, whose worst gap errors decide on the next round
GOALS = {2: 0.85, 3: 0.85, 5: 0.70}
"""Share of the variance of f_a,z that a model is to explain, by number of drones."""
FIRST_SEED = 50_000  # of the unseen swaps


@dataclass(frozen=True)
class Stage:
    """Teams of a round."""

    title: str  # what is new in the stage
    teams: tuple[str, ...]
    compensated: bool  # the pilot knows the model of the round before


STAGES = (
    Stage("one and two drones, not compensated", ("S", "L", *PAIRS), False),
    Stage("two drones, compensated", PAIRS, True),
    Stage("three drones, compensated", THREES, True),
    Stage("three drones, closer", THREES, True),
    Stage("two and three drones, closest", (*PAIRS, *THREES), True),
)
"""The rounds of Sec. IV-D: first two vehicles without, then with the learned model, then more."""
UNSEEN_TEAMS = (
    *("SS", "LS", "SL", "LL"),
    *("SSS", "LSS", "SSL", "LLS", "SLL", "LLL"),
    *("SSSSS", "LLSSS", "SSSLL", "SLSLS", "LLLLL"),
)
"""Teams of two, three and five drones, the first on top; no training flight has five."""


@dataclass(frozen=True, kw_only=True)
class CurriculumOptions:
    """Options of a curriculum."""

    out: Path = Path("neural_swarm2/curriculum")
    """folder for the rounds, the model, the numbers and the picture"""
    interactions: str = "learned"
    """force model of the environment: `learned`, `wake`, or a path of weights"""
    flights: int = 4
    """flights of each team and motion in a round"""
    duration_s: float = 12.0
    """length of a flight, s"""
    steps: int = 1200
    """optimizer steps of the fits between rounds"""
    last_steps: int = 4000
    """optimizer steps of the last fit"""
    episodes: int = 20
    """unseen swaps of each team on which the models are evaluated"""
    stages: tyro.conf.Suppress[tuple[Stage, ...]] = STAGES
    """teams of each round"""
    unseen_teams: tyro.conf.Suppress[tuple[str, ...]] = UNSEEN_TEAMS
    """teams on whose swaps the models are evaluated"""
    seed: int = 0
    """of every flight and fit"""

    def weights(self, number: int) -> Path:
        """Return the path of the model that a round, counted from 1, fits."""
        return self.out / f"round_{number}" / "fit" / "deep-set.safetensors"


@dataclass(frozen=True)
class Closeness:
    """The least distances of drones in the flights of a round, by their logs."""

    gap_error_m: float
    """By how much vertical gaps of passing drones differed from the planned ones: the largest of
    each swap, the 95 % quantile of the swaps. A wake widens them first, and as soon as the lower
    drone has left it, the controller's integral makes up for it and they are too small."""
    least_clearance_m: float
    """Smallest vertical clearance of two spheres that were above each other in a swap; NaN if none
    were."""
    least_distance_ratio: float
    """Smallest distance of two drones in any flight over the sum of their radii: 1 is a touch."""
    flights: int
    seconds: float  # their length together, s
    cut_swaps: int  # swaps that ended before their time, at a contact
    cut_walks: int  # random walks that did


def curriculum(options: CurriculumOptions) -> None:
    """Learn the interaction force in rounds, each closer together than the last (Sec. IV-D).

    Takes about four minutes. Each round flies random walks and stacked swaps, computes the force
    from the noisy logs, and fits a heterogeneous deep set to all flights so far. How close the next
    round may plan follows from how far drones strayed in this one. Writes `curriculum.json`
    (`rounds`; `unseen`: how much of the true force each round's model explains; `explained`, the
    same by number of drones), `curriculum.png`, and the model `deep-set.safetensors`.

    Args:
        options: what is flown and fitted.
    """
    truth, stages = load(options.interactions), options.stages
    rounds: list[dict[str, Any]] = []
    flights: list[CollectedFlight] = []
    clearance = FIRST_CLEARANCE_M
    for number, stage in enumerate(stages, start=1):
        if adds_drones(stages, number):
            clearance = FIRST_CLEARANCE_M
        tqdm.write(f"round {number} of {len(stages)}: {stage.title}, {100 * clearance:.1f} cm")
        rounds.append(fly_round(options, number, clearance, flights))
        clearance = rounds[-1]["next_clearance_m"]
    models = [load(options.weights(number)) for number in range(1, len(stages) + 1)]
    unseen = [
        evaluate_unseen(models, truth, team, options.episodes)
        for team in tqdm(options.unseen_teams, "unseen swaps", unit="team")
    ]
    shutil.copyfile(options.weights(len(stages)), options.out / "deep-set.safetensors")
    report = {
        "interactions": truth.name,
        "interactions_sha256": truth.fingerprint,
        "seed": options.seed,
        "rounds": rounds,
        "true_drag": {n: truth.field.drag[k].tolist() for k, n in enumerate(truth.types)},
        "unseen": unseen,
        "explained": explained_by_size(unseen),
        "reached": goals_reached(unseen),
    }
    write_json(options.out / "curriculum.json", json_ready(report))
    plot_curriculum(options.out / "curriculum.png", report, GOALS)
    rows = [flat_round(r, unseen) for r in rounds]
    print(markdown(rows, list(rows[0])))


# ---- A round


def adds_drones(stages: tuple[Stage, ...], number: int) -> bool:
    """Return whether round `number`, counted from 1, flies more drones together than before."""
    largest = [max(len(parse_team(team)) for team in stage.teams) for stage in stages[:number]]
    return number == 1 or largest[-1] > max(largest[:-1])


def fly_round(
    options: CurriculumOptions, number: int, clearance_m: float, flights: list[CollectedFlight]
) -> dict[str, Any]:
    """Fly round `number` with a clearance, m, and fit; its flights are added to those so far."""
    stage, folder = options.stages[number - 1], options.out / f"round_{number}"
    known = options.weights(number - 1) if stage.compensated else None
    flown = collect(collection_config(options, number, clearance_m, known), folder / "flights")
    flights += flown
    fitted = fit_all(options, number, flights)
    closeness = measure_closeness(flown, options.duration_s)
    held_out = interaction_rows([flight for flight in flown if flight.validation])
    before, after = (unknown_g(held_out, path) for path in (known, options.weights(number)))
    return {
        "number": number,
        "title": stage.title,
        "teams": stage.teams,
        "compensated": stage.compensated,
        "clearance_m": clearance_m,
        "closeness": closeness,
        # RMS of the force on the round's held-out flights that its pilot did not know, noise of the
        # labels included; and the same for the model that was fitted then.
        "unknown_before_g": round(before, 4),
        "unknown_after_g": round(after, 4),
        "next_clearance_m": next_clearance(clearance_m, closeness, after / before),
        # Of all flights so far; validation is on those held out, against noisy labels, g^2.
        "rows": fitted.findings.rows,
        "validation_mse": fitted.findings.errors.overall,
        "zero_mse": fitted.findings.errors.zero,
        "drag": fitted.drag,
        "weights_sha256": file_sha256(options.weights(number)),
    }


def collection_config(
    options: CurriculumOptions, number: int, clearance_m: float, feedforward: Path | None
) -> CollectionConfig:
    """Return the flights of round `number`, counted from 1.

    Swaps keep at least the clearance between the spheres of neighboring planes, and so the lowest
    plane from the floor, since an uncompensated drone is pressed onto it; random walkers repel each
    other from a clearance 10 cm above it, with the same slopes at like shares of it. The pilot has
    the controller's usual gains: one who holds place in any wake needs no compensation.
    """
    usual, count = MotionRanges(), options.flights
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
        teams=options.stages[number - 1].teams,
        walks=count,
        low_walks=count,
        swaps=count,
        low_swaps=count,
        duration_s=options.duration_s,
        interactions=options.interactions,
        feedforward=feedforward,
        pilot="mid",
        motion=motion,
        seed=1000 * options.seed + number,
    )


def fit_all(options: CurriculumOptions, number: int, flights: list[CollectedFlight]) -> Any:
    """Fit a model to all flights so far; return the report of the fit."""
    table = options.out / f"round_{number}" / "rows.npz"
    save_rows(table, interaction_rows(flights))
    steps = options.last_steps if number == len(options.stages) else options.steps
    folder = options.weights(number).parent
    return fit(simulated_fit_config(table, folder, steps, options.seed, progress=True))


def unknown_g(rows: InteractionRows, weights: Path | None) -> float:
    """Return the RMS of the vertical labels less a model's prediction, g; None for no model."""
    predicted = 0.0 if weights is None else modelled_force_g(rows, str(weights))[:, 2]
    return float(np.sqrt(np.mean((rows.force_g[:, 2] - predicted) ** 2)))


def next_clearance(clearance_m: float, closeness: Closeness, unknown: float) -> float:
    """Return the clearance that the next round may plan, m.

    Gaps go wrong by the force that the pilot does not know. So the gap error to expect is the
    measured one times the share of the then unknown force that is still unknown. The next clearance
    is at least `MARGIN` times that, at least `LARGEST_STEP` of this round's, at least
    `LEAST_CLEARANCE_M`; and no smaller than this round's if a swap ended in a contact.

    Args:
        clearance_m: planned in the round that was flown, m.
        closeness: measured in it.
        unknown: RMS error of the new model over that of what the pilot knew, both against the
            labels of the round's held-out flights.
    """
    expected = closeness.gap_error_m * min(unknown, 1.0)
    wanted = max(MARGIN * expected, LARGEST_STEP * clearance_m, LEAST_CLEARANCE_M)
    if closeness.cut_swaps:
        wanted = max(wanted, clearance_m)
    return round(wanted, 4)


def measure_closeness(flights: Sequence[CollectedFlight], duration_s: float) -> Closeness:
    """Measure closeness in flights of teams, from positions and set-points as logged."""
    errors, clearances, ratios = [], [], []
    for flight in flights:
        worst = 0.0
        for apart, planned, radii in _pairs(flight):
            lateral, gap = np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])
            if len(apart):
                ratios.append(float(np.linalg.norm(apart, axis=1).min() / radii))
            if "swap" not in flight.name:
                continue
            passing, over = lateral < PASSING_M, lateral < radii
            if passing.any():
                worst = max(worst, float(np.abs(planned - gap)[passing].max()))
            if over.any():
                clearances.append(float((gap[over] - radii).min()))
        if "swap" in flight.name:
            errors.append(worst)
    cut = [flight.name for flight in flights if was_cut_short(flight, duration_s)]
    cut_swaps = sum("swap" in name for name in cut)
    return Closeness(
        gap_error_m=round(float(np.quantile(errors, QUANTILE)), 4) if errors else 0.0,
        least_clearance_m=round(min(clearances), 4) if clearances else float("nan"),
        least_distance_ratio=round(min(ratios), 3) if ratios else float("nan"),
        flights=len(flights),
        seconds=round(sum(flight.seconds for flight in flights), 1),
        cut_swaps=cut_swaps,
        cut_walks=len(cut) - cut_swaps,
    )


def _pairs(flight: CollectedFlight) -> list[tuple[FloatArray, FloatArray, float]]:
    """Return the offset (T, 3), planned gap (T,) and sum of radii, m, of every two drones."""
    team, log = parse_team(flight.team), flight.log
    return [
        (
            log.position[:, j] - log.position[:, i],
            np.abs(log.setpoint[:, j, 2] - log.setpoint[:, i, 2]),
            team[i].radius + team[j].radius,
        )
        for i, j in combinations(range(len(team)), 2)
    ]


# ---- Evaluation: the only place that reads the true force


def evaluate_unseen(
    models: Sequence[InteractionModel], truth: InteractionModel, team: str, episodes: int
) -> dict[str, Any]:
    """Compare the models of the rounds with the truth on swaps, flown with the last of them."""
    controller = ControllerConfig(feedforward=models[-1])
    flights = fly_swaps(SwapTrial(team, StackedLayout(), episodes), controller, truth, FIRST_SEED)
    flying = np.arange(1, len(flights.time)) < flights.samples[:, None] - 1
    position, velocity = flights.position[:, 1:][flying], flights.velocity[:, 1:][flying]
    true = truth.forces(position, velocity, team) / GRAM_FORCE
    found = [model.forces(position, velocity, team) / GRAM_FORCE for model in models]
    return {
        "team": team,
        "drones": len(parse_team(team)),
        "episodes": episodes,
        "crashed": int(flights.crashed.sum()),
        "rms_force_g": round(float(np.sqrt(np.mean(true[..., 2] ** 2))), 3),
        "rms_error_g": round(float(np.sqrt(np.mean((found[-1] - true)[..., 2] ** 2))), 3),
        # By round; the models have linear drag alone in the horizontal.
        "explained": [round(explained_share(force[..., 2:], true[..., 2:]), 4) for force in found],
        "explained_horizontal": [
            round(explained_share(force[..., :2], true[..., :2]), 4) for force in found
        ],
    }


def explained_share(found: FloatArray, true: FloatArray) -> float:
    """Return the share of the variance of the true force (T, N, components) that a model explains.

    A constant error counts, since no mean is taken off the residual.
    """
    variance = float(true.var(axis=(0, 1)).sum())
    error = float(np.mean((found - true) ** 2, axis=(0, 1)).sum())
    return 1.0 - error / variance if variance > 0.0 else 0.0


def explained_by_size(unseen: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Return mean and least share of the last model over the teams of each number of drones."""
    shares = {n: [u["explained"][-1] for u in unseen if u["drones"] == n] for n in GOALS}
    return {
        str(n): {"mean": round(float(np.mean(own)), 4), "least": min(own), "goal": GOALS[n]}
        for n, own in shares.items()
        if own
    }


def goals_reached(unseen: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether every team of each number of drones reaches the goal."""
    return all(share["least"] >= share["goal"] for share in explained_by_size(unseen).values())


def flat_round(r: Mapping[str, Any], unseen: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the main numbers of a round, and the share of f_a,z that its model explains."""
    close, k = r["closeness"], r["number"] - 1
    shares = {n: [u["explained"][k] for u in unseen if u["drones"] == n] for n in GOALS}
    return {
        "round": f"{r['number']}: {r['title']}",
        "clearance, cm": 100 * r["clearance_m"],
        "flown, cm": 100 * close.least_clearance_m,
        "gap error, cm": 100 * close.gap_error_m,
        "with a contact": f"{close.cut_swaps + close.cut_walks} of {close.flights}",
        "validation MSE, g²": r["validation_mse"],
        "zero model": r["zero_mse"],
    } | {f"{n} drones, %": 100 * float(np.mean(own)) for n, own in shares.items() if own}
