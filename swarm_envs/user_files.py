"""Classes and functions from a user's own Python file, such as `my_agent.py:MyAgent`."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from swarm_envs.errors import unknown_name

__all__ = ["file_digest", "find_in", "import_file", "load_from_file", "users_line"]

_USERS_MODULE = "swarm_envs_users_file_"
_imported: dict[str, set[str]] = {}
"""Modules that users' files have imported from beside them, by the folder."""
_inserted: list[str] = []  # folder that was put on the path for the last of them


def load_from_file(name: str) -> Any:
    """Return what a user's file holds by a name, `path/to/file.py:Class`.

    Raises:
        ValueError: the name is no such thing, or the file has nothing of this name.
        FileNotFoundError: there is no such file.
        ImportError: the file cannot be imported.
    """
    file, colon, path = name.rpartition(":")
    if not colon:
        raise ValueError(f"{name!r} names no class or function; write {name + ':Class'!r}")
    return find_in(name, import_file(Path(file)), path)


def import_file(file: Path) -> ModuleType:
    """Import a user's file, and let it import those beside it.

    Raises:
        ValueError: it is no Python file.
        FileNotFoundError: there is no such file.
        ImportError: it cannot be imported.
    """
    if file.suffix != ".py":
        raise ValueError(f"the file is {str(file)!r}, but must be a Python file, .py")
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {str(file)!r}")
    name, folder = _USERS_MODULE + file.stem, file.resolve().parent
    _enter(folder)
    before = set(sys.modules)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses of the file look themselves up there
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ImportError(f"{file} cannot be imported: {type(error).__name__}: {error}") from error
    finally:
        new = {m for m in set(sys.modules) - before if _lies_in(folder, sys.modules[m])}
        _imported[str(folder)] |= new - {name}
    return module


def _enter(folder: Path) -> None:
    """Let a file import those beside it, as if it was run, and not those beside other files."""
    for other, modules in _imported.items():
        if other != str(folder):
            for name in modules:
                sys.modules.pop(name, None)
            modules.clear()
    while _inserted:
        with suppress(ValueError):  # taken off by the file itself
            sys.path.remove(_inserted.pop())
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
        _inserted.append(str(folder))
    _imported.setdefault(str(folder), set())


def _lies_in(folder: Path, module: ModuleType) -> bool:
    place = getattr(module, "__file__", None)
    return place is not None and Path(place).parent == folder


def users_line(error: BaseException) -> str | None:
    """Return the line of a user's file in which an error was raised; None if it was in none."""
    found = None
    for frame, number in traceback.walk_tb(error.__traceback__):
        if str(frame.f_globals.get("__name__", "")).startswith(_USERS_MODULE):
            found = f"line {number} of {frame.f_code.co_filename}"
    return found


def file_digest(name: str) -> str:
    """Return the SHA-256 of what a name such as `path/to/file.py:Class` depends on; "" of others.

    That is every Python file of its folder: the file may import those beside it.
    """
    file, colon, _ = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        return ""
    digest = hashlib.sha256()
    for path in sorted(Path(file).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def find_in(name: str, module: ModuleType, path: str) -> Any:
    """Return what a user's module holds by a path such as `Class`, named `name` in messages.

    Raises:
        ValueError: it holds no such thing; the message names the nearest.
    """
    made: Any = module
    for part in path.split("."):
        if not hasattr(made, part):
            raise ValueError(
                unknown_name("class or function", part, _defined(module), f"in {name!r}")
            )
        made = getattr(made, part)
    return made


def _defined(module: ModuleType) -> list[str]:
    """The classes and functions that a file defines and does not hide."""
    return [
        name
        for name, value in vars(module).items()
        if (inspect.isclass(value) or inspect.isfunction(value))
        and value.__module__ == module.__name__
        and not name.startswith("_")
    ]
