"""Compilation of the inner loops with numba: one decorator, one cache, one message.

The cache lies beside the modules, or in the user's cache directory when the installation is
read-only. Numba ties a cached kernel to the one file that defines it; ours call each other across
files and freeze each other's constants, so `kernel` ties them to every file that a kernel may come
from, and an edit to any recompiles.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import FunctionCache, IndexDataCacheFile

from swarm_envs import borrowed
from swarm_envs.lowering import whole_and_part

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent
_CORE_FOLDERS = ("physics", "interactions", "control", "envs", "tasks")
_COMMANDS = ("cli.py", "__main__.py")
_USES_KERNELS = b"from swarm_envs.compiled import"


def _kernel_sources() -> list[Path]:
    """Files that hold kernels, or constants that kernels have taken in."""
    files = sorted(file for file in _PACKAGE.glob("*.py") if file.name not in _COMMANDS)
    for folder in _CORE_FOLDERS:
        files += sorted((_PACKAGE / folder).rglob("*.py"))
    others = sorted(f for name in ("agents", "baselines") for f in (_PACKAGE / name).rglob("*.py"))
    return files + [file for file in others if _USES_KERNELS in file.read_bytes()]


@cache
def _sources_stamp() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for file in _kernel_sources():
        digest.update(file.read_bytes())
    return digest.hexdigest()


class _CacheFile(IndexDataCacheFile):  # type: ignore[misc]  # numba is untyped
    """The files of one kernel's cache: an index that cannot be read counts as empty."""

    def _load_index(self) -> dict[Any, str]:
        try:
            index: dict[Any, str] = super()._load_index()
        except Exception:  # cut short or overwritten, a pickle fails in any way
            return {}
        return index


class _KernelCache(FunctionCache):  # type: ignore[misc]  # numba is untyped
    """Numba's on-disk cache, stale as soon as any file with kernels has changed.

    That is any of this package, and the file of the kernel itself where it lies elsewhere.
    A file of it that a full disk or a killed process has cut short is compiled anew.
    """

    def __init__(self, py_func: Callable[..., Any]) -> None:
        super().__init__(py_func)
        stamp: Any = _sources_stamp()
        if not Path(py_func.__code__.co_filename).is_relative_to(_PACKAGE):
            stamp = stamp, self._impl.locator.get_source_stamp()
        self._cache_file = _CacheFile(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled version for a signature, or None if there is none that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:
            _report_damage(repr(error))
            return None

    def holds_anything(self) -> bool:
        """Whether a compiled version of the function, of the current sources, is on disk."""
        return bool(self._cache_file._load_index())


@cache
def _report_damage(cause: str) -> None:
    _say(f"a cached kernel cannot be read ({cause}); compiling it again ...")


def _say(message: str) -> None:
    sys.stderr.write(f"swarm_envs: {message}\n")
    sys.stderr.flush()


def kernel(function: F) -> F:
    """Compile a function to machine code at its first call and keep the result on disk.

    Division by zero follows IEEE arithmetic; sums are never reordered, so the same input gives the
    same bytes on the same machine.
    """
    return _cached(function)


def borrowing_kernel(function: F) -> F:
    """A kernel that makes no array and returns none: it does not count references.

    Elsewhere a call counts a reference to every array that its arguments hold, in and out, each an
    atomic operation: a third of a microsecond where they are sixty. Whatever makes an array is
    refused when it is compiled. To return one would free it twice. Called from Python, it lets
    other threads run meanwhile.
    """
    return _cached(function, _nrt=False, nogil=True)


def _cached(function: F, **options: Any) -> F:
    if numba.config.DISABLE_JIT:
        silent: F = np.errstate(all="ignore")(function)  # as in machine code: integers wrap around
        return silent
    options |= {"no_cfunc_wrapper": True}
    options |= {"error_model": "numpy"}
    if borrowed.SUPPORTED:
        dispatcher = whole_and_part(function, **options)
    else:
        dispatcher = numba.njit(**options)(function)
    with suppress(RuntimeError):  # no writable folder for a cache: compile in each process
        dispatcher._cache = _KernelCache(function)
    compiled: F = dispatcher
    return compiled


def entry_point(compiled: F, *arguments: object) -> F:
    """Compile a kernel for the types of these arguments, and return what to call directly.

    A kernel looks up the types of its arguments at every call, which takes 20 us where there are
    sixty arrays. What is returned here does not: it must only be called with arguments of the very
    same types. Named tuples that stay are better lent (`swarm_envs.borrowed.lend`), once for all.
    """
    announce_compilation(compiled)
    if numba.config.DISABLE_JIT:
        return compiled
    dispatcher: Any = compiled
    entry: F = dispatcher.compile(tuple(numba.typeof(argument) for argument in arguments))
    return entry


_announced = False


def announce_compilation(entry: Any) -> None:
    """Say on stderr, once a process, that the first call of an uncached kernel takes a while.

    Without a folder for the cache it is so in every process, and the message says how to end that.
    """
    global _announced
    if _announced or numba.config.DISABLE_JIT or entry.signatures:
        return
    if not isinstance(entry._cache, _KernelCache):
        _say(
            "compiling kernels (5 to 40 s), in every process, because no folder to keep them in "
            "can be written; set NUMBA_CACHE_DIR to one that can ..."
        )
    elif not entry._cache.holds_anything():
        _say("compiling kernels, once after installation (5 to 40 s) ...")
    else:
        return
    _announced = True
