"""Compilation of the inner loops with numba: decorators, a cache on disk and one message.

Numba ties a cached kernel to the one file that defines it. Our kernels call each other across
files and freeze each other's constants, so each module's kernels are cached in a folder whose name
carries a hash of every file that the module imports, directly or not, from this package. An edit to
any of them leads to another folder, hence to a compilation.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import json
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

__all__ = ["announce_compilation", "compilation", "equation", "kernel", "kernel_folder", "part"]

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent
_VERSIONS = f"{numba.__version__} {np.__version__} {sys.version}"
_IMPORT = re.compile(
    rb"^(?:from (swarm_envs[\w.]*) import (\([^)]*\)|[^\n]*)|import (swarm_envs[\w.]*))", re.M
)
_COMMENT = re.compile(rb"#.*")
_UNSAFE = re.compile(r"[^\w.]")  # in the name of a file
_NO_BRACKETS = re.compile("[<>]")
_KERNELS = "*/*.nb[ci]"  # numba's files of machine code, and their indexes
_DIGESTS = "digests.json"
_DAY = 86400.0  # s
_PATIENCE_S = 120.0
_folders: set[Path] = set()  # Folders of the kernels of this process's modules


def kernel(function: F) -> F:
    """Compile a function to machine code at its first call and keep the result on disk.

    Division by zero follows IEEE arithmetic. Sums are not reordered, so the same input gives the
    same bytes on the same machine. Called from Python, a kernel lets other threads run meanwhile.
    """
    if numba.config.DISABLE_JIT:
        silent: F = np.errstate(all="ignore")(function)  # as in machine code: integers wrap around
        return silent
    folder = _folder(function)
    settings = {"CACHE_DIR": str(folder), "CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    before = {name: getattr(numba.config, name, "") for name in settings}
    decorate = partial(numba.njit, error_model="numpy", nogil=True, no_cfunc_wrapper=True)
    try:
        for name, value in settings.items():  # numba reads them while it decorates
            setattr(numba.config, name, value)
        compiled: F = decorate(cache=folder is not None)(function)
    except RuntimeError:  # numba cannot write there: it compiles in each process
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
    """A function that kernels call; from Python it stays as it is, and is interpreted.

    It is compiled with the kernel that calls it, and kept on disk as a piece of that. A kernel that
    only other kernels call costs more to compile: an entry point for Python, and a file of its own.

    Args:
        function: what to compile; leave it out to pass an option, as `@part(fastmath=...)`.
        fastmath: the freedoms of LLVM's floating-point arithmetic, such as `{"contract"}`.
    """
    if function is None:
        return lambda decorated: _within_kernels(decorated, fastmath=fastmath)
    return _within_kernels(function)


def equation(function: F) -> F:
    """A function that becomes part of the kernel that calls it; from Python it stays as it is.

    That is for what loops over lanes call, before LLVM looks for operations that several lanes can
    do at once: a call that remained would prevent that. And for what takes tuples of many arrays,
    which a call would copy.
    """
    return _within_kernels(function, forceinline=True)


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
    """Say on stderr, once a process, that the first call of an uncached kernel takes a while.

    Without a folder for the cache it is so in every process, and the message says how to end that.

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
            ", in every process, because no folder to keep them in can be written; "
            "set NUMBA_CACHE_DIR to one that can"
        )
    elif not any(folder.glob(f"*/*.{_NO_BRACKETS.sub('', function.__qualname__)}-*.nbi")):
        when = ", once after an installation or an edit"
    else:
        return
    _announced = True
    sys.stderr.write(f"swarm_envs: compiling kernels (10 to 30 s){when} ...\n")
    sys.stderr.flush()


@contextmanager
def compilation(kernels: int) -> Iterator[None]:
    """Show one progress bar if `entry_point` needs more than two seconds for so many kernels."""
    global _bar
    before = _bar
    with tqdm(total=kernels, unit="kernel", delay=2.0) as _bar:
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
    """Folder for the cached kernels of the module that defines a function, if there can be one."""
    base = kernel_folder()
    file = Path(function.__code__.co_filename)
    if base is None or not file.is_file():  # such as a function that was typed at a prompt
        return None
    return _prepared(base, function.__module__, file.absolute())


def kernel_folder() -> Path | None:
    """Folder that holds the kernels of all modules; None where none can be written."""
    return _base(str(numba.config.CACHE_DIR or ""))


@cache
def _base(chosen: str) -> Path | None:
    """Folder for all kernels: the chosen one, else one in the package, else one of the user's."""
    places = [Path(chosen).absolute()] if chosen else []
    places.append(_PACKAGE / "__pycache__" / "kernels")
    with suppress(RuntimeError):  # the user may have no home
        home = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_CACHE_HOME")
        places.append((Path(home) if home else Path.home() / ".cache") / "swarm_envs")
    return next((place for place in places if _can_write(place)), None)


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"a full disk, or a limit, lets files be made and not written")
    except OSError:
        return False
    return True


@cache
def _prepared(base: Path, module: str, file: Path) -> Path | None:
    """Make the folder and empty those of older sources, or check what the folder holds."""
    content = hashlib.sha256()
    try:
        for source in sorted(_sources(file)):
            content.update(_read(source)[0])
    except OSError:  # without the sources nobody knows whether they have changed
        return None
    place = hashlib.sha256(f"{_VERSIONS} {file}".encode()).hexdigest()[:8]
    name = f"{_UNSAFE.sub('_', module)}-{place}"
    folder = base / f"{name}-{content.hexdigest()[:16]}"
    new = not folder.exists()
    if not _can_write(folder):
        return None
    if new:
        for other in set(base.glob(f"{name}-*")) - {folder}:
            _empty(other)
    else:
        _check(folder)
    _folders.add(folder)
    return folder


def _empty(folder: Path) -> None:
    """Remove the kernels of older sources.

    The folder itself stays for a day: a process that began before an edit may be writing into it.
    """
    with suppress(OSError):
        if time.time() - folder.stat().st_mtime > _DAY:
            shutil.rmtree(folder)
    for file in folder.glob(_KERNELS):
        with suppress(OSError):
            file.unlink()


def _sources(file: Path) -> set[Path]:
    """The file and every file of the package that its imports reach."""
    found, ahead = {file}, {file}
    while ahead:
        ahead = set().union(*(_read(source)[1] for source in ahead)) - found
        found |= ahead
    return found


@cache
def _read(file: Path) -> tuple[bytes, frozenset[Path]]:
    """Digest of a source file, and the files that its imports at module level name.

    Imports in functions or under `if TYPE_CHECKING` are indented: they bring in no constants.
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
    """File of a module of the package by its full name."""
    stem = _PACKAGE.joinpath(*name.split(".")[1:])
    files = (stem.with_name(f"{stem.name}.py"), stem / "__init__.py")
    return next((file for file in files if file.is_file()), None)


# ---- Damage: numba would run a cached kernel of which a byte has changed


def _check(folder: Path) -> None:
    """Remove the kernels that are not as they were recorded, so that numba compiles them again.

    What is not recorded is trusted unless it is cut short, as by a loss of power: a running process
    has just written it, or has been killed since. What another process has just written once more
    is removed as well; that costs a compilation.
    """
    recorded: dict[str, str] = {}
    with suppress(OSError, ValueError):
        recorded = dict(json.loads((folder / _DIGESTS).read_text(encoding="utf-8")))
    for file in folder.glob(_KERNELS):
        with suppress(OSError):
            digest = _digest(file)
            if not _whole(file) or recorded.get(file.name, digest) != digest:
                index = file.with_suffix("").with_suffix(".nbi") if file.suffix == ".nbc" else file
                index.unlink(missing_ok=True)  # so that the compilation is announced
                file.unlink(missing_ok=True)
    _record(folder)


def _whole(file: Path) -> bool:
    """Whether a file ends as numba's do, which are pickles: an empty one, or zeros, do not."""
    return file.read_bytes()[-1:] == b"."  # the opcode STOP


def _record(folder: Path) -> None:
    """Write the digests of a folder's kernels, whichever process has compiled them."""
    digests = {}
    for file in folder.glob(_KERNELS):
        with suppress(OSError):
            digests[file.name] = _digest(file)
    text = json.dumps(digests, indent=1, sort_keys=True)
    target = folder / _DIGESTS
    with suppress(OSError):
        if digests and not (target.exists() and target.read_text(encoding="utf-8") == text):
            written = folder / f"{_DIGESTS}.{os.getpid()}"
            written.write_text(text, encoding="utf-8")
            written.replace(target)


@atexit.register
def _record_all() -> None:
    """Write the digests of what this process may have compiled."""
    for folder in _folders:
        _record(folder)


def _digest(file: Path) -> str:
    status = file.stat()
    return _digest_of(file, status.st_size, status.st_mtime_ns)


@cache
def _digest_of(file: Path, size: int, written_ns: int) -> str:  # read again once it has changed
    return hashlib.sha256(file.read_bytes()).hexdigest()


def entry_point(compiled: F, *arguments: object) -> F:
    """Compile a kernel for the types of these arguments, and return what to call directly.

    A kernel looks up the types of its arguments at every call, which takes microseconds where they
    are many. What is returned here does not: it must only be called with arguments of the same
    types.
    """
    announce_compilation(compiled)
    if _bar is not None:
        _bar.set_description_str(f"compiling {compiled.__name__}", refresh=False)
    if numba.config.DISABLE_JIT:
        return compiled
    dispatcher: Any = compiled
    signature = tuple(map(_type_of, arguments))
    if signature in dispatcher.signatures:
        entry: F = dispatcher.compile(signature)  # which only looks it up
    else:
        collects = gc.isenabled()
        with _alone_in(_folder(dispatcher.py_func)):
            gc.disable()  # compilation makes little garbage; looking for it takes an eighth of it
            try:
                entry = dispatcher.compile(signature)
            finally:
                if collects:
                    gc.enable()
    if _bar is not None:
        _bar.update()
    return entry


def _type_of(argument: object) -> Any:
    """`numba.typeof`; that of arrays of records takes a millisecond, and is kept."""
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
    """Compile while no other process compiles a kernel of the same module, and record the result.

    Of two at once numba may write one's machine code under the other's signature. The second finds
    what the first has compiled. One that waits too long, or cannot lock, compiles all the same.
    """
    with ExitStack() as stack:
        if folder is not None and fcntl is not None:
            with suppress(OSError):
                file = stack.enter_context((folder / "lock").open("a"))
                until = time.monotonic() + _PATIENCE_S
                while time.monotonic() < until and not _locked(file):
                    time.sleep(0.02)
        yield
        # Now, as a process that begins before this one ends would take the new index for damaged.
        _record_all()


def _locked(file: IO[str]) -> bool:
    """Whether this process has the lock of a file, or has got it now; it ends with the file."""
    with suppress(BlockingIOError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
