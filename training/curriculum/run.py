"""The whole curriculum: rounds, evaluation on unseen swaps, report, table and picture."""

from __future__ import annotations

import json
import shutil
import time
from pathlib import Path

from tqdm import tqdm

from swarm_envs.arguments import typed
from swarm_envs.files import write_json, written_whole
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.training.collection.collect import begin_manifest
from swarm_envs.training.collection.table import CollectedFlight
from swarm_envs.training.curriculum.curriculum_config import CurriculumConfig, adds_drones
from swarm_envs.training.curriculum.curriculum_report import (
    CurriculumReport,
    Unseen,
    draw_curriculum,
    evaluate_unseen,
    goals_reached,
    sizes_as_json,
)
from swarm_envs.training.curriculum.rounds import (
    LARGEST_STEP,
    QUANTILE,
    CurriculumRound,
    fly_round,
    weights_of,
)
from swarm_envs.training.provenance import json_ready

ORIGIN = "origin.json"
"""File with the options that a folder was begun with."""
UNSEEN = "unseen.json"
"""File with the errors on teams that no round flew."""


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
    unseen = _evaluate_all(config, truth)
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
        clearance = report.next_clearance_m
    return reports


def _evaluate_all(config: CurriculumConfig, truth: InteractionModel) -> list[Unseen]:
    path = config.out / UNSEEN
    if path.exists():
        return [Unseen(**entry) for entry in json.loads(path.read_text())]
    models = [load(weights_of(config, k + 1)) for k in range(len(config.stages))]
    bar = tqdm(config.unseen_teams, disable=not config.progress, desc="unseen swaps", unit="team")
    found = [evaluate_unseen(models, truth, team, config.episodes) for team in bar]
    write_json(path, json_ready(found))
    return found


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
    usual = CurriculumConfig(out=Path())
    for name in config.what_is_learned():
        value = getattr(config, name)
        if name in ("stages", "unseen_teams"):  # no options of the command
            continue
        if name in ("noise", "errors"):
            given = {k: v for k, v in vars(value).items() if v != getattr(getattr(usual, name), k)}
            words += [f"--{k.replace('_', '-')} {v}" for k, v in given.items()]
        elif value != getattr(usual, name) and name != "seed":
            words.append(f"--{name.replace('_', '-')} {value}")
    return " ".join(words)
