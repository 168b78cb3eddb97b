"""The cache of compiled kernels: an edit to any file that they come from makes it stale."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from swarm_envs.compiled import equation, kernel, part

PACKAGE = Path(__file__).parent.parent / "swarm_envs"
compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
MESSAGE = "swarm_envs: compiling kernels"
IMPORT = "from swarm_envs.compiled import announce_compilation, kernel\n"

# `outer` lies in one file, calls `inner` in another, and takes in a constant of a third, which a
# fourth passes on; `unused.py` is imported by no module with kernels.
FILES = {
    "__init__.py": "",
    "unused.py": "FIELDS = 3\n",
    "shape.py": "STEP = 1\n",
    "table.py": "from swarm_envs.shape import (  # a few (of many)\n    STEP as STEP,\n)\n",
    "motors.py": (
        f"{IMPORT}from swarm_envs import table\nSTEP = table.STEP\n\n"
        "@kernel\ndef inner(x):\n    return x + STEP\n"
    ),
    "physics/__init__.py": "",
    "physics/step.py": (
        f"{IMPORT}from swarm_envs.motors import inner\n\n"
        "@kernel\ndef outer(x):\n    return 2 * inner(x)\n\n"
        "def step(x):\n    announce_compilation(outer)\n    return outer(x)\n"
    ),
}
SCRIPT = """
from swarm_envs.physics.step import outer, step
print(step(3), step(3), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A small package of the same name, with the real module of compilation."""
    home = tmp_path / "swarm_envs"
    (home / "physics").mkdir(parents=True)
    for name, text in FILES.items():
        (home / name).write_text(text, encoding="utf-8")
    shutil.copy(PACKAGE / "compiled.py", home)
    return home


def start(package: Path, script: str = SCRIPT, **environment: str) -> subprocess.Popen[str]:
    inherited = {name: text for name, text in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=package.parent,
        env=inherited | {"PYTHONPATH": str(package.parent)} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str]) -> tuple[str, str]:
    printed, said = process.communicate()
    assert process.returncode == 0, said
    return printed.strip(), said


def run(package: Path, script: str = SCRIPT, **environment: str) -> tuple[str, str]:
    """Return what a script prints (two results and the number of cache hits), and its stderr."""
    return finish(start(package, script, **environment))


def kernels(package: Path, suffix: str = "nb[ci]") -> list[Path]:
    return sorted(package.rglob(f"*.{suffix}"))


def obstruct(*folders: Path) -> None:
    """Put files where folders would be made."""
    for folder in folders:
        folder.write_text("no folder can be made here", encoding="utf-8")


def test_a_kernel_that_is_compiled_after_one_that_was_kept_is_told(package: Path) -> None:
    """As when an engine flies for the first time, and all else has flown before."""
    run(package)
    step = package / "physics" / "step.py"
    other = step.with_name("other.py")
    other.write_text(step.read_text(encoding="utf-8").replace("2 *", "3 *"), encoding="utf-8")
    both = "from swarm_envs.physics import step, other\nprint(step.step(3), other.step(3))"
    result, said = run(package, script=both)
    assert result == "8 12"
    assert said.count(MESSAGE) == 1


def test_only_an_edit_to_a_file_that_a_kernel_comes_from_recompiles(package: Path) -> None:
    run(package)
    for name in FILES:
        os.utime(package / name, (1, 1))
    (package / "unused.py").write_text("FIELDS = 4\n", encoding="utf-8")
    assert run(package) == ("8 8 1", "")
    for edited, old, new, expected in (
        ("physics/step.py", "2 *", "20 *", 80),
        ("shape.py", "STEP = 1", "STEP = 10", 260),
    ):
        outer = [file for file in kernels(package) if file.name.startswith("step.outer")]
        source = package / edited
        source.write_text(source.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
        result, said = run(package)
        assert result == f"{expected} {expected} 0"
        assert said.count(MESSAGE) == 1
        assert run(package) == (f"{expected} {expected} 1", "")
        assert outer
        assert not any(file.exists() for file in outer)  # the stale ones do not pile up


def test_a_task_outside_the_package_is_known_by_its_own_file_and_its_imports(package, tmp_path):
    task = tmp_path / "task.py"
    task.write_text(
        f"{IMPORT}from swarm_envs.motors import inner\n"
        "@kernel\ndef reward(x):\n    return 5 * inner(x)\n",
        encoding="utf-8",
    )
    script = "from task import reward\nprint(reward(1), sum(reward.stats.cache_hits.values()))"
    assert run(package, script)[0] == "10 0"
    assert run(package, script)[0] == "10 1"
    (package / "shape.py").write_text("STEP = 10\n", encoding="utf-8")
    assert run(package, script)[0] == "55 0"


def test_the_settings_and_the_caches_of_others_are_left_alone(package, tmp_path):
    other = tmp_path / "other.py"
    other.write_text(
        "import numba\n@numba.njit(cache=True)\ndef half(x):\n    return x / 2\n", encoding="utf-8"
    )
    script = "import numba, swarm_envs.physics.step, other\nprint(other.half(2.0))\n"
    script += "print([numba.config.CACHE_DIR, numba.config.CACHE_LOCATOR_CLASSES])"
    assert run(package, script)[0] == "1.0\n['', '']"
    cached = kernels(tmp_path / "__pycache__")
    assert len(cached) == 2
    (package / "motors.py").write_text(FILES["motors.py"] + "\n# edited\n", encoding="utf-8")
    run(package)
    assert kernels(tmp_path / "__pycache__") == cached


def test_a_read_only_installation_caches_with_the_user(package: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    user = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    obstruct(package / "__pycache__")
    assert run(package, **user)[0] == "8 8 0"
    assert kernels(home)
    assert run(package, **user) == ("8 8 1", "")


def test_without_any_folder_for_a_cache_the_message_says_what_to_set(package, tmp_path):
    nowhere = tmp_path / "file"
    obstruct(package / "__pycache__", nowhere)
    user = {"HOME": str(nowhere), "XDG_CACHE_HOME": str(nowhere)}
    result, said = run(package, **user)
    assert result == "8 8 0"
    assert "in every process" in said
    assert "NUMBA_CACHE_DIR" in said
    assert "in every process" in run(package, **user)[1]
    user["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    run(package, **user)
    assert run(package, **user) == ("8 8 1", "")


def test_files_that_were_cut_short_are_compiled_again(package: Path) -> None:
    """As by a loss of power: a file may be shorter than was written, or hold zeros."""
    run(package)
    for suffix, zeros in (("nbc", 0), ("nbi", 100)):
        for file in kernels(package, suffix):
            file.write_bytes(file.read_bytes()[:100] + bytes(zeros))
        result, said = run(package)
        assert result == "8 8 0"
        assert said.count(MESSAGE) == said.count("\n") == 1
        assert run(package) == ("8 8 1", "")


@pytest.mark.slow
def test_processes_that_start_at_once_do_not_disturb_each_other(package: Path) -> None:
    together = [start(package) for _ in range(3)]
    assert {finish(process)[0][:3] for process in together} == {"8 8"}
    assert run(package)[0][:3] == "8 8"
    assert run(package) == ("8 8 1", "")


def test_without_compilation_the_kernel_is_plain_python(package: Path) -> None:
    script = "from swarm_envs.physics.step import step; print(step(3))"
    assert run(package, script, NUMBA_DISABLE_JIT="1") == ("8", "")
    assert not kernels(package)


@compiled_only
def test_division_by_zero_follows_ieee() -> None:
    @equation
    def ratio(a: float, b: float) -> float:
        return a / b

    @part
    def inverse(b: float) -> float:
        return 1.0 / b

    @kernel
    def divide(a: float, b: float) -> float:
        return ratio(a, b) + inverse(b) + a / b

    assert divide(1.0, 0.0) == float("inf")
    assert ratio(3.0, 2.0) == 1.5
    assert inverse(2.0) == 0.5


@compiled_only
def test_an_equation_becomes_part_of_the_loop_that_calls_it(monkeypatch, tmp_path):
    # What a cache holds cannot be inspected, so this kernel is always compiled.
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @equation
    def norm(x: float, y: float) -> tuple[float, float]:
        return np.sqrt(x * x + y * y), x / y

    @kernel
    def norms(x: np.ndarray, y: np.ndarray) -> None:
        for k in range(x.shape[0]):
            x[k], y[k] = norm(x[k], y[k])

    x, y = np.full(9, 3.0), np.full(9, 4.0)
    norms(x, y)
    assert (x.tolist(), y.tolist()) == ([5.0] * 9, [0.75] * 9)
    inspected: Any = norms
    code = "".join(inspected.inspect_asm().values())
    if "vsqrtsd" in code:  # this processor works on lanes, and so does the loop
        assert "vsqrtpd" in code


def _cached(folder: Path) -> dict[str, bytes]:
    """The files of machine code in a cache, with their bytes."""
    return {str(file): file.read_bytes() for file in kernels(folder)}


@pytest.mark.slow
@compiled_only
def test_after_compile_a_flight_compiles_nothing(tmp_path: Path) -> None:
    """`swarm-envs compile` into an empty cache: minutes; what is refused compiles nothing."""
    cache, out = tmp_path / "cache", str(tmp_path / "out")

    def command(*words: str) -> str:
        script = [sys.executable, "-m", "swarm_envs", *words]
        paths = {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(PACKAGE.parent)}
        done = subprocess.run(script, capture_output=True, text=True, env={**os.environ, **paths})
        assert done.returncode == (2 if "error:" in done.stderr else 0), done.stderr
        return done.stderr

    unfit = "--agent", "swap-ppo", "--drones", "7", "--out", out
    for name in ("fly", "evaluate"):
        said = command(name, *unfit)
        assert "trained for teams of 4 drones" in said
        assert MESSAGE not in said
        assert not _cached(cache)

    assert MESSAGE in command("compile", "--no-progress")
    compiled = _cached(cache)
    assert compiled
    flights = ("fly", "fly --task gates --world hall", "fly --agent swap-ppo --physics batch")
    for words in flights:
        assert MESSAGE not in command(*words.split(), "--out", out)
        assert _cached(cache) == compiled
