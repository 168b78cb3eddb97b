"""A case flown by both controllers, and its file: what was flown once is read, not repeated."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import Flights, fly
from swarm_envs.control.config import ControllerConfig
from swarm_envs.files import written_whole
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray
from swarm_envs.tasks.base import Success
from swarm_envs.training.provenance import differing
from swarm_envs.training.reproduce.flight_cases import Case, settings_of
from swarm_envs.vehicles import GRAM_FORCE

SIDES = ("without", "compensated")
"""The two controllers, in the order of the arrays."""


@dataclass(frozen=True)
class Flown:
    """E episodes of a case, of N drones, by both controllers; sides are in the order of `SIDES`."""

    worst_cm: FloatArray
    """(2, E, N) worst height error of each drone since errors count."""
    crashed: BoolArray
    """(2, E) ended in a collision or a tumble: the errors are not the worst there."""
    separation_m: FloatArray
    """(2, E) smallest distance of two drones."""
    force_rms_g: FloatArray
    """(N,) of the vertical force that blew on the compensated drones since errors count."""
    error_rms_g: FloatArray
    """(N,) of what they believed less that."""
    explained: FloatArray
    """() share of that force's variance, over all drones, which was believed."""
    neighbours: FloatArray
    """(2,) others in a drone's interaction volume: mean and most."""
    shown: FloatArray
    """() index of the episode that pictures show: the middle one without compensation."""
    time: FloatArray
    """(T,) s, of that episode."""
    height_error_cm: FloatArray
    """(2, T, N) height over the reference."""
    force_g: FloatArray
    """(2, T, N) vertical force that blew."""
    believed_g: FloatArray
    """(T, N) what the compensated side predicted."""
    reference: FloatArray
    """(T, N, 3) m."""

    def judged_cm(self, judged: int | None) -> FloatArray:
        """(2, E) error that counts: of one drone, or of the worst of each flight if None."""
        if judged is None:
            return np.asarray(self.worst_cm.max(axis=-1))
        return self.worst_cm[..., judged]


def fly_case(
    case: Case,
    belief: InteractionModel,
    seeds: Sequence[int],
    tick: Callable[[int], object] = lambda decisions: None,
) -> Flown:
    """Fly every episode of a case without and with a belief: same seeds, gains, references.

    Args:
        case: what to fly.
        belief: the force that the second controller compensates.
        seeds: one for each episode.
        tick: as for `fly`.
    """
    without = fly(case.test, ControllerConfig(), seeds, tick)
    compensated = fly(case.test, ControllerConfig(feedforward=belief), seeds, tick)
    sides = (without, compensated)
    worst = 100.0 * np.stack([side.worst_height_error for side in sides])
    judged = worst[0].max(axis=-1) if case.judged is None else worst[0, :, case.judged]
    shown = int(np.argsort(judged, kind="stable")[(len(judged) - 1) // 2])
    separation = [[m["minimum_separation_m"] for m in side.metrics] for side in sides]
    return Flown(
        worst_cm=worst,
        crashed=np.stack([side.crashed for side in sides]),
        separation_m=np.array(separation, dtype=np.float64),
        shown=np.array(shown),
        time=without.time,
        height_error_cm=np.stack([_height_error_cm(side)[shown] for side in sides]),
        force_g=np.stack([side.force[shown, ..., 2] / GRAM_FORCE for side in sides]),
        believed_g=compensated.believed[shown, ..., 2] / GRAM_FORCE,
        reference=without.reference[shown],
        **_prediction(case, compensated),
    )


def _height_error_cm(flights: Flights) -> FloatArray:
    return np.asarray(100.0 * (flights.position - flights.reference)[..., 2])


def _prediction(case: Case, flights: Flights) -> dict[str, FloatArray]:
    """How well the belief of compensated flights follows the force, and how many were near."""
    success = case.test.task.success
    begins = 0.0 if isinstance(success, Success) else success.settle_s
    flying = np.arange(len(flights.time)) < flights.samples[:, None]
    flying &= (flights.time > 0.0) & (flights.time >= begins)
    force = flights.force[flying][..., 2] / GRAM_FORCE
    error = flights.believed[flying][..., 2] / GRAM_FORCE - force
    position = flights.position[flying]
    apart = np.abs(position[:, :, None] - position[:, None])
    near = (apart < INTERACTION_VOLUME).all(axis=-1).sum(axis=-1) - 1
    variance = float(force.var())
    return {
        "force_rms_g": np.sqrt(np.mean(force**2, axis=0)),
        "error_rms_g": np.sqrt(np.mean(error**2, axis=0)),
        "explained": np.array(1.0 - np.mean(error**2) / variance if variance else 0.0),
        "neighbours": np.array([near.mean(), near.max()], dtype=np.float64),
    }


def fly_or_read(
    path: Path,
    case: Case,
    belief: InteractionModel,
    seeds: Sequence[int],
    tick: Callable[[int], object] = lambda decisions: None,
) -> Flown:
    """Fly a case and write its file, or read the file if it is there.

    Raises:
        ValueError: the file is of other settings, or damaged.
    """
    settings = settings_of(case) | {
        "seeds": list(seeds),
        "truth_sha256": load(case.test.truth).fingerprint,
        "belief_sha256": belief.fingerprint,
    }
    if path.exists():
        flown = _read(path, settings)
        tick(len(SIDES) * len(seeds) * case.test.decisions)
        return flown
    flown = fly_case(case, belief, seeds, tick)
    with written_whole(path) as partial:
        np.savez_compressed(partial, settings=np.array(json.dumps(settings)), **vars(flown))
    return flown


def _read(path: Path, settings: dict[str, Any]) -> Flown:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            there = json.loads(str(arrays["settings"]))
            flown = Flown(**{entry.name: arrays[entry.name] for entry in fields(Flown)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"{str(path)!r} is damaged, or no file of flights ({error}); delete it"
        ) from error
    differences = differing(there, settings)
    if differences:
        raise ValueError(
            f"{str(path)!r} was flown with other settings: {differences}; choose another folder "
            "by --out, or delete that file"
        )
    return flown
