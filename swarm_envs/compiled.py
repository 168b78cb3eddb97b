"""Compilation of the inner loops with Numba: decorators, and a cache on disk.

Numba invalidates a cached kernel only if the file that defines it changes. Our kernels call each
other across files and contain each other's constants. Each module's kernels are therefore cached in
a folder whose name contains a hash of all files of this package that the module imports, directly
or indirectly; an edit of any of them leads to another folder and a compilation.
"""

from __future__ import annotations

import gc
import hashlib
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import IO, Any, TypeVar, overload

import numba
import numpy as np
from numba.extending import register_jitable
from tqdm import tqdm

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

__all__ = [
    "announce_compilation",
    "compilation",
    "equation",
    "inlined",
    "kernel",
    "kernel_folder",
    "part",
]

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent
_VERSIONS = f"{numba.__version__} {np.__version__} {sys.version}"
_IMPORT = re.compile(
    rb"^(?:from (swarm_envs[\w.]*) import (\([^)]*\)|[^\n]*)|import (swarm_envs[\w.]*))", re.M
)
_COMMENT = re.compile(rb"#.*")
_UNSAFE = re.compile(r"[^\w.]")  # Characters that are not used in file names
_NO_BRACKETS = re.compile("[<>]")
_KERNELS = "*/*.nb[ci]"  # Numba's files of machine code, and their indexes
_END_OF_PICKLE = b"."  # The opcode STOP, with which Numba's files end
_PATIENCE_S = 120.0


def kernel(function: F) -> F:
    """Compile a function to machine code at its first call, cached on disk.

    Division by zero follows IEEE arithmetic. Sums are not reordered, so that equal inputs give
    bitwise equal results on one machine. A kernel called from Python releases the GIL.
    """
    if numba.config.DISABLE_JIT:
        silent: F = np.errstate(all="ignore")(function)  # no warnings, as in machine code
        return silent
    folder = _folder(function)
    settings = {"CACHE_DIR": str(folder), "CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    before = {name: getattr(numba.config, name, "") for name in settings}
    decorate = partial(numba.njit, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
    try:
        for name, value in settings.items():  # Numba reads them in the decorator
            setattr(numba.config, name, value)
        compiled: F = decorate(cache=folder is not None)(function)
    except RuntimeError:  # the folder is not writable: compile in each process
        compiled = decorate()(function)
    finally:
        for name, value in before.items():
            setattr(numba.config, name, value)
    return compiled


@overload
def part(function: F) -> F: ...
@overload
def part(*, fastmath: bool | set[str] = False) -> Callable[[F], F]: ...
def part(function: Any = None, *, fastmath: bool | set[str] = False) -> Any:
    """Decorate a function that kernels call; Python calls run the undecorated function.

    It is compiled and cached with the kernel that calls it. A `kernel` in its place would take
    longer to compile, since it also has an entry point for Python and its own file.

    Args:
        function: the function; leave it out to pass an option, as in `@part(fastmath=...)`.
        fastmath: options of LLVM's floating-point arithmetic, such as `{"contract"}`.
    """
    if function is None:
        return lambda decorated: _within_kernels(decorated, fastmath=fastmath)
    return _within_kernels(function)


def equation(function: F) -> F:
    """Decorate a function that is inlined into the kernel; Python calls run it undecorated.

    It is for functions that are called in loops over lanes, since a remaining call prevents
    vectorization, and for functions with tuples of many arrays, which a call would copy.
    """
    return _within_kernels(function, forceinline=True)


def inlined(function: F) -> F:
    """Decorate a long function with few callers: Numba copies its statements into them.

    Numba optimizes a called function again with each of its callers, so that in a chain of calls
    most of the compilation is spent on the same code. An argument that is None must be one of the
    caller too: only then are the branches of what is None left out.
    """
    if numba.config.DISABLE_JIT:
        return function
    compiled: F = numba.njit(inline="always", error_model="numpy")(function)
    return compiled


def _within_kernels(function: F, **options: Any) -> F:
    if numba.config.DISABLE_JIT:
        return function
    # Only kernels call the compiled version: entry points for C and Python would be left unused.
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": True}
    compiled: F = register_jitable(error_model="numpy", **options)(function)
    return compiled


_announced = False
_bar: Any = None  # The progress bar of the innermost `compilation`


def announce_compilation(entry: Callable[..., Any]) -> None:
    """Write to stderr, once per process, that the first call of an uncached kernel takes time.

    Args:
        entry: the kernel that is about to be called.
    """
    global _announced
    dispatcher: Any = entry
    if _announced or numba.config.DISABLE_JIT or dispatcher.signatures:
        return
    function = dispatcher.py_func
    folder = _folder(function)
    if folder is None:
        when = (
            ", in every process, because no folder for the cache is writable; "
            "set NUMBA_CACHE_DIR to a writable folder"
        )
    elif not any(folder.glob(f"*/*.{_NO_BRACKETS.sub('', function.__qualname__)}-*.nbi")):
        when = " of a feature, once; `swarm-envs compile` compiles all"
    else:
        return
    _announced = True
    sys.stderr.write(f"swarm_envs: compiling kernels (10 to 60 s){when} ...\n")
    sys.stderr.flush()


@contextmanager
def compilation(kernels: int) -> Iterator[None]:
    """Show a progress bar if `entry_point` takes more than two seconds for a number of kernels."""
    global _bar
    before = _bar
    form = "{l_bar}{bar}| {n_fmt}/{total_fmt} kernels, {elapsed}"  # no estimate: times differ
    with tqdm(total=kernels, bar_format=form, delay=2.0) as _bar:
        timer = threading.Timer(2.0, _bar.refresh)
        timer.start()
        try:
            yield
            _bar.set_description_str("compiled kernels", refresh=False)
        finally:
            timer.cancel()
            _bar = before


# ---- The folder of a module's kernels


def _folder(function: Callable[..., Any]) -> Path | None:
    """Return the cache folder of the module that defines a function, or None."""
    base = kernel_folder()
    file = Path(function.__code__.co_filename)
    if base is None or not file.is_file():  # such as a function defined at a prompt
        return None
    return _prepared(base, function.__module__, file.absolute())


def kernel_folder() -> Path | None:
    """Return the folder of the kernels of all modules; None if no folder is writable."""
    return _base(str(numba.config.CACHE_DIR or ""))


@cache
def _base(chosen: str) -> Path | None:
    """Return the first writable folder: the chosen one, one in the package, or the user's."""
    folders = [Path(chosen).absolute()] if chosen else []
    folders.append(_PACKAGE / "__pycache__" / "kernels")
    with suppress(RuntimeError):  # the user may have no home
        home = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME")
        folders.append((Path(home) if home else Path.home() / ".cache") / "swarm_envs")
    return next(filter(_can_write, folders), None)


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"on a full disk, files can be created but not written")
    except OSError:
        return False
    return True


@cache
def _prepared(base: Path, module: str, file: Path) -> Path | None:
    """Create the folder and remove those of older sources, or check the kernels in the folder."""
    content = hashlib.sha256()
    try:
        for source in sorted(_sources(file)):
            content.update(_read(source)[0])
    except OSError:  # without the sources, changes cannot be detected
        return None
    origin = hashlib.sha256(f"{_VERSIONS} {file}".encode()).hexdigest()[:8]
    name = f"{_UNSAFE.sub('_', module)}-{origin}"
    folder = base / f"{name}-{content.hexdigest()[:16]}"
    new = not folder.exists()
    if not _can_write(folder):
        return None
    if new:
        for other in set(base.glob(f"{name}-*")) - {folder}:
            shutil.rmtree(other, ignore_errors=True)
    else:
        _check(folder)
    return folder


def _sources(file: Path) -> set[Path]:
    """Return a file and all files of the package that it imports, directly or indirectly."""
    found, ahead = {file}, {file}
    while ahead:
        ahead = set().union(*(_read(source)[1] for source in ahead)) - found
        found |= ahead
    return found


@cache
def _read(file: Path) -> tuple[bytes, frozenset[Path]]:
    """Return the digest of a source file, and the files that it imports at module level.

    Imports in functions or under `if TYPE_CHECKING`, which are indented, import no constants.
    """
    text = file.read_bytes()
    imported: set[Path | None] = set()
    for module, names, plain in _IMPORT.findall(_COMMENT.sub(b"", text)):
        listed = re.findall(r"\w+", re.sub(r" as \w+", "", names.decode()))
        parts = {_module(f"{module.decode()}.{name}") for name in listed}
        if not parts or None in parts:  # else only modules are imported from a package
            parts.add(_module((module or plain).decode()))
        imported |= parts
    return hashlib.sha256(text).digest(), frozenset(filter(None, imported))


@cache
def _module(name: str) -> Path | None:
    """Return the file of a module of the package by its full name, or None."""
    stem = _PACKAGE.joinpath(*name.split(".")[1:])
    files = (stem.with_name(f"{stem.name}.py"), stem / "__init__.py")
    return next((file for file in files if file.is_file()), None)


# ---- Files that were cut short: Numba does not check the machine code that it loads


def _check(folder: Path) -> None:
    """Remove kernels that were cut short, as by a loss of power; they are compiled again."""
    for file in folder.glob(_KERNELS):
        with suppress(OSError):
            if file.read_bytes()[-1:] != _END_OF_PICKLE:
                index = file.with_suffix("").with_suffix(".nbi") if file.suffix == ".nbc" else file
                index.unlink(missing_ok=True)  # so that the compilation is announced
                file.unlink(missing_ok=True)


def entry_point(compiled: F, *arguments: object) -> F:
    """Compile a kernel for the types of these arguments, and return its entry point.

    A kernel looks up the types of its arguments at every call, which takes microseconds if there
    are many. The entry point does not: it must only be called with arguments of the same types.
    """
    announce_compilation(compiled)
    if _bar is not None:
        _bar.set_description_str(f"compiling {compiled.__name__}", refresh=False)
        _bar.update()  # the number of the kernel that is being compiled
    if numba.config.DISABLE_JIT:
        return compiled
    dispatcher: Any = compiled
    signature = tuple(map(_type_of, arguments))
    if signature in dispatcher.signatures:
        entry: F = dispatcher.compile(signature)  # only looks it up
    else:
        collects = gc.isenabled()
        with _alone_in(_folder(dispatcher.py_func)):
            gc.disable()  # garbage collection takes an eighth of the time, and finds little
            try:
                entry = dispatcher.compile(signature)
            finally:
                if collects:
                    gc.enable()
    return entry


def _type_of(argument: object) -> Any:
    """Return `numba.typeof`, cached for arrays, since it takes a millisecond for records."""
    if not isinstance(argument, np.ndarray):
        return numba.typeof(argument)
    flags = argument.flags
    layout = flags.c_contiguous, flags.f_contiguous, flags.writeable, flags.aligned
    kind = type(argument), argument.dtype, argument.ndim, layout
    if kind not in _array_types:
        _array_types[kind] = numba.typeof(argument)
    return _array_types[kind]


_array_types: dict[object, Any] = {}


@contextmanager
def _alone_in(folder: Path | None) -> Iterator[None]:
    """Lock a module's folder during a compilation.

    If two processes compile at once, Numba may write the machine code of one under the signature of
    the other. With the lock, the second process finds the kernel of the first. A process that waits
    too long, or cannot lock, compiles without the lock.
    """
    with ExitStack() as stack:
        if folder is not None and fcntl is not None:
            with suppress(OSError):
                file = stack.enter_context((folder / "lock").open("a"))
                until = time.monotonic() + _PATIENCE_S
                while time.monotonic() < until and not _locked(file):
                    time.sleep(0.02)
        yield


def _locked(file: IO[str]) -> bool:
    """Return True if this process holds the lock of a file, which ends when the file is closed."""
    with suppress(BlockingIOError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
