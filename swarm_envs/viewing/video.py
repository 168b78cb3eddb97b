"""The video of a recorded episode, in real time, and video files of frames.

Files are mp4, encoded by the ffmpeg of imageio-ffmpeg, or GIF.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt

from swarm_envs.files import written_whole
from swarm_envs.vehicles import GRAM_FORCE
from swarm_envs.viewing.camera import Camera, Picture
from swarm_envs.viewing.painting import Overlay
from swarm_envs.viewing.record import Recording
from swarm_envs.viewing.style import font
from swarm_envs.viewing.summary import outcome, team_label

__all__ = [
    "FPS",
    "VideoError",
    "count_frames",
    "film",
    "find_ffmpeg",
    "write_gif",
    "write_video",
    "write_video_or_gif",
]

WIDTH, HEIGHT, FPS = 768, 544, 24
"""Size of a picture, pixels, and pictures per second."""
_HEADER = 40
_TRAIL_S = 2.0
_REST_S = 1.0  # Duration of the last frame
_METER_PER_GRAM = 0.012
_WEAKEST_N = 0.5 * GRAM_FORCE
_INK, _QUIET, _PAPER = "#1c2127", "#5c6670", "#ffffff"


def count_frames(recording: Recording, fps: int | None = None) -> int:
    """Return the number of frames of the video."""
    return math.ceil((float(recording.time[-1]) + _REST_S) * (fps or FPS)) + 1


def film(recording: Recording, fps: int | None = None) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield the frames (544, 768, 3) of an episode, 24 or `fps` per second; the last lasts 1 s."""
    about = recording.about
    size = WIDTH, HEIGHT - _HEADER
    camera = Camera(recording.team, *size, solids=about.solids, arena=np.array(about.arena))
    seen = (recording.position, recording.goal, recording.reference)
    camera.aim(np.concatenate([array.reshape(-1, 3) for array in seen]))
    for k in range(count_frames(recording, fps)):
        yield _frame(camera, recording, k / (fps or FPS))


def _frame(camera: Camera, recording: Recording, time: float) -> npt.NDArray[np.uint8]:
    from PIL import Image, ImageDraw

    index = int(np.searchsorted(recording.time, time + 1e-9)) - 1
    scene = camera.picture(recording.state(index), _overlay(recording, index))
    canvas = Image.new("RGB", (WIDTH, HEIGHT), _PAPER)
    canvas.paste(Image.fromarray(scene), (0, _HEADER))
    pen, about = ImageDraw.Draw(canvas), recording.about
    seed = "" if about.seed is None else f", seed {about.seed}"
    title = f"{about.task}, {team_label(recording.team)}, {about.agent}{seed}"
    pen.text((16, 11), title, fill=_INK, font=font(15, bold=True))
    clock = f"{recording.time[index]:.2f} s"
    pen.text((WIDTH - 16, 11), clock, fill=_INK, font=font(15), anchor="ra")
    if index == len(recording.time) - 1:
        pen.text((16, HEIGHT - 30), outcome(recording), fill=_QUIET, font=font(15, bold=True))
    return np.asarray(canvas)


def _overlay(recording: Recording, index: int) -> Overlay:
    now = recording.time[index]
    first = int(np.searchsorted(recording.time, now - _TRAIL_S))
    position, force = recording.position[index], recording.force[index]
    strong = np.linalg.norm(force, axis=-1) > _WEAKEST_N
    tips = position + _METER_PER_GRAM / GRAM_FORCE * force
    reference, goal = recording.reference[index], recording.goal[index]
    return Overlay(
        goals=goal,
        references=None if np.array_equal(reference, goal) else reference,
        trails=recording.position[first : index + 1],
        arrows=np.stack([position, tips], axis=1)[strong],
    )


_GIF_SKIP = 2  # A GIF has every second frame, at half the size, to be ten times smaller


class VideoError(RuntimeError):
    """ffmpeg is missing, or failed to encode."""


def write_video(path: Path, frames: Iterable[Picture], fps: int) -> None:
    """Write an mp4 (H.264, 4:2:0) atomically.

    Args:
        path: the file, with the suffix `.mp4`.
        frames: (height, width, 3) RGB, all of one even size; an iterator is consumed lazily.
        fps: frames per second.

    Raises:
        ValueError: there is no frame, its size is odd, or the suffix is not `.mp4`.
        VideoError: ffmpeg is missing or failed.
    """
    if path.suffix != ".mp4":
        raise ValueError(f"the video's path is {path}, but must end in .mp4")
    with written_whole(path) as partial:
        _encode(partial, frames, fps)


def write_video_or_gif(path: Path, frames: Callable[[], Iterable[Picture]], fps: int) -> Path:
    """Write an mp4, or a small GIF if ffmpeg does not work; return the path."""
    try:
        write_video(path, frames(), fps)
    except VideoError:
        path = path.with_suffix(".gif")
        write_gif(path, frames(), fps)
    return path


def write_gif(path: Path, frames: Iterable[Picture], fps: int) -> None:
    """Write a GIF with every second frame at half the size, atomically."""
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


def _encode(path: Path, frames: Iterable[Picture], fps: int) -> None:
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
                raise ValueError(
                    f"a frame has shape {frame.shape}, but must have that of the first, "
                    f"{first.shape}"
                )
            if not _send(process, frame):
                break
        _, complaint = process.communicate()
    except BaseException:
        process.kill()
        process.communicate()
        raise
    if process.returncode:
        message = complaint.decode(errors="replace").strip()
        raise VideoError(f"ffmpeg ended with code {process.returncode}: {message}")


def _send(process: subprocess.Popen[bytes], frame: Picture) -> bool:
    """Send a frame to ffmpeg; return False if it has already ended."""
    assert process.stdin is not None
    try:
        process.stdin.write(np.ascontiguousarray(frame).data)
    except OSError:
        return False
    return True


def find_ffmpeg() -> str:
    """Return the path of the ffmpeg of imageio-ffmpeg; raise ImportError if it is missing."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        fix = "pip install 'swarm-envs[film]', or use a .gif file"
        raise ImportError(f"an MP4 needs ffmpeg: {fix}") from error
    return str(imageio_ffmpeg.get_ffmpeg_exe())


def _start_encoder(path: Path, width: int, height: int, fps: int) -> subprocess.Popen[bytes]:
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps)]
    coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"]
    try:
        return subprocess.Popen(
            [find_ffmpeg(), "-v", "error", "-y", *raw, "-i", "-", "-an", *coded, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
    except (ImportError, OSError, RuntimeError) as error:
        raise VideoError(f"ffmpeg cannot be started: {error}") from error
