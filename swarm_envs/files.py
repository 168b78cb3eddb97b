"""Files that are written whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, with its suffix, that replaces it on success.

    A reader sees the old file or the whole new one. After an exception nothing is left behind.

    Raises:
        OSError: the folder cannot be made or written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Of a long name a part: with what is added it might be longer than a name may be.
    partial = path.with_name(f".{path.stem[:48]}.{os.getpid()}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_json(path: Path, content: object) -> None:
    """Write JSON, whole or not at all.

    Raises:
        OSError: the folder cannot be made or written.
        ValueError: the content holds NaN or infinity, which JSON cannot say.
    """
    with written_whole(path) as partial:
        partial.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
