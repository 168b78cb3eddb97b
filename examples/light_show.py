"""Fly a drone light show: letters or your own point clouds, one after another.

    python examples/light_show.py --text SWARM --drones 24 --out show
    python examples/light_show.py --points points.npy --out show

RTH3D plans the paths to each formation on a grid, and the tracking controller follows them through
the downwash of the other drones, with an estimate of the force (INDI). The script prints, for each
formation, the duration of the paths and the largest position error at their end; then the
number of contacts and the least distance between two bodies. It writes `flight.npz` (all states),
`flight.html` (a replay in the browser) and `flight.mp4` (a film; a GIF without ffmpeg) into the
folder.

A file of points is that of `numpy.save` with an array (F, N, 3): F formations of N drones,
in meters, z pointing up, each point within 25 m of the origin in x, y and z. Two points of a
formation should be at least 0.5 m apart.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from tqdm import tqdm

from swarm_envs.agents import record_episode
from swarm_envs.baselines.rth3d.grid_agent import GridAgent
from swarm_envs.control.config import ControllerConfig, Indi
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.envs.view import View
from swarm_envs.errors import check_bool, check_integer, check_name, check_number
from swarm_envs.tasks.base import Placement, Success, Task
from swarm_envs.tasks.formation import nearest_places
from swarm_envs.tasks.motion import REST, Motion
from swarm_envs.tasks.shapes import CHARACTERS, shape_points
from swarm_envs.vehicles import parse_team
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.replay import write_replay
from swarm_envs.viewing.trajectory import write_trajectory
from swarm_envs.viewing.video import FPS, count_frames, film, write_video_or_gif

LOWEST_M, MARGIN_M = 0.8, 1.5  # height of the lowest position; free space around all positions
PATH_SHARE = 0.7  # share of a stage in which the drones reach their positions
FARTHEST_M = 25.0  # largest coordinate of a point, which bounds the grid of the planner


@dataclass(frozen=True)
class Options:
    """Options of the show."""

    text: str | None = None
    """letters and digits, each a formation; spaces are skipped; default: SWARM"""
    points: Path | None = None
    """formations in a file (.npy) instead of a text"""
    drones: int | None = None
    """number of drones that write the text; default: 24"""
    stage_s: float = 14.0
    """time for each formation, s; the paths to it take at most 70 % of that"""
    world: str = "hall"
    """`hall`, with random forces and a state estimate, or `ideal`"""
    seed: int = 0
    """random seed of the planner and of the hall"""
    video: bool = True
    """render the film, which takes most of the time"""
    out: Path = Path("show")
    """output folder"""

    def __post_init__(self) -> None:
        """Raise an error for invalid values."""
        if self.drones is not None:
            check_integer("--drones", self.drones, at_least=1, at_most=256)
        check_number("--stage-s", self.stage_s, above=0.0, unit="s")
        check_integer("--seed", self.seed, at_least=0)
        check_bool("--video", self.video)


@dataclass(frozen=True, eq=False)
class ShowTask(Task):
    """Consecutive formations, in an arena with a margin around all of them."""

    formations: tuple[np.ndarray, ...] = ()  # (N, 3) each, m
    stage_s: float = 14.0  # time for each formation
    success: Success = Success()

    name = "show"

    @property
    def arena(self) -> np.ndarray:
        """The corners (2, 3), m."""
        points = np.concatenate(self.formations)
        low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
        return np.array([[low[0], low[1], 0.0], high])

    @property
    def num_stages(self) -> int:
        """The number of formations after the first, on which the drones start."""
        return len(self.formations) - 1

    @property
    def motion(self) -> Motion:
        """Goals at rest."""
        return Motion(REST, stage_s=self.stage_s)

    @property
    def episode_s(self) -> float:
        """The duration of the show, s."""
        return self.num_stages * self.stage_s

    def draw(
        self,
        rng: np.random.Generator,
        start: np.ndarray | None = None,
        goal: np.ndarray | None = None,
    ) -> Placement:
        """Assign drones to positions with the least sum of squared distances."""
        goals = [self.formations[0]]
        for points in self.formations[1:]:
            goals.append(points[nearest_places(goals[-1], points)])
        return Placement(goals[0], np.array(goals[1:]), 0.0)


class ShowAgent(GridAgent):
    """The planner RTH3D and its tracking controller."""

    def plan(self, task: Task, view: View, seed: int) -> Any:
        """Return the paths to a formation.

        Raises:
            ValueError: they take longer than their share of the stage.
        """
        found = super().plan(task, view, seed)
        needed, given = found.duration_s / PATH_SHARE, task.motion.stage_s or 0.0
        if needed > given + 1e-6:
            raise ValueError(
                f"--stage-s is {given:g}, but the paths to a formation take "
                f"{found.duration_s:.1f} s and must take at most {100 * PATH_SHARE:.0f} % of it; "
                f"give at least {math.ceil(needed)}"
            )
        return found


def read_points(path: Path) -> list[np.ndarray]:
    """Read formations from a file.

    Raises:
        ValueError: the file contains no array (F, N, 3) of coordinates within the limit.
    """
    try:
        with path.open("rb") as file:
            points = np.lib.format.read_array(file, allow_pickle=False)
    except ValueError as error:
        raise ValueError(
            f"{path} is no file of numbers that numpy.save wrote; save an array (F, N, 3) by it"
        ) from error
    if points.ndim != 3 or points.shape[2] != 3 or not points.size or points.dtype.kind not in "fi":
        raise ValueError(
            f"{path} contains an array of {points.dtype} with shape {points.shape}, but must "
            "contain numbers with shape (F, N, 3): F formations of N drones"
        )
    if not np.isfinite(points).all():
        raise ValueError(f"{path} contains a number that is not finite; give positions in meters")
    if (farthest := float(np.abs(points).max())) > FARTHEST_M:
        raise ValueError(
            f"{path} contains a coordinate {farthest:g} m from the origin, but each must be within "
            f"{FARTHEST_M:g} m; scale or move the points"
        )
    return [*points.astype(float)]


def letters(text: str, drones: int) -> list[np.ndarray]:
    """Return each character of a text as points (N, 3), m, upright and 0.5 m apart or more.

    Raises:
        ValueError: the text has no character, or one without a shape.
    """
    characters = "".join(text.split()).upper()
    if not characters:
        raise ValueError(f"--text is {text!r}, but must have at least one letter, such as SWARM")
    for character in characters:
        check_name("character of --text", character, CHARACTERS)
    return [shape_points(f"letter:{character}", drones, 0.5) for character in characters]


def read_formations(options: Options) -> list[np.ndarray]:
    """Return the formations (N, 3) of the text or of the file, m.

    Raises:
        ValueError: both are given, or they are invalid.
    """
    if options.points is None:
        text = "SWARM" if options.text is None else options.text
        return letters(text, 24 if options.drones is None else options.drones)
    for name in ("text", "drones"):
        if (given := getattr(options, name)) is not None:
            raise ValueError(
                f"--{name} is {given!r}, but --points names the formations and with them their "
                "number of drones; give one of them"
            )
    return read_points(options.points)


def stage(formations: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return formations at the lowest height of the show, with a plane first and last."""
    flat = shape_points("plane", len(formations[0]), 0.6)
    lifted = [f - np.array([0.0, 0.0, f[:, 2].min() - LOWEST_M]) for f in (flat, *formations)]
    return (*lifted, lifted[0])


def fly(task: ShowTask, options: Options) -> tuple[Recording, GridAgent]:
    """Plan and fly the show; the agent stores the plans."""
    agent = ShowAgent(controller=ControllerConfig(adaptation=Indi()), share=PATH_SHARE)
    config = EnvConfig(
        physics="batch",
        world=options.world,
        end_on_success=False,
        num_neighbors=0,
        **agent.requires,
    )
    env = SwarmParallelEnv(task, config)
    steps = round(task.episode_s * config.decision_rate) + 1
    with tqdm(total=steps, desc="fly", unit="decision") as bar:
        flight = record_episode(env, agent, options.seed, lambda _: bar.update(), name="rth3d")
    env.close()
    return flight, agent


def report(flight: Recording, agent: GridAgent, task: ShowTask) -> int:
    """Print a report; return the number of contacts, over drones and decisions."""
    for k, plan in enumerate(agent.plans):
        index = min(int(np.searchsorted(flight.time, (k + 1) * task.stage_s)), len(flight.time)) - 1
        error = np.linalg.norm(flight.position[index] - flight.goal[index], axis=-1).max()
        print(
            f"formation {k + 1}: the paths take {plan.duration_s:.1f} s; "
            f"at their end drones are within {100 * error:.1f} cm of their positions"
        )
    touching = (flight.contact_drone >= 0) | flight.contact_floor | flight.contact_wall
    line = f"{len(task.team)} drones, {flight.time[-1]:.1f} s: {touching.sum()} contacts"
    apart = flight.about.metrics["minimum_separation_m"]  # None for a single drone
    if apart is not None:
        line += f"; bodies at least {100 * (apart - task.team[0].diameter):.1f} cm apart"
    print(line)
    return int(touching.sum())


def write(flight: Recording, folder: Path, video: bool) -> None:
    """Write the flight, its replay and its film, and print where they are."""
    write_trajectory(folder / "flight.npz", flight)
    write_replay(folder / "flight.html", flight)
    written = [folder / "flight.npz", folder / "flight.html"]
    if video:
        total = count_frames(flight)
        written.append(
            write_video_or_gif(
                folder / "flight.mp4",
                lambda: tqdm(film(flight), total=total, desc="film", unit="frame"),
                FPS,
            )
        )
    print("wrote", *written)


def main(options: Options) -> int:
    """Plan, fly, report and write the show; return the number of contacts."""
    formations = read_formations(options)
    if options.out.exists() and not options.out.is_dir():
        raise ValueError(f"--out is {str(options.out)!r}, but that is a file; name a folder")
    options.out.mkdir(parents=True, exist_ok=True)
    team = parse_team("S" * len(formations[0]))
    task = ShowTask(team, formations=stage(formations), stage_s=options.stage_s)
    flight, agent = fly(task, options)
    contacts = report(flight, agent, task)
    write(flight, options.out, options.video)
    return contacts


if __name__ == "__main__":
    try:
        main(tyro.cli(Options, description=__doc__))
    except (ImportError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
