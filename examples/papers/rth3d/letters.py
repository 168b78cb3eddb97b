"""Fig. 11: ten drones write A-R-C-R-U, planned on a grid and simulated with learned downwash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from examples.papers.common import Row, write_compared
from swarm_envs import formation_v1
from swarm_envs.agents import record_episode
from swarm_envs.baselines.rth3d.grid_agent import GridAgent
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.style import GREY, INK, picture

LETTERS = "ARCRU"
DRONES = 10  # as in the paper


@dataclass(frozen=True, kw_only=True)
class LetterOptions:
    """Options of Fig. 11."""

    out: Path = Path("runs/rth3d")
    """folder for numbers and the picture"""
    seed: int = 0
    """of the places that drones take in a letter"""


def figure_11(options: LetterOptions) -> None:
    """Fig. 11: ten Crazyflies write A-R-C-R-U on 6 x 6 x 6 grids, flown in simulation.

    Writes figure_11.json (contacts, distances, plans, places of the drones at each letter,
    comparison) and figure_11.png.
    """
    recording, makespans = fly_letters(options.seed)
    metrics, shown = recording.about.metrics, snapshots(recording)
    contacts = ("collided_drones", "collided_floor", "collided_wall")
    numbers: dict[str, Any] = {
        "seed": options.seed,
        "letters": LETTERS,
        "drones": DRONES,
        "letters_reached": 1 + int(metrics["stages_reached"]),
        "success": bool(metrics["success"]),
        "collisions": sum(int(metrics[name]) for name in contacts),
        "least_distance_m": round(float(metrics["minimum_separation_m"]), 4),
        "makespans": makespans,
        "duration_s": round(float(recording.time[-1]), 3),
        "arena_m": [list(corner) for corner in recording.about.arena],
        "places_m": [np.round(recording.position[k], 4).tolist() for k in shown],
        "times_s": [round(float(recording.time[k]), 3) for k in shown],
    }
    rows = [
        Row("drones", "10", DRONES, (10.0, 10.0)),
        Row("letters written", "5", numbers["letters_reached"], (5.0, 5.0)),
        Row("collisions", "0", numbers["collisions"], (0.0, 0.0)),
        Row("least distance of two drones, m", "-", numbers["least_distance_m"]),
        Row("longest plan of a change of letter, steps", "-", max(makespans)),
    ]
    write_compared(options.out / "figure_11.json", numbers, rows)
    draw_letters(options.out / "figure_11.png", recording, shown)
    print(f"\nwrote figure_11.json and figure_11.png to {options.out}")


def fly_letters(seed: int) -> tuple[Recording, list[int]]:
    """Fly from letter to letter; return the flight and the makespans of the plans, steps."""
    agent = GridAgent.compensated()
    env = formation_v1.parallel_env(
        num_drones=DRONES, letters=LETTERS, labels="random", physics="batch", **agent.requires
    )
    try:
        return record_episode(env, agent, seed), [flight.num_steps for flight in agent.plans]
    finally:
        env.close()


def snapshots(recording: Recording) -> list[int]:
    """Return the samples at which a letter stands.

    They are the first, where drones start, the last before each change of goals, and the last.
    """
    moved = np.abs(np.diff(recording.goal, axis=0)).max(axis=(1, 2)) > 0.0
    return [0, *(int(k) for k in np.flatnonzero(moved)), len(recording.time) - 1]


def draw_letters(path: Path, recording: Recording, shown: Sequence[int]) -> None:
    """Draw the drones at each letter, seen against y, and the paths that led there."""
    width = np.ptp(recording.position[..., 0]) + 0.4
    with picture(path, 12.0, 3.2, "Fig. 11: ten drones write, seen from the front") as figure:
        axes = figure.subplots(1, len(shown), sharex=True, sharey=True)
        before = 0
        for axis, letter, k in zip(axes, LETTERS, shown, strict=False):
            paths = recording.position[before : k + 1]
            axis.plot(paths[:, :, 0], paths[:, :, 2], color=GREY, linewidth=0.6, alpha=0.6)
            axis.plot(*recording.position[k][:, [0, 2]].T, "o", color=INK, markersize=7)
            axis.set(title=f"{letter}, {recording.time[k]:.1f} s", xlabel="x (m)")
            axis.set_aspect("equal")
            axis.set_xlim(-width / 2, width / 2)
            before = k
        axes[0].set_ylabel("z (m)")
