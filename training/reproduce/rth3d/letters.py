"""Fig. 11: ten drones write A-R-C-R-U, planned on a grid, flown in learned downwash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs import formation_v0
from swarm_envs.agents import record_episode
from swarm_envs.baselines.rth3d.grid_agent import GridAgent
from swarm_envs.files import write_json, write_table
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.style import GREY, INK, picture
from swarm_envs.viewing.record import Recording

LETTERS = "ARCRU"
"""What is written."""
DRONES = 10
"""As in the paper."""


def fly_letters(seed: int) -> tuple[Recording, list[int]]:
    """Fly from letter to letter, each drone to a place that is drawn.

    Args:
        seed: of the places and the planner.

    Returns:
        The flight, and the steps of each plan: its vertices but the stay at both ends.
    """
    agent = GridAgent.compensated()
    env = formation_v0.parallel_env(
        num_drones=DRONES,
        letters=LETTERS,
        labels="random",
        physics="batch",
        **agent.requires,
    )
    try:
        return record_episode(env, agent, seed), [flight.num_steps for flight in agent.flights]
    finally:
        env.close()


def snapshots(recording: Recording) -> list[int]:
    """Samples at which a letter stands: the last before the goals change, and the last of all.

    The first letter is where drones start.
    """
    moved = np.abs(np.diff(recording.goal, axis=0)).max(axis=(1, 2)) > 0.0
    return [0, *(int(k) for k in np.flatnonzero(moved)), len(recording.time) - 1]


def reproduce_letters(out: Path, seed: int = 0) -> dict[str, Any]:
    """Fly the letters, and write `figure_11.json`, `.csv` and `.png`.

    Args:
        out: folder, made if missing.
        seed: of the places and the planner.

    Returns:
        What the JSON file holds.
    """
    recording, steps = fly_letters(seed)
    metrics, shown = recording.about.metrics, snapshots(recording)
    summary = {
        "seed": seed,
        "letters": LETTERS,
        "drones": DRONES,
        "letters_reached": 1 + int(metrics["stages_reached"]),
        "success": bool(metrics["success"]),
        "collisions": sum(int(metrics[name]) for name in _CONTACTS),
        "least_distance_m": round(float(metrics["minimum_separation_m"]), 4),
        "makespans": steps,
        "duration_s": round(float(recording.time[-1]), 3),
        "arena_m": [list(corner) for corner in recording.about.arena],
    }
    rows = [
        {"letter": letter, "time_s": round(float(recording.time[k]), 3), "drone": i}
        | dict(zip(("x_m", "y_m", "z_m"), np.round(place, 4).tolist(), strict=True))
        for letter, k in zip(LETTERS, shown, strict=False)
        for i, place in enumerate(recording.position[k])
    ]
    write_table(out / "figure_11.csv", rows)
    plot_letters(out / "figure_11.png", recording, shown)
    write_json(out / "figure_11.json", summary)
    return summary


_CONTACTS = ("collided_drones", "collided_floor", "collided_wall")


def plot_letters(path: Path, recording: Recording, shown: list[int]) -> None:
    """Draw the drones at each letter, seen against y, and the ways that led there.

    Args:
        path: the picture to write.
        recording: the flight.
        shown: samples at which letters stand.
    """
    width = np.ptp(recording.position[..., 0]) + 0.4
    with picture(path, 12.0, 3.2, "Fig. 11: ten drones write, seen from the front") as figure:
        axes = figure.subplots(1, len(shown), sharex=True, sharey=True)
        before = 0
        for axis, letter, k in zip(np.atleast_1d(axes), LETTERS, shown, strict=False):
            ways: FloatArray = recording.position[before : k + 1]
            for i in range(recording.position.shape[1]):
                axis.plot(ways[:, i, 0], ways[:, i, 2], color=GREY, linewidth=0.6, alpha=0.6)
            axis.plot(*recording.position[k][:, [0, 2]].T, "o", color=INK, markersize=7)
            axis.set(title=f"{letter}, {recording.time[k]:.1f} s", xlabel="x (m)")
            axis.set_aspect("equal")
            axis.set_xlim(-width / 2, width / 2)
            before = k
        np.atleast_1d(axes)[0].set_ylabel("z (m)")


def format_letters(summary: dict[str, Any]) -> str:
    """What came of it, as text."""
    return (
        f"{summary['drones']} drones wrote {summary['letters_reached']} of {len(LETTERS)} letters "
        f"in {summary['duration_s']:.1f} s; plans of {', '.join(map(str, summary['makespans']))} "
        f"steps; collisions: {summary['collisions']}; least distance "
        f"{summary['least_distance_m']:.3f} m"
    )
