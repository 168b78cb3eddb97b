"""Checks of a command's options before it begins its work."""

from __future__ import annotations

import os
from pathlib import Path


class Misuse(ValueError):
    """Options with which a command cannot do its job, found before it begins."""


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder that cannot be made or written, before hours are spent on its content.

    Raises:
        Misuse: naming the option, the folder and what is wrong with it.
    """
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise Misuse(f"{option} is {str(folder)!r}, but {str(existing)!r} is a file; name a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise Misuse(f"{option} is {str(folder)!r}, but {str(existing)!r} cannot be written")


def check_file(option: str, file: Path, suffixes: tuple[str, ...] = ()) -> None:
    """Refuse a file that cannot be written, or whose name ends otherwise than it may.

    Raises:
        Misuse: naming the option, the file and what is wrong with it.
    """
    if suffixes and file.suffix not in suffixes:
        raise Misuse(f"{option} is {str(file)!r}, but must end in {' or '.join(suffixes)}")
    if file.is_dir():
        raise Misuse(f"{option} is {str(file)!r}, but that is a folder; name a file")
    check_folder(option, file.absolute().parent)
