"""`swarm-envs replay`: a recorded episode as a page for a browser, or as a film."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from swarm_envs.commands.checks import Misuse
from swarm_envs.commands.fly import WRITERS, check_outputs


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Make a page out of a recorded flight, to play it in a browser without any network."""

    file: Annotated[Path, tyro.conf.Positional]
    """what `swarm-envs fly --trajectory` wrote, .parquet or .npz"""
    out: Path = Path("replay.html")
    """the page"""
    video: Path | None = None
    """write a film too, .mp4 or .gif"""


def run(options: ReplayOptions) -> None:
    """Read, draw and write.

    Raises:
        Misuse: there is no such file, or no such place to write.
        ImportError: what reads or draws is not installed.
        ValueError: the file holds no episode.
    """
    from swarm_envs.viewing.trajectory import check_trajectory_path, read_trajectory

    files = {"replay": options.out}
    if options.video is not None:
        files["video"] = options.video
    if options.out.suffix != ".html":
        raise Misuse(f"--out is {str(options.out)!r}, but must end in .html")
    check_outputs(None, files)
    if not options.file.is_file():
        raise Misuse(f"there is no file {str(options.file)!r}")
    try:
        check_trajectory_path(options.file)
    except ValueError as error:
        raise Misuse(str(error)) from error
    recording = read_trajectory(options.file)
    for option, path in files.items():
        WRITERS[option](path, recording)
        print(f"wrote {path}", flush=True)
