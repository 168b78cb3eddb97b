"""Videos: frames to an mp4 with the ffmpeg that imageio-ffmpeg carries, or to a GIF."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.files import written_whole

Frame = npt.NDArray[np.uint8]
"""(height, width, 3) red, green, blue."""

_GIF_SKIP = 2
"""A GIF has every second frame, at half the size: it is ten times as large otherwise."""


class VideoError(RuntimeError):
    """ffmpeg is missing, or did not encode."""


def write_video(path: Path, frames: Iterable[Frame], fps: int) -> None:
    """Write an mp4: H.264, 4:2:0, playable everywhere. Whole or not at all.

    Args:
        path: ends in `.mp4`.
        frames: (height, width, 3) RGB, all of one even size; drawn as they are needed.
        fps: frames per second.

    Raises:
        ValueError: no frame, an odd size or another suffix.
        VideoError: ffmpeg is missing or failed.
    """
    if path.suffix != ".mp4":
        raise ValueError(f"the video's path is {path}, but must end in .mp4")
    with written_whole(path) as partial:
        _encode(partial, frames, fps)


def write_video_or_gif(path: Path, frames: Callable[[], Iterable[Frame]], fps: int) -> Path:
    """Write an mp4, or beside it a small GIF where ffmpeg does not work.

    Args:
        path: ends in `.mp4`.
        frames: draws the frames; called again for the GIF.
        fps: frames per second.

    Returns:
        The path that was written.
    """
    try:
        write_video(path, frames(), fps)
    except VideoError:
        path = path.with_suffix(".gif")
        write_gif(path, frames(), fps)
    return path


def write_gif(path: Path, frames: Iterable[Frame], fps: int) -> None:
    """Write a GIF with every second frame at half the size. Whole or not at all.

    Raises:
        ValueError: there is no frame.
    """
    from PIL import Image

    half = [
        Image.fromarray(frame).reduce(2).quantize(128)
        for i, frame in enumerate(frames)
        if i % _GIF_SKIP == 0
    ]
    if not half:
        raise ValueError("a video needs at least one frame")
    duration = round(1000 * _GIF_SKIP / fps)
    with written_whole(path) as partial:
        half[0].save(partial, save_all=True, append_images=half[1:], duration=duration, loop=0)


def _encode(path: Path, frames: Iterable[Frame], fps: int) -> None:
    stream = iter(frames)
    first = next(stream, None)
    if first is None:
        raise ValueError("a video needs at least one frame")
    height, width = first.shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"frames are {width} x {height} pixels, but H.264 needs even sizes")
    process = _start_encoder(path, width, height, fps)
    try:
        for frame in chain([first], stream):
            if frame.shape != first.shape:
                raise ValueError(f"a frame has shape {frame.shape}, but the first {first.shape}")
            if not _send(process, frame):
                break
        _, complaint = process.communicate()
    except BaseException:
        process.kill()
        process.communicate()
        raise
    if process.returncode:
        said = complaint.decode(errors="replace").strip()
        raise VideoError(f"ffmpeg ended with code {process.returncode}: {said}")


def _send(process: subprocess.Popen[bytes], frame: Frame) -> bool:
    """Give ffmpeg a frame; False if it has already ended."""
    assert process.stdin is not None
    try:
        process.stdin.write(np.ascontiguousarray(frame).data)
    except OSError:
        return False
    return True


def _start_encoder(path: Path, width: int, height: int, fps: int) -> subprocess.Popen[bytes]:
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps)]
    coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"]
    try:
        import imageio_ffmpeg

        ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
        return subprocess.Popen(
            [ffmpeg, "-v", "error", "-y", *raw, "-i", "-", "-an", *coded, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
    except (ImportError, OSError, RuntimeError) as error:
        raise VideoError(f"ffmpeg cannot be started: {error}") from error
