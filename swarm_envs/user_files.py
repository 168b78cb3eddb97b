"""Classes and functions from a user's Python file, such as `my_agent.py:MyAgent`."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import re
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any

from swarm_envs.errors import unknown_name

__all__ = [
    "file_digest",
    "find_in",
    "import_file",
    "load_from_file",
    "users_line",
    "users_traceback",
]

_USERS_MODULE = "swarm_envs_users_file_"
_IMPORTS_BY_NAME = re.compile(rb"\b(importlib|__import__|runpy|exec)\b")
_imported: dict[str, set[str]] = {}
"""Modules that users' files have imported from their own folders, by folder."""
_inserted: list[str] = []  # The folder on `sys.path` for the last imported file


def load_from_file(name: str) -> Any:
    """Return the class or function that `path/to/file.py:Class` names.

    Raises:
        ValueError: the name has another form, or the file does not define it.
        FileNotFoundError: there is no such file.
        ImportError: the file cannot be imported.
    """
    file, colon, path = name.rpartition(":")
    if not colon:
        raise ValueError(f"{name!r} names no class or function; write {name + ':Class'!r}")
    return find_in(name, import_file(Path(file)), path)


def import_file(file: Path) -> ModuleType:
    """Import a user's file, which may import other files of its folder.

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
        where = "" if (line := users_line(error)) is None else f"{line} raises "
        raise ImportError(
            f"{file} cannot be imported: {where}{type(error).__name__}: {error}"
        ) from error
    finally:
        new = {m for m in set(sys.modules) - before if _lies_in(folder, sys.modules[m])}
        _imported[str(folder)] |= new - {name}
    return module


def _enter(folder: Path) -> None:
    """Let a file import modules of its folder, as if it was run, and none of other folders."""
    for other, modules in _imported.items():
        if other != str(folder):
            for name in modules:
                sys.modules.pop(name, None)
            modules.clear()
    while _inserted:
        with suppress(ValueError):  # the file itself may have removed it
            sys.path.remove(_inserted.pop())
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
        _inserted.append(str(folder))
    _imported.setdefault(str(folder), set())


def _lies_in(folder: Path, module: ModuleType) -> bool:
    file = getattr(module, "__file__", None)
    return file is not None and Path(file).parent == folder


def users_line(error: BaseException) -> str | None:
    """Return the line of a user's file in which an error was raised, or None."""
    found = None
    for frame, number in traceback.walk_tb(error.__traceback__):
        if _is_users(frame):
            found = f"line {number} of {frame.f_code.co_filename}"
    return found


def users_traceback(error: BaseException | None) -> str:
    """Return the traceback of an error, or of its cause, from the first line of a user's file on.

    The result is "" if neither was raised in a user's file.
    """
    while error is not None:
        rest = error.__traceback__
        while rest is not None and not _is_users(rest.tb_frame):
            rest = rest.tb_next
        if rest is not None:
            return "".join(traceback.format_exception(type(error), error, rest))
        error = error.__cause__
    return ""


def _is_users(frame: FrameType) -> bool:
    """Return True if a frame runs code of a user's file, or of a module of its folder."""
    name = str(frame.f_globals.get("__name__", ""))
    return name.startswith(_USERS_MODULE) or any(name in each for each in _imported.values())


def file_digest(name: str) -> str:
    """Return the SHA-256 of `path/to/file.py:Class` and the files of its folder that it imports.

    It covers all files of the folder if a file computes what it imports. The result is "" for other
    names.
    """
    file, colon, _ = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        return ""
    folder = Path(file).resolve().parent
    sources: dict[Path, bytes] = {}
    left = {Path(file).resolve()}
    while left:
        path = left.pop()
        sources[path] = path.read_bytes()
        by_name = _IMPORTS_BY_NAME.search(sources[path])
        named = folder.glob("*.py") if by_name else _imports_of(path, sources[path], folder)
        left |= {each for each in named if each.is_file()} - set(sources)
    digest = hashlib.sha256()
    for path in sorted(sources):
        digest.update(sources[path])
    return digest.hexdigest()


def _imports_of(file: Path, source: bytes, folder: Path) -> set[Path]:
    """Return the files of a folder, if they exist, that a file's import statements name."""
    try:
        nodes = [*ast.walk(ast.parse(source))]
    except (SyntaxError, ValueError):  # its import may be guarded
        return set()
    found = set()
    for node in nodes:
        base, names = folder, []
        if isinstance(node, ast.Import):
            names = [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = [folder, *file.parents][min(node.level, len(file.parents))]
            names = [f"{node.module or ''}.{each.name}" for each in node.names]
        for parts in (name.strip(".").split(".") for name in names):
            paths = [base.joinpath(*parts[: k + 1]) for k in range(len(parts))]
            found |= {path.with_suffix(".py") for path in paths}
            found |= {path / "__init__.py" for path in paths}
    return found


def find_in(name: str, module: ModuleType, path: str) -> Any:
    """Return the attribute of a user's module at a path such as `Class`, called `name` in messages.

    Raises:
        ValueError: it does not exist; the message names the most similar.
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
    """Return the names of the public classes and functions that a module defines."""
    return [
        name
        for name, value in vars(module).items()
        if (inspect.isclass(value) or inspect.isfunction(value))
        and value.__module__ == module.__name__
        and not name.startswith("_")
    ]
