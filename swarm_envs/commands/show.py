"""`swarm-envs show`: a drone show with lights, planned, flown, filmed and exported."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.arguments import NOT_NEGATIVE, POSITIVE, POSITIVE_M, OneOf, Range, Seed
from swarm_envs.commands.checks import (
    FlightBar,
    as_misuse,
    check_file,
    command_options,
    output_files,
)
from swarm_envs.files import claimed, write_json

if TYPE_CHECKING:
    from swarm_envs.shows.planning import Show
    from swarm_envs.viewing.record import Recording


@command_options
@dataclass(frozen=True, kw_only=True)
class ShowOptions:
    """Plan a drone light show, fly it with interaction forces, film it at night, and export it.

    Drones start on the ground, form one shape after another, and land. Shapes: heart, star, sphere,
    helix, wave, plane, pyramid, cube, rings, blocks; text:WORD; letters:ABC, one after another; a
    drawing (.svg); a point cloud (.csv or .npy with x, y, z and optionally red, green, blue).
    """

    shapes: tuple[str, ...] = ("text:SWARM", "sphere", "heart", "helix")
    """names, texts and files, in order"""
    drones: Annotated[int, Range(2, 2000)] = 150
    """number of drones"""
    colors: tuple[str, ...] = ()
    """colors of each shape: gold, #ff8800, a gradient red:gold from bottom to top, or rainbow"""
    labels: bool = False
    """labeled transitions: drone i takes point i of each shape; otherwise any drone takes any
    point"""
    spacing_m: Annotated[float, POSITIVE_M] = 0.35
    """minimum distance of reference paths, with heights divided by --height-factor; points of a
    shape are 1.42 times as far apart, m"""
    height_factor: Annotated[float, Range(1.0, 10.0)] = 2.0
    """factor by which vertical distances must be larger than horizontal ones, because of
    downwash"""
    lean_deg: Annotated[float, Range(0.0, 90.0)] = 30.0
    """backward tilt of flat shapes, degrees"""
    largest_m: Annotated[float, POSITIVE_M] = 60.0
    """largest width, depth or height of a shape, m"""
    speed: Annotated[float, POSITIVE] = 2.0
    """maximum speed of the reference paths, m/s"""
    acceleration: Annotated[float, POSITIVE] = 4.0
    """maximum acceleration of the reference paths, m/s^2"""
    hold_s: Annotated[float, NOT_NEGATIVE] = 3.0
    """time at each shape, s"""
    fly: bool = True
    """fly the paths; otherwise the film shows the planned paths"""
    world: Annotated[str, OneOf(("hall", "ideal"))] = "hall"
    """`hall`, with random forces, noise and delay, or `ideal`"""
    seed: Seed = 0
    """random seed of the hall and of labeled transitions"""
    out: Path | None = None
    """output folder for show.json, show.skyc and show.mp4"""
    json: Path | None = None
    """write the results of planning and flight, .json"""
    skyc: Path | None = None
    """write the show for Skybrush, .skyc"""
    video: Path | None = None
    """write a film, .mp4 or .gif"""
    trajectory: Path | None = None
    """write the flight, .npz or .parquet, for `swarm-envs export trajectory` and `replay`"""

    def __post_init__(self) -> None:
        """Refuse a show without a shape, and the record of no flight."""
        if not self.shapes:
            raise ValueError("--shapes is empty; name at least one, such as heart")
        if self.trajectory is not None and not self.fly:
            raise ValueError("--trajectory is the record of a flight; leave out --no-fly")


_FILES = {
    "json": ("show.json", ".json"),
    "skyc": ("show.skyc", ".skyc"),
    "video": ("show.mp4", ".mp4", ".gif"),
}
"""What `--out` writes: option, name of the file and its suffixes, in the order of writing."""


def run_show(options: ShowOptions) -> None:
    """Plan, fly, print and write."""
    from swarm_envs.shows.skybrush import write_skyc
    from swarm_envs.viewing.trajectory import write_trajectory

    files = output_files(options, _FILES)
    if options.trajectory is not None:
        check_file("--trajectory", options.trajectory, (".npz", ".parquet"))
    show, facts = _plan(options)
    with nullcontext() if options.out is None else claimed(options.out):
        flight = _fly(show, options, facts) if options.fly else None
        if "json" in files:
            write_json(files["json"], facts)
        if "skyc" in files:
            write_skyc(files["skyc"], show, " ".join(options.shapes))
        if "video" in files:
            files["video"] = _film(files["video"], show, flight)
        if options.trajectory is not None and flight is not None:
            write_trajectory(options.trajectory, flight)
            files["trajectory"] = options.trajectory
    for path in files.values():
        print(f"wrote {path}")


def _plan(options: ShowOptions) -> tuple[Show, dict[str, Any]]:
    from swarm_envs.shows.formations import Room, formations_of, spelled
    from swarm_envs.shows.planning import plan_show
    from swarm_envs.shows.transitions import Pace

    with as_misuse(OSError):
        room = Room(options.spacing_m, options.height_factor, options.lean_deg,
                    largest=options.largest_m)  # fmt: skip
        shapes = spelled(options.shapes)
        formations = formations_of(shapes, options.drones, options.colors, room)
        pace = Pace(options.speed, options.acceleration)
    with tqdm(total=len(formations) - 1, desc="plan", unit="shape", mininterval=0.1) as bar:

        def watch(name: str) -> None:
            bar.set_description(f"plan {name}")
            bar.update()

        show = plan_show(
            formations, room, pace, options.hold_s, options.labels, options.seed, watch
        )
    facts = show.facts()
    print(*_plan_lines(facts, options.spacing_m), sep="\n", flush=True)
    return show, {"version": __version__, "spacing_m": options.spacing_m,
                  "labels": options.labels, "seed": options.seed, **facts}  # fmt: skip


def _plan_lines(facts: Mapping[str, Any], spacing: float) -> list[str]:
    """What is printed of a plan."""
    width = max(len(row["to"]) for row in facts["transitions"])
    rows = [
        f"  to {row['to'].ljust(width)}  {row['seconds']:6.2f} s, {row['ratio']:.2f} times that of "
        f"one drone alone; at least {row['least_distance_m']:.3f} m apart"
        for row in facts["transitions"]
    ]
    head = (
        f"{facts['drones']} drones, {facts['duration_s']:.1f} s, at least "
        f"{facts['least_distance_m']:.3f} m apart (spacing {spacing} m, heights scaled)"
    )
    return [head, *rows]


def _fly(show: Show, options: ShowOptions, facts: dict[str, Any]) -> Recording:
    from swarm_envs.shows.flying import fly_show

    bar = FlightBar(math.ceil(20 * show.paths.duration_s) + 1)
    with closing(bar):
        flight, flown = fly_show(show.paths, options.world, options.seed, bar)
    facts["flight"] = {"world": options.world, **flown}
    print(
        f"flown in world {options.world!r}: {flown['contacts']} contacts, bodies at least "
        f"{100 * flown['clearance_m']:.1f} cm apart, at most {100 * flown['worst_error_m']:.1f} cm "
        "from their paths",
        flush=True,
    )
    return flight


def _film(path: Path, show: Show, flight: Recording | None) -> Path:
    """Write the film; a GIF where there is no ffmpeg. The path that was written."""
    from swarm_envs.shows.night import FPS, count_show_frames, film_lights
    from swarm_envs.viewing.video import write_gif, write_video_or_gif

    if flight is None:
        times = np.linspace(0.0, show.paths.duration_s, 2 + int(20 * show.paths.duration_s))
        places = show.paths.positions(times)
    else:
        times, places = flight.time, flight.position
    total = count_show_frames(float(times[-1]))

    def frames() -> Any:
        lights = film_lights(times, places, show.colors(times))
        return tqdm(lights, total=total, desc="film", unit="frame", mininterval=0.5)

    if path.suffix == ".gif":
        write_gif(path, frames(), FPS)
        return path
    return write_video_or_gif(path, frames, FPS)
