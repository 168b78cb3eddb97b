"""`swarm-envs export trajectory`: a flight or a plan as pieces that Crazyflies fly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from swarm_envs.commands.checks import Misuse, check_file, check_folder
from swarm_envs.errors import unknown_name

if TYPE_CHECKING:
    from swarm_envs.deploy import Flight


@dataclass(frozen=True, kw_only=True)
class TrajectoryOptions:
    """Fit polynomial pieces to a flight, check them, and write them as cflib and Crazyswarm do.

    Writes drone_0.csv (pieces), drone_0_samples.csv and so on, and report.json; nothing if the
    pieces must not be flown. See docs/deploy.md.
    """

    file: Annotated[Path, tyro.conf.Positional]
    """what `swarm-envs fly --trajectory` wrote, .parquet or .npz, or a plan that `SwarmPlan.save`
    wrote, .npz or .json"""
    out: Path
    """folder to write into; made if missing"""
    path: str = "flown"
    """of a recording: `flown`, or `setpoint` for what the tracking loop was asked for"""
    yaw: str = "hold"
    """of a recording: `hold` for that of the start throughout, or `flown`"""
    tolerance: float = 0.01
    """largest distance from the path, m"""
    pieces: int = 31
    """most pieces for each drone; 31 fill the firmware's memory"""
    begin_s: float = 0.0
    """leave out what was flown before, s"""
    end_s: float | None = None
    """leave out what was flown after, s"""
    settle_s: float = 1.0
    """ramp from and to rest where a flight begins or ends in motion, s; 0 refuses such a flight"""
    rate: float = 100.0
    """samples a second in the sampled files"""
    json: Path | None = None
    """write the report to this file too"""


def export_trajectory(options: TrajectoryOptions) -> None:
    """Read, fit, check and write.

    Raises:
        Misuse: there is no such file, or no such place to write.
        ImportError: Parquet without pyarrow.
        ValueError: the file holds no flight, or one that cannot be fitted or must not be flown.
    """
    check_folder("--out", options.out)
    if options.json is not None:
        check_file("--json", options.json)
    if not options.file.is_file():
        raise Misuse(f"there is no file {str(options.file)!r}")
    from swarm_envs.deploy import settled
    from swarm_envs.deploy.export import export_flight, report_content, report_lines
    from swarm_envs.files import write_json

    flight, source = _read(options)
    if options.begin_s > 0.0 or options.end_s is not None:
        end_s = flight.duration_s if options.end_s is None else options.end_s
        if not options.begin_s < end_s:
            raise Misuse(
                f"--begin-s is {options.begin_s:g}, but must lie before the end, {end_s:g}"
            )
        flight = flight.part(options.begin_s, end_s)
    if options.settle_s > 0.0:
        flight = settled(flight, options.settle_s)
    given = (options.tolerance, options.pieces, options.rate)
    found = export_flight(flight, options.out, *given, source=source, progress=True)
    if options.json is not None:
        write_json(options.json, {"source": source, **report_content(found)})
    print(*report_lines(found), sep="\n")
    print(f"wrote {len(found.drones)} trajectories of {found.duration_s:.2f} s into {options.out}")


def _read(options: TrajectoryOptions) -> tuple[Flight, dict[str, Any]]:
    """The flight, and where it comes from."""
    import numpy as np

    from swarm_envs.deploy import flight_along, flight_of

    file = options.file
    if file.suffix not in (".parquet", ".npz", ".json"):
        valid = (".parquet", ".npz", ".json")
        raise Misuse(unknown_name("suffix", file.suffix, valid, f"of {str(file)!r}"))
    keys: set[str] = set()
    if file.suffix == ".npz":
        try:
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as content:
                keys = set(content.files)
        except (ValueError, EOFError) as error:
            raise ValueError(f"{file} is not an npz file: {error}") from error
    if file.suffix == ".json" or "trajectories_states" in keys:
        from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan

        plan = SwarmPlan.load(file)
        about = {"file": file.name, "plan": plan.status, "seed": plan.seed}
        return flight_along(plan.reference, plan.duration, plan.team), about
    if "steps" in keys:
        raise ValueError(
            f"{file} is a plan on a grid, without sizes in metres; fly it by the agent rth3d and "
            "export the recording, or see docs/deploy.md for `on_grid` and `flight_along`"
        )
    from swarm_envs.viewing.trajectory import read_trajectory

    recording = read_trajectory(file)
    about = {
        "file": file.name,
        "task": recording.about.task,
        "agent": recording.about.agent,
        "seed": recording.about.seed,
        "path": options.path,
        "metrics": dict(recording.about.metrics),
    }
    return flight_of(recording, options.path, options.yaw), about
