"""The demonstration as a whole: fly, measure, plot, film, write."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs.arguments import typed
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.demo.flights import CONTROLLERS, SCENARIOS, fly_all
from swarm_envs.baselines.neural_swarm.demo.report import summarise
from swarm_envs.baselines.neural_swarm.flights import default_engine
from swarm_envs.files import write_json
from swarm_envs.interactions import InteractionModel
from swarm_envs.viewing.plots import plot_comparisons
from swarm_envs.viewing.record import Comparison

VIDEO_TEAM, VIDEO_S, VIDEO_FPS = "L2S", 5.0, 24
"""What is filmed, for how long, s, and with how many frames per second."""


@typed
def run_demo(
    out: Path,
    seed: int = 0,
    swaps: int = 6,
    video: bool = True,
    progress: bool = True,
    *,
    belief: InteractionModel | None = None,
    video_s: float = VIDEO_S,
) -> dict[str, Any]:
    """Fly every swap twice, and write `summary.json`, `demo.png` and `demo.mp4` into `out`.

    Where pybullet cannot be imported the compiled twin flies and there is no video; where ffmpeg
    does not work the video is a GIF. The summary says so in `notes`.

    Args:
        out: folder, made if missing.
        seed: seeds of the swaps are drawn from it.
        swaps: randomised swaps of each scenario.
        video: whether to make the video.
        progress: whether to show progress bars on stderr.
        belief: what the compensating controller believes; None for the shipped `load_belief()`.
        video_s: length of the video, s.

    Returns:
        What `summary.json` holds; `format_table` prints it.

    Raises:
        ValueError: `seed` or `swaps` is impossible.
        OSError: the folder cannot be written.
    """
    _check(seed, swaps)
    out.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    engine, believed = default_engine(), belief or load_belief()
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(swaps)]
    flown = fly_all(seeds, believed, engine, progress)
    comparisons = {
        team: Comparison(
            f"{team} ({text})", *([record for record, _ in flown[team][n]] for n in CONTROLLERS)
        )
        for team, text in SCENARIOS.items()
    }
    headline = f"Stacked swaps through each other's downwash, {swaps} randomised each"
    plot_comparisons(out / "demo.png", list(comparisons.values()), headline)
    summary = summarise(seed, seeds, engine, believed, flown)
    summary["files"] = {"picture": "demo.png", "video": None}
    if video and engine == "bullet":
        path = _film(out / "demo.mp4", comparisons[VIDEO_TEAM], video_s, progress)
        summary["files"]["video"] = path.name
    summary["notes"] = _notes(engine, video, summary["files"]["video"])
    summary["wall_time_s"] = round(time.perf_counter() - begin, 2)
    write_json(out / "summary.json", summary)
    return summary


def _film(path: Path, comparison: Comparison, duration_s: float, progress: bool) -> Path:
    """Film the swap whose error without compensation is the middle one; return the video's path."""
    from swarm_envs.viewing.side_by_side import SideBySide
    from swarm_envs.viewing.video import write_video_or_gif

    typical = int(np.argsort(comparison.without_cm)[len(comparison.without) // 2])
    pair = (comparison.without[typical], comparison.compensated[typical])
    with SideBySide(f"Swap {comparison.title}", pair, duration_s) as film:

        def draw() -> Iterator[npt.NDArray[np.uint8]]:
            total = film.count(VIDEO_FPS)
            bar = {"desc": "video", "unit": "frame", "mininterval": 0.5, "disable": not progress}
            yield from tqdm(film.frames(VIDEO_FPS), total=total, **bar)

        return write_video_or_gif(path, draw, VIDEO_FPS)


def _notes(engine: str, video: bool, file: str | None) -> list[str]:
    """What is otherwise than on a machine that has everything."""
    notes = []
    if engine == "batch":
        notes.append("pybullet cannot be imported here, so the compiled twin of Bullet flew")
        if video:
            notes.append("there is no video, because pybullet draws it")
    elif file is not None and file.endswith(".gif"):
        notes.append("ffmpeg does not work here, so the video is a GIF")
    return notes


def _check(seed: int, swaps: int) -> None:
    if seed < 0:
        raise ValueError(f"seed is {seed}, but must not be negative")
    if not 1 <= swaps <= 1000:
        raise ValueError(f"swaps is {swaps}, but must lie in [1, 1000]")
