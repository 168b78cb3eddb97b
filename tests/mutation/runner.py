"""Tests run on mutants, each in a fork of one process that has imported everything but ours.

A mutant is not written to disk: the fork compiles it in place of the file when that is imported.
Limits are of CPU time, so that a busy machine kills nobody.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

import pytest

_OURS = ("swarm_envs", "tests", "conftest", "__main__", "test_")
_OPTIONS = (
    *("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # plugins are imported before the fork
)
_MEMORY = 16 << 30  # address space of a fork, bytes: a mutant may ask for arrays of any size


@dataclass(frozen=True)
class Verdict:
    """How the tests ended."""

    status: str  # `passed`, `failed`, or `timeout`
    cpu_s: float  # CPU time of the run, s
    output: str  # what pytest printed


def run_tests(
    tests: tuple[str, ...], limit_s: int, mutant: tuple[str, str] | None = None
) -> Verdict:
    """Run tests in a fork until the first fails."""
    with tempfile.TemporaryFile() as log:
        child = os.fork()
        if not child:
            _become_tests(log.fileno(), tests, limit_s, mutant)
        _, status, usage = os.wait4(child, 0)
        log.seek(0)
        output = log.read().decode(errors="replace")
    cpu_s = usage.ru_utime + usage.ru_stime
    if os.WIFSIGNALED(status):
        stopped = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
        return Verdict("timeout" if stopped else "failed", cpu_s, output)
    return Verdict("failed" if os.WEXITSTATUS(status) else "passed", cpu_s, output)


def warm_up(tests: tuple[str, ...], limit_s: int = 600) -> float:
    """Import here what tests import that is not ours."""
    with tempfile.TemporaryDirectory() as folder:
        names = Path(folder) / "modules.json"
        os.environ["MUTATION_MODULES"] = str(names)
        run_tests(tests, limit_s)
        del os.environ["MUTATION_MODULES"]
        loaded = json.loads(names.read_text(encoding="utf-8")) if names.exists() else []
    for name in loaded:
        with suppress(Exception):  # some can only be imported by those who did
            importlib.import_module(name)
    verdict = run_tests(tests, limit_s)
    if verdict.status != "passed":
        raise RuntimeError(f"{tests} fail without a mutant:\n{verdict.output}")
    return verdict.cpu_s


def _become_tests(
    log: int, tests: tuple[str, ...], limit_s: int, mutant: tuple[str, str] | None
) -> None:
    status = 1
    try:
        os.dup2(log, 1)
        os.dup2(log, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s + 5))
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
        if mutant is not None:
            _import_instead(*mutant)
        status = int(pytest.main([*_OPTIONS, *tests]))
        names = os.environ.get("MUTATION_MODULES")
        if names is not None:
            others = [m for m in sys.modules if not m.startswith(_OURS)]
            Path(names).write_text(json.dumps(others), encoding="utf-8")
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _import_instead(file: str, source: str) -> None:
    original: Callable[..., CodeType | None] = SourceFileLoader.get_code
    place = os.path.realpath(file)

    def get_code(self: Any, fullname: str) -> CodeType | None:
        path = self.get_filename(fullname)
        if os.path.realpath(path) == place:
            return compile(source, path, "exec", dont_inherit=True)
        return original(self, fullname)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
