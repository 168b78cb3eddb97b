"""The films of the docs: `make films`, or `make films FILMS='swap gates'` for some of them.

Each is an animated WebP of one episode, flown on the compiled engine. A film named after a task is
on that task's page, and all of them are in `gallery.md`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image
from tqdm import tqdm

from swarm_envs import make
from swarm_envs.agents import load, record_episode
from swarm_envs.files import written_whole
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.video import count_frames, film

FOLDER = Path(__file__).parent / "films"
FPS, SIZE, LONGEST_S = 12, (480, 340), 10.0
LARGEST = 400_000
"""Bytes of a film at most."""


class Take(NamedTuple):
    """An episode to film."""

    task: str
    agent: str
    options: dict[str, Any]
    seed: int = 1


HALL = {"team": "L2S", "layout": "stacked", "world": "hall"}
FILMS = {
    "swap": Take("swap_v1", "swap-dagger", {"num_drones": 8, "layout": "circle"}),
    "ring": Take("ring_v1", "ring-dagger", {"num_drones": 5}),
    "formation": Take("formation_v1", "swap-dagger", {"num_drones": 8}),
    "columns": Take("columns_v0", "downwash-aware", {}),
    "delivery": Take("delivery_v0", "delivery-dagger", {"num_drones": 7, "world": "hall"}),
    "crowd": Take("crowd_v0", "crowd-dagger+filter", {"num_drones": 16, "layout": "forest"}),
    "pursuit": Take("pursuit_v0", "pursuit-dagger", {"layout": "chase"}),
    "gates": Take("gates_v0", "gates-dagger", {"num_drones": 4}),
    "tracking": Take("swap_v1", "tracking", {"team": "L2S", "layout": "stacked"}),
    "tracking+compensated": Take(
        "swap_v1", "tracking+compensated", {"team": "L2S", "layout": "stacked"}
    ),
    "roundabout": Take("swap_v1", "roundabout", {"num_drones": 16, "layout": "circle"}),
    "orca": Take("swap_v1", "orca", {"num_drones": 8, "layout": "random"}),
    "swap-dagger": Take("swap_v1", "swap-dagger", {"num_drones": 32, "layout": "circle"}),
    "swap-ppo": Take("swap_v1", "swap-ppo", {"num_drones": 4, "layout": "circle"}),
    "stack-dagger": Take("columns_v0", "stack-dagger", {"num_drones": 8, "world": "hall"}),
    "mixed-dagger": Take("columns_v0", "mixed-dagger", {"team": "LSSLSS", "world": "hall"}),
    "sprint-dagger": Take(
        "columns_v0",
        "sprint-dagger",
        {"layout": "sprint", "num_drones": 8, "world": "hall", "horizon_s": 1.8},
    ),
    "ring-dagger": Take("ring_v1", "ring-dagger", {"num_drones": 16}),
    "detour+compensated": Take("swap_v1", "detour+compensated", {"team": "SSSSLLLL"}),
    "neural-swarm-planner": Take("swap_v1", "neural-swarm-planner", {"num_drones": 3}),
    "mlr-dmpc": Take("swap_v1", "mlr-dmpc", {"num_drones": 8, "layout": "circle"}),
    "rth3d+compensated": Take("formation_v1", "rth3d+compensated", {"num_drones": 10}),
    "hover": Take("columns_v0", "hover", {}),
    "random": Take("swap_v1", "random", {"num_drones": 4}),
    "straight-line": Take("swap_v1", "straight-line+filter", {"num_drones": 4}),
    "fast-line": Take("swap_v1", "fast-line", {"num_drones": 8, "layout": "random"}),
    "tracking+adaptive": Take("swap_v1", "tracking+adaptive", HALL),
    "tracking+compensated+adaptive": Take("swap_v1", "tracking+compensated+adaptive", HALL),
    "pid": Take("delivery_v0", "pid", {}),
    "pid+adaptive": Take("delivery_v0", "pid+adaptive", {}),
    "heavy-on-top": Take("columns_v0", "heavy-on-top", {}),
    "detour": Take("swap_v1", "detour", {"num_drones": 8, "layout": "circle"}),
    "mlr-dmpc+compensated": Take("swap_v1", "mlr-dmpc+compensated", {"team": "SSLL"}),
    "rth3d": Take("formation_v1", "rth3d", {"num_drones": 10, "interactions": "none"}),
}
"""By name: the task's family, or an agent."""


def record(take: Take) -> Recording:
    """Fly the episode of a film."""
    agent = load(take.agent)
    env = make(take.task, **{"physics": "batch", **take.options, **agent.requires})
    try:
        return record_episode(env, agent, take.seed, name=take.agent)
    finally:
        env.close()


def write_film(path: Path, frames: Iterable[Any], total: int) -> None:
    """Draw at most ten seconds, and write them no larger than `LARGEST`."""
    total = min(total, round(LONGEST_S * FPS))
    shown = tqdm(zip(range(total), frames, strict=False), path.stem, total)
    pictures = [Image.fromarray(frame).resize(SIZE) for _, frame in shown]
    for quality in (60, 45, 30, 15):
        with written_whole(path) as partial:
            pictures[0].save(
                partial, save_all=True, append_images=pictures[1:], duration=round(1000 / FPS),
                loop=0, quality=quality, method=4,
            )  # fmt: skip
        if path.stat().st_size <= LARGEST:
            return
    raise ValueError(f"{path} has {path.stat().st_size} bytes, more than {LARGEST}")


if __name__ == "__main__":
    for name in sys.argv[1:] or FILMS:
        recording = record(FILMS[name])
        tqdm.write(f"{name}: success {recording.about.metrics['success']}")
        frames = film(recording, FPS)
        write_film(FOLDER / f"{name}.webp", frames, count_frames(recording, FPS))
