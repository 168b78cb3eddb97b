"""Fig. 11: ten drones write A-R-C-R-U, planned on a grid, flown in learned downwash."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs import formation_v1
from swarm_envs.agents import record_episode
from swarm_envs.baselines.rth3d.grid_agent import GridAgent
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.claims import Claim, Extent, exactly
from swarm_envs.training.reproduce.study import Report
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.style import GREY, INK, picture

_LETTERS = "ARCRU"  # what is written
_DRONES = 10  # as in the paper


def _fly_letters(seed: int) -> tuple[Recording, list[int]]:
    """Fly from letter to letter, each drone to a place that is drawn."""
    agent = GridAgent.compensated()
    env = formation_v1.parallel_env(
        num_drones=_DRONES, letters=_LETTERS, labels="random", physics="batch", **agent.requires
    )
    try:
        return record_episode(env, agent, seed), [flight.num_steps for flight in agent.plans]
    finally:
        env.close()


def snapshots(recording: Recording) -> list[int]:
    """Samples at which a letter stands: the last before the goals change, and the last of all.

    The first letter is where drones start.
    """
    moved = np.abs(np.diff(recording.goal, axis=0)).max(axis=(1, 2)) > 0.0
    return [0, *(int(k) for k in np.flatnonzero(moved)), len(recording.time) - 1]


def letter_report(options: Any, cells: Mapping[str, Any]) -> Report:
    """The letters flown with the seed of the options."""
    recording, steps = _fly_letters(options.seed)
    metrics, shown = recording.about.metrics, snapshots(recording)
    contacts = ("collided_drones", "collided_floor", "collided_wall")
    summary = {
        "seed": options.seed,
        "letters": _LETTERS,
        "drones": _DRONES,
        "letters_reached": 1 + int(metrics["stages_reached"]),
        "success": bool(metrics["success"]),
        "collisions": sum(int(metrics[name]) for name in contacts),
        "least_distance_m": round(float(metrics["minimum_separation_m"]), 4),
        "makespans": steps,
        "duration_s": round(float(recording.time[-1]), 3),
        "arena_m": [list(corner) for corner in recording.about.arena],
    }
    table = [
        {"letter": letter, "time_s": round(float(recording.time[k]), 3), "drone": i}
        | dict(zip(("x_m", "y_m", "z_m"), np.round(place, 4).tolist(), strict=True))
        for letter, k in zip(_LETTERS, shown, strict=False)
        for i, place in enumerate(recording.position[k])
    ]
    text = (
        f"{_DRONES} drones wrote {summary['letters_reached']} of {len(_LETTERS)} letters in "
        f"{summary['duration_s']:.1f} s; plans of {', '.join(map(str, steps))} steps; collisions: "
        f"{summary['collisions']}; least distance {summary['least_distance_m']:.3f} m"
    )
    draw = partial(_plot_letters, recording=recording, shown=shown)
    return Report(summary, text, table, {"figure_11.png": draw})


def letter_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Flown, without collision, and planned on the paper's grid."""
    return [
        Claim("drones", "10", numbers["drones"], exactly(10.0)),
        Claim("letters written", "5", numbers["letters_reached"], exactly(5.0)),
        Claim("collisions", "0", numbers["collisions"], exactly(0.0)),
        Claim("least distance of two drones, m", "-", numbers["least_distance_m"]),
        Claim("longest plan of a change of letter, steps", "-", max(numbers["makespans"])),
    ]


def _plot_letters(path: Path, recording: Recording, shown: list[int]) -> None:
    """The drones at each letter, seen against y, and the ways that led there."""
    width = np.ptp(recording.position[..., 0]) + 0.4
    with picture(path, 12.0, 3.2, "Fig. 11: ten drones write, seen from the front") as figure:
        axes = figure.subplots(1, len(shown), sharex=True, sharey=True)
        before = 0
        for axis, letter, k in zip(np.atleast_1d(axes), _LETTERS, shown, strict=False):
            ways: FloatArray = recording.position[before : k + 1]
            for i in range(recording.position.shape[1]):
                axis.plot(ways[:, i, 0], ways[:, i, 2], color=GREY, linewidth=0.6, alpha=0.6)
            axis.plot(*recording.position[k][:, [0, 2]].T, "o", color=INK, markersize=7)
            axis.set(title=f"{letter}, {recording.time[k]:.1f} s", xlabel="x (m)")
            axis.set_aspect("equal")
            axis.set_xlim(-width / 2, width / 2)
            before = k
        np.atleast_1d(axes)[0].set_ylabel("z (m)")
