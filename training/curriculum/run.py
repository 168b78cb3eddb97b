"""The curriculum: fly, measure how close drones came, fit to everything so far, plan the next.

Rounds follow each other; then the models are evaluated on unseen swaps. Every stage is written
whole, and what is done already is read.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.agents.policy import CHECKPOINT
from swarm_envs.arguments import typed
from swarm_envs.files import write_json, written_whole
from swarm_envs.interactions import load
from swarm_envs.state import FloatArray
from swarm_envs.training.belief.feedforward import simulated_fit_config
from swarm_envs.training.collection.collect import collect, was_cut_short
from swarm_envs.training.collection.table import CollectedFlight, interaction_rows
from swarm_envs.training.curriculum.curriculum_config import (
    CurriculumConfig,
    adds_drones,
    collection_config,
)
from swarm_envs.training.curriculum.curriculum_report import (
    CurriculumReport,
    Unseen,
    draw_curriculum,
    evaluate_unseen,
    goals_reached,
    sizes_as_json,
)
from swarm_envs.training.force_model import fit, load_network
from swarm_envs.training.force_model.evaluate import predict_rows
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.training.provenance import (
    begin_manifest,
    changed_options,
    file_sha256,
    json_ready,
)
from swarm_envs.vehicles import parse_team

MARK = "round.json"  # Written last: a round that has it is done
PASSING_M = 0.2  # Drones pass each other while they are so near laterally: within a wake's width
QUANTILE = 0.95  # Of the swaps, whose worst gap errors decide on the next round
LARGEST_STEP = 0.3
"""A round plans at least this share of the last one's clearance, so that models extrapolate little.
"""


@dataclass(frozen=True)
class Closeness:
    """How close drones came in the flights of a round, by their logs."""

    gap_error_m: float
    """By how much vertical gaps of passing drones differed from the planned ones: the largest of
    each swap, the 95 % quantile of the swaps. A wake widens them first, and as soon as the lower
    drone has left it, the controller's integral makes up for it and they are too small."""
    least_clearance_m: float
    """Smallest vertical clearance of two spheres that stood over each other in a swap."""
    least_distance_ratio: float
    """Smallest distance of two drones in any flight over the sum of their radii: 1 is a touch."""
    flights: int  # Flights that were looked at
    seconds: float  # Their length together, s
    cut_swaps: int  # Swaps that ended before their time, at a contact
    cut_walks: int  # Random walks that did


CurriculumRound = dict[str, Any]  # How a round went, as `round.json` and `curriculum.json` hold it


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


@typed
def next_clearance(
    clearance_m: float, closeness: Closeness, unknown: float, margin: float, least_m: float
) -> float:
    """The clearance that the next round may plan, m.

    Gaps go wrong by the force that the pilot does not know. So the gap error to expect is the one
    that was measured, times the share of the then unknown force that is still unknown. The next
    clearance is at least `margin` times that, at least 0.3 of this round's, at least `least_m`;
    and no smaller than this round's if a swap ended in a contact.

    Args:
        clearance_m: planned in the round that was flown, m.
        closeness: measured in it.
        unknown: RMS error of the new model over that of what the pilot knew, both against the
            labels of the round's held-out flights.
        margin: how many expected gap errors to keep.
        least_m: never less, m.
    """
    expected = closeness.gap_error_m * min(unknown, 1.0)
    wanted = max(margin * expected, LARGEST_STEP * clearance_m, least_m)
    if closeness.cut_swaps:
        wanted = max(wanted, clearance_m)
    return round(wanted, 4)


def _pairs(flight: CollectedFlight) -> list[tuple[FloatArray, FloatArray, float]]:
    """Of every two drones: where one is from the other (T, 3), planned gap (T,), radii together."""
    team, log = parse_team(flight.team), flight.log
    return [
        (
            log.position[:, j] - log.position[:, i],
            np.abs(log.setpoint[:, j, 2] - log.setpoint[:, i, 2]),
            team[i].radius + team[j].radius,
        )
        for i, j in combinations(range(len(team)), 2)
    ]


def _round_folder(config: CurriculumConfig, number: int) -> Path:
    return config.out / f"round_{number}"


def weights_of(config: CurriculumConfig, number: int) -> Path:
    """The model that a round fitted."""
    return _round_folder(config, number) / "fit" / "learned.safetensors"


def fly_round(
    config: CurriculumConfig, number: int, clearance_m: float, earlier: list[CollectedFlight]
) -> tuple[CurriculumRound, list[CollectedFlight]]:
    """Fly round `number` with a clearance, m, fit and report, or read it: report and flights."""
    began, stage = time.perf_counter(), config.stages[number - 1]
    folder = _round_folder(config, number)
    feedforward = weights_of(config, number - 1) if stage.compensated else None
    collection = collection_config(config, number, clearance_m, feedforward)
    flown = collect(collection, folder / "flights", config.progress)
    flights, mark = [*earlier, *flown], folder / MARK
    if mark.exists():
        return read_round(mark), flights
    fitted = _fit_all(config, number, flights)
    closeness = measure_closeness(flown, config.duration_s)
    held_out = interaction_rows([f for f in flown if f.validation], config.label)
    before = _unknown_g(held_out, feedforward)
    after = _unknown_g(held_out, weights_of(config, number))
    report: CurriculumRound = {
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
        "next_clearance_m": next_clearance(
            clearance_m, closeness, after / before, config.margin, config.least_clearance_m
        ),
        # Of all flights so far; validation is on those held out, against noisy labels, g^2.
        "rows": fitted["findings"]["rows"],
        "validation_mse": fitted["findings"]["errors"]["overall"],
        "zero_mse": fitted["findings"]["errors"]["zero"],
        "drag": fitted["drag"],
        "weights_sha256": file_sha256(weights_of(config, number)),
        "wall_time_s": round(time.perf_counter() - began, 1),
    }
    write_json(mark, json_ready(report))
    return report, flights


def _fit_all(
    config: CurriculumConfig, number: int, flights: list[CollectedFlight]
) -> dict[str, Any]:
    """Fit a model to all flights so far, or resume or read that fit: what its report says."""
    folder = _round_folder(config, number)
    table, out = folder / "rows.npz", folder / "fit"
    said = out / "learned.json"
    # The last that a fit does is to remove its checkpoint.
    if not (table.exists() and said.exists()) or (out / CHECKPOINT).exists():
        save_rows(table, interaction_rows(flights, config.label))
        steps = config.last_steps if number == len(config.stages) else config.steps
        differ, seed = any(vars(config.errors).values()), config.seed
        fit(simulated_fit_config(table, out, steps, seed, config.progress, differ))
    found: dict[str, Any] = json.loads(said.read_text())
    return found


def _unknown_g(rows: InteractionRows, weights: Path | None) -> float:
    """RMS of the vertical labels less what a model says, g; None stands for no model."""
    predicted = 0.0 if weights is None else predict_rows(load_network(weights), rows)
    return float(np.sqrt(np.mean((rows.force_g[:, 2] - predicted) ** 2)))


def read_round(path: Path) -> CurriculumRound:
    """Read what `fly_round` wrote; JSON holds null for what no flight showed, which was NaN."""
    found: CurriculumRound = json.loads(path.read_text())
    closeness: dict[str, Any] = found["closeness"]
    closeness |= {name: math.nan for name, value in closeness.items() if value is None}
    return found | {"closeness": Closeness(**closeness)}


ORIGIN = "origin.json"  # File with the options that a folder was begun with
UNSEEN = "unseen.json"  # File with the errors on teams that no round flew


@typed
def run_curriculum(config: CurriculumConfig) -> CurriculumReport:
    """Run what is not yet done and report on everything.

    Writes a folder for each round (`round_1` ...), `unseen.json`, `learned.safetensors` (the last
    round's model), `curriculum.json` and `curriculum.png` into `config.out`; each stage whole or
    not at all.

    Raises:
        ValueError: the folder holds a curriculum of other options or another force model.
    """
    began, config = time.perf_counter(), config.sized()
    truth = load(config.interactions)
    origin: dict[str, object] = {
        "config": json_ready(config.what_is_learned()),
        "interactions_sha256": truth.fingerprint,
    }
    begin_manifest(config.out / ORIGIN, origin)
    rounds = _fly_rounds(config)
    unseen: list[Unseen] = []
    if (config.out / UNSEEN).exists():
        unseen += json.loads((config.out / UNSEEN).read_text())
    else:
        models = [load(weights_of(config, k + 1)) for k in range(len(config.stages))]
        hidden = not config.progress
        for team in tqdm(config.unseen_teams, "unseen swaps", unit="team", disable=hidden):
            unseen.append(evaluate_unseen(models, truth, team, config.episodes))
        write_json(config.out / UNSEEN, json_ready(unseen))
    with written_whole(config.out / "learned.safetensors") as partial:
        shutil.copyfile(weights_of(config, len(config.stages)), partial)
    drag = {name: truth.field.drag[k].tolist() for k, name in enumerate(truth.types)}
    report = CurriculumReport(
        command=curriculum_command(config),
        config=origin["config"],
        interactions=truth.name,
        interactions_sha256=truth.fingerprint,
        rule=_rule(config),
        rounds=rounds,
        true_drag=drag,
        unseen=unseen,
        explained=sizes_as_json(unseen),
        reached=goals_reached(unseen),
        wall_time_s=round(time.perf_counter() - began, 1),
    )
    for path in (config.out / "curriculum.json", config.json):
        if path is not None:
            write_json(path, json_ready(report))
    draw_curriculum(report, config.out / "curriculum.png")
    return report


def _fly_rounds(config: CurriculumConfig) -> list[CurriculumRound]:
    flights: list[CollectedFlight] = []
    reports: list[CurriculumRound] = []
    clearance = config.first_clearance_m
    for number, stage in enumerate(config.stages, start=1):
        if adds_drones(config.stages, number):
            clearance = config.first_clearance_m
        tqdm.write(
            f"round {number} of {len(config.stages)}: {stage.title}, clearance at least "
            f"{100 * clearance:.1f} cm"
        )
        report, flights = fly_round(config, number, clearance, flights)
        reports.append(report)
        clearance = report["next_clearance_m"]
    return reports


def _rule(config: CurriculumConfig) -> str:
    first, least = (100 * v for v in (config.first_clearance_m, config.least_clearance_m))
    return (
        "the first round, and the first with more drones than flew before, plans a clearance of "
        f"{first:g} cm; each other one the largest of {config.margin:g} times the gap error to "
        f"expect, {LARGEST_STEP:g} times the last clearance, and {least:g} cm; and no smaller one "
        "than the last if a swap ended in a contact. The gap error to expect is the one measured "
        "in the last round (largest difference of a vertical gap from the planned one in each "
        f"swap, {100 * QUANTILE:g} % quantile of the swaps) times the RMS error of the new model "
        "over that of what the pilot knew, on the round's held-out flights"
    )


def curriculum_command(config: CurriculumConfig) -> str:
    """Command line that makes this curriculum, with the folder left out."""
    words = ["swarm-envs curriculum --out DIR", f"--seed {config.seed}"]
    aside = ("seed", "stages", "unseen_teams", "quick", "json", "progress")
    return " ".join(words + changed_options(config, aside=aside, flat=True))
