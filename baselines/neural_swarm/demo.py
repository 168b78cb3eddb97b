"""The demonstration: stacked swaps with and without compensation, as table, picture and video.

In the flight test of Neural-Swarm2 (Fig. 8), drones in a stack swap sides and cross halfway in one
vertical line, so that the lowest flies through the downwash of the others. Both controllers fly the
same swaps with the same gains, filters and trajectories; they differ only in the force that they
compensate.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    PAPER_SWAP,
    RECOVERY_S,
    Flights,
    default_engine,
    describe_model,
    describe_spread,
    format_columns,
    progress_bar,
    quartiles,
    run_flights,
    swap_test,
    versions,
)
from swarm_envs.control.config import ControllerConfig
from swarm_envs.files import write_json
from swarm_envs.interactions import load
from swarm_envs.viewing.comparison import Comparison, plot_comparisons

__all__ = ["crashed_flights", "format_table", "run_demo"]

SCENARIOS: Mapping[str, str] = {
    "S2S": "a small above a small",
    "L2S": "a large above a small",
    "SS2S": "two small above a small",
}
"""The teams, uppermost drone first, and their descriptions."""
CONTROLLERS = ("without", "compensated")  # The names of the two controllers in the summary
VIDEO_TEAM, VIDEO_S, VIDEO_FPS = "L2S", 5.0, 24
"""The team, the duration, s, and the frame rate, 1/s, of the video."""
_HORIZON_S = PAPER_SWAP.duration_s[1] + RECOVERY_S


def run_demo(
    out: Path,
    seed: int = 0,
    swaps: int = 6,
    video: bool = True,
    progress: bool = True,
    *,
    video_s: float = VIDEO_S,
) -> dict[str, Any]:
    """Simulate every swap twice, and write `summary.json`, `demo.png` and `demo.mp4` into `out`.

    The compiled engine is used if pybullet cannot be imported, and the video is a GIF if ffmpeg
    does not work; the `notes` of the summary then report it.

    Args:
        out: The output folder, created if missing.
        seed: The seed from which the seeds of the swaps are drawn.
        swaps: The number of randomized swaps of each scenario.
        video: True to write the video.
        progress: True to show progress bars on stderr.
        video_s: The duration of the video, s.

    Returns:
        The content of `summary.json`, which `format_table` formats.

    Raises:
        OSError: The folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    engine, compensated = default_engine(), load_belief()
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(swaps)]
    controllers = (ControllerConfig(), ControllerConfig(feedforward=compensated))
    tests = {team: swap_test(team, engine=engine) for team in SCENARIOS}
    total = sum(test.decisions for test in tests.values()) * len(seeds) * len(controllers)
    with progress_bar("flights", total, progress) as bar:
        flown = {
            team: [run_flights(test, controller, seeds, bar.update) for controller in controllers]
            for team, test in tests.items()
        }
    comparisons = {
        team: Comparison(f"{team} ({text})", *([f.record(e) for e in range(swaps)] for f in sides))
        for (team, text), sides in zip(SCENARIOS.items(), flown.values(), strict=True)
    }
    headline = f"Stacked swaps through each other's downwash, {swaps} randomized each"
    plot_comparisons(out / "demo.png", list(comparisons.values()), headline)
    summary: dict[str, Any] = {
        "seed": seed,
        "swaps": len(seeds),
        "engine": engine,
        "layout": {
            "radius_m": PAPER_SWAP.radius_m[0],
            "duration_s": PAPER_SWAP.duration_s[0],
            "gap_m": list(PAPER_SWAP.gap_m),
            "horizon_s": _HORIZON_S,
        },
        "interactions": describe_model(load("learned")),
        "belief": describe_model(compensated),
        "versions": versions(),
        "scenarios": {team: _scenario(sides) for team, sides in flown.items()},
        "files": {"picture": "demo.png", "video": None},
    }
    if video:
        path = _film(out / "demo.mp4", comparisons[VIDEO_TEAM], video_s, progress)
        summary["files"]["video"] = path.name
    summary["notes"] = _notes(engine, summary["files"]["video"])
    summary["wall_time_s"] = round(time.perf_counter() - begin, 2)
    write_json(out / "summary.json", summary)
    return summary


def _scenario(sides: Sequence[Flights]) -> dict[str, Any]:
    """Return a team's entry of the summary: flights and statistics by controller, their ratio."""
    entry: dict[str, Any] = {}
    worst = []
    for name, flights in zip(CONTROLLERS, sides, strict=True):
        rows = [_flight(flights, e) for e in range(len(flights.seeds))]
        worst.append(np.array([row["worst_height_error_cm"] for row in rows]))
        entry[name] = {
            "crashed": sum(row["metrics"]["length_s"] < _HORIZON_S - 1e-6 for row in rows),
            "worst_height_error_cm": quartiles(worst[-1]),
            "flights": rows,
        }
    before, after = worst
    entry["ratio_of_medians"] = float(np.median(after) / np.median(before))
    entry["made_worse"] = int((after > before).sum())
    return entry


def _flight(flights: Flights, e: int) -> dict[str, Any]:
    record = flights.record(e)
    heights = np.sort(record.reference[0, :, 2])
    return {
        "seed": flights.seeds[e],
        "gap_m": float(np.diff(heights).mean()),
        "worst_height_error_cm": record.worst_height_error_cm(),
        "strongest_vertical_force_g": float(np.abs(record.vertical_force_g()).max()),
        "metrics": dict(flights.metrics[e]),
    }


def _film(path: Path, comparison: Comparison, duration_s: float, progress: bool) -> Path:
    """Film the swap of median error without compensation; return the path of the video."""
    from swarm_envs.viewing.comparison import SideBySide
    from swarm_envs.viewing.video import write_video_or_gif

    typical = int(np.argsort(comparison.without_cm)[len(comparison.without) // 2])
    pair = (comparison.without[typical], comparison.compensated[typical])
    film = SideBySide(f"Swap {comparison.title}", pair, duration_s)

    def draw() -> Iterator[npt.NDArray[np.uint8]]:
        total = film.count(VIDEO_FPS)
        bar = {"desc": "video", "unit": "frame", "mininterval": 0.5, "disable": not progress}
        yield from tqdm(film.frames(VIDEO_FPS), total=total, **bar)

    return write_video_or_gif(path, draw, VIDEO_FPS)


def _notes(engine: str, file: str | None) -> list[str]:
    """Return notes on optional dependencies that were missing."""
    notes = []
    if engine == "batch":
        notes.append("pybullet cannot be imported here, so the compiled engine was used")
    if file is not None and file.endswith(".gif"):
        notes.append("ffmpeg does not work here, so the video is a GIF")
    return notes


def crashed_flights(summary: Mapping[str, Any]) -> int:
    """Return the number of flights that ended early, whose worst error is a lower bound."""
    entries = summary["scenarios"].values()
    return sum(int(entry[name]["crashed"]) for entry in entries for name in CONTROLLERS)


def format_table(summary: Mapping[str, Any]) -> str:
    """Return the summary as a table for the terminal: medians, quartiles, ratios."""
    head = ("scenario", "without (cm)", "with (cm)", "with / without", "made worse", "crashed")
    rows = [head]
    for team, entry in summary["scenarios"].items():
        sides = [describe_spread(entry[name]["worst_height_error_cm"]) for name in CONTROLLERS]
        worse = f"{entry['made_worse']} of {summary['swaps']}"
        crashed = " / ".join(str(entry[name]["crashed"]) for name in CONTROLLERS)
        rows.append((team, *sides, f"{entry['ratio_of_medians']:.2f}", worse, crashed))
    caption = (
        f"Worst height error of the lowest drone, median (quartiles) of {summary['swaps']} "
        f"swaps, {summary['engine']} engine, {summary['interactions']['name']} forces:"
    )
    return "\n".join([caption, "", *format_columns(rows)])
