"""Files that work on another machine needs, sent by value.

A file of the same name and content there is used in its place: with storage that is shared, what
stands beside it is found too. A file of the same name with other content never is.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import tempfile
from pathlib import Path
from typing import TypedDict

from swarm_envs.files import written_whole

LARGEST_BYTES = 64 * 2**20
"""Of a file that is sent: it goes along with every job."""


class SentFile(TypedDict):
    """A file, ready for JSON."""

    path: str
    """where it is, absolute"""
    sha256: str
    """of its content"""
    content: str
    """in base64"""


def send(path: Path) -> SentFile:
    """Read a file to be sent.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large.
    """
    content = path.read_bytes()
    if len(content) > LARGEST_BYTES:
        raise ValueError(
            f"{str(path)!r} has {len(content)} bytes, but at most {LARGEST_BYTES} are sent to "
            "other machines"
        )
    return SentFile(
        path=str(path.absolute()),
        sha256=hashlib.sha256(content).hexdigest(),
        content=base64.b64encode(content).decode(),
    )


def receive(sent: SentFile) -> Path:
    """Where the file is on this machine: where it was, or a copy that this process keeps.

    Raises:
        OSError: the copy cannot be written.
    """
    path, digest = Path(sent["path"]), sent["sha256"]
    if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == digest:
        return path
    copy = Path(_folder().name) / digest / path.name
    if not copy.is_file():
        with written_whole(copy) as partial:
            partial.write_bytes(base64.b64decode(sent["content"]))
    return copy


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Of this process; removed when it ends in good order."""
    return tempfile.TemporaryDirectory(prefix="swarm-envs-")
