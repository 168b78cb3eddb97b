"""The demonstration: stacked swaps with and without compensation, as table, picture and video.

The flight test of Neural-Swarm2 (Fig. 8): drones in a stack change places and cross half way in
one vertical line, so that the upper ones blow on the lowest. Both controllers fly the same swaps
with the same gains, filters and trajectories; they differ in the believed force alone.
"""

from __future__ import annotations

import hashlib
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from swarm_envs import __version__, swap_v0
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm.agent import TrackingAgent, load_belief
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics.bullet import import_bullet
from swarm_envs.state import FloatArray
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.viewing.files import write_json
from swarm_envs.viewing.plots import plot_comparisons
from swarm_envs.viewing.record import Comparison, FlightRecord, Recorder

SCENARIOS: Mapping[str, str] = {
    "S2S": "a small above a small",
    "L2S": "a large above a small",
    "SS2S": "two small above a small",
}
"""The teams, uppermost first, and what they are."""

LAYOUT = StackedLayout(radius_m=(0.5, 0.5), duration_s=(4.0, 4.0))
"""The paper's slow swap: radius 0.5 m in 4 s. Plane distance and direction are drawn."""

HORIZON_S = 6.0
"""Two seconds more than the swap takes, to see the drones recover."""

VIDEO_TEAM, VIDEO_S, VIDEO_FPS = "L2S", 5.0, 24

CONTROLLERS = ("without", "compensated")
"""How the summary names the two sides."""

Flight = tuple[FlightRecord, dict[str, Any]]
"""What was seen of a flight, and its metrics."""

_PACKAGES = ("numpy", "numba", "pybullet", "gymnasium", "pettingzoo")


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
    engine, believed = _pick_engine(), belief or load_belief()
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(swaps)]
    flown = _fly_all(seeds, believed, engine, progress)
    comparisons = {
        team: Comparison(
            f"{team} ({text})", *([record for record, _ in flown[team][n]] for n in CONTROLLERS)
        )
        for team, text in SCENARIOS.items()
    }
    headline = f"Stacked swaps through each other's downwash, {swaps} randomised each"
    plot_comparisons(out / "demo.png", list(comparisons.values()), headline)
    summary = _summary(seed, seeds, engine, believed, flown)
    summary["files"] = {"picture": "demo.png", "video": None}
    if video and engine == "bullet":
        path = _film(out / "demo.mp4", comparisons[VIDEO_TEAM], video_s, progress)
        summary["files"]["video"] = path.name
    summary["notes"] = _notes(engine, video, summary["files"]["video"])
    summary["wall_time_s"] = round(time.perf_counter() - begin, 2)
    write_json(out / "summary.json", summary)
    return summary


def fly_swaps(
    team: str,
    agent: TrackingAgent,
    seeds: list[int],
    engine: str,
    tick: Callable[[], object] = lambda: None,
) -> list[Flight]:
    """Fly one stacked swap for each seed; `tick` is called after each.

    Returns:
        The record and the episode's metrics of each flight.
    """
    required: dict[str, Any] = dict(agent.requires)
    env = swap_v0.parallel_env(
        team=team,
        layout="stacked",
        physics=engine,
        stacked=LAYOUT,
        end_on_success=False,
        horizon_s=HORIZON_S,
        **required,
    )
    flights = []
    try:
        for seed in seeds:
            recorder = Recorder()
            metrics = fly_episode(env, agent, seed, watch=recorder)
            flights.append((recorder.record(), metrics))
            tick()
    finally:
        env.close()
    return flights


def _fly_all(
    seeds: list[int], belief: InteractionModel, engine: str, progress: bool
) -> dict[str, dict[str, list[Flight]]]:
    """Flights by team and controller."""
    agents = (TrackingAgent(), TrackingAgent.compensated(belief))
    total = len(seeds) * len(agents) * len(SCENARIOS)
    with tqdm(
        total=total, desc="flights", unit="flight", mininterval=0.5, disable=not progress
    ) as bar:
        return {
            team: {
                name: fly_swaps(team, agent, seeds, engine, bar.update)
                for name, agent in zip(CONTROLLERS, agents, strict=True)
            }
            for team in SCENARIOS
        }


def format_table(summary: Mapping[str, Any]) -> str:
    """The summary as a table for the terminal: medians, quartiles, ratios."""
    head = ("scenario", "without (cm)", "with (cm)", "with / without", "made worse")
    rows = [head]
    for team, entry in summary["scenarios"].items():
        sides = [_spread(entry[name]["worst_height_error_cm"]) for name in CONTROLLERS]
        worse = f"{entry['made_worse']} of {summary['swaps']}"
        rows.append((team, *sides, f"{entry['ratio_of_medians']:.2f}", worse))
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))])
        for row in rows
    ]
    lines.insert(1, "  ".join("-" * width for width in widths))
    caption = (
        f"Worst height error of the lowest drone, median (quartiles) of {summary['swaps']} "
        f"swaps, {summary['engine']} engine, {summary['interactions']['name']} forces:"
    )
    return "\n".join([caption, "", *lines])


def _spread(statistics: Mapping[str, float]) -> str:
    median, low, high = (statistics[k] for k in ("median", "lower_quartile", "upper_quartile"))
    return f"{median:.1f} ({low:.1f} - {high:.1f})"


def _summary(
    seed: int,
    seeds: list[int],
    engine: str,
    belief: InteractionModel,
    flown: Mapping[str, Mapping[str, list[Flight]]],
) -> dict[str, Any]:
    return {
        "seed": seed,
        "swaps": len(seeds),
        "engine": engine,
        "layout": {
            "radius_m": LAYOUT.radius_m[0],
            "duration_s": LAYOUT.duration_s[0],
            "gap_m": list(LAYOUT.gap_m),
            "horizon_s": HORIZON_S,
        },
        "interactions": _weights(load("learned")),
        "belief": _weights(belief),
        "versions": _versions(),
        "scenarios": {team: _scenario(sides, seeds) for team, sides in flown.items()},
    }


def _scenario(sides: Mapping[str, list[Flight]], seeds: list[int]) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    worst = {}
    for name, flights in sides.items():
        worst[name] = np.array([record.worst_height_error_cm() for record, _ in flights])
        entry[name] = {
            "worst_height_error_cm": _statistics(worst[name]),
            "flights": [
                _flight(seed, *flight) for seed, flight in zip(seeds, flights, strict=True)
            ],
        }
    before, after = (worst[name] for name in CONTROLLERS)
    entry["ratio_of_medians"] = float(np.median(after) / np.median(before))
    entry["made_worse"] = int((after > before).sum())
    return entry


def _flight(seed: int, record: FlightRecord, metrics: Mapping[str, Any]) -> dict[str, Any]:
    heights = np.sort(record.reference[0, :, 2])
    return {
        "seed": seed,
        "gap_m": float(np.diff(heights).mean()),
        "worst_height_error_cm": record.worst_height_error_cm(),
        "strongest_vertical_force_g": float(np.abs(record.vertical_force_g()).max()),
        "metrics": dict(metrics),
    }


def _statistics(values: FloatArray) -> dict[str, float]:
    low, median, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
    return {"median": median, "lower_quartile": low, "upper_quartile": high}


def _weights(model: InteractionModel) -> dict[str, str]:
    """Name of a model and the hash of its weights file, without the place of that file."""
    file = Path(model.name)
    if not file.is_file():  # one that ships, by its name
        shipped = resources.files("swarm_envs.interactions").joinpath("weights")
        with resources.as_file(shipped.joinpath(f"{model.name}.safetensors")) as path:
            return {"name": model.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    return {"name": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


def _versions() -> dict[str, str]:
    found = {"swarm_envs": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


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


def _pick_engine() -> str:
    try:
        import_bullet()
    except ImportError:
        return "batch"
    return "bullet"


def _check(seed: int, swaps: int) -> None:
    if seed < 0:
        raise ValueError(f"seed is {seed}, but must not be negative")
    if not 1 <= swaps <= 1000:
        raise ValueError(f"swaps is {swaps}, but must lie in [1, 1000]")
