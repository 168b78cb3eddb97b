"""The cache of compiled kernels: an edit to any file with kernels makes it stale."""

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
from numba.core.caching import NullCache

from swarm_envs.compiled import borrowing_kernel, kernel

PACKAGE = Path(__file__).parent.parent / "swarm_envs"
MESSAGE = "swarm_envs: compiling kernels"

# `outer` lies in one file and calls `inner` in another; the package is told before its first call.
FILES = {
    "__init__.py": "",
    "state.py": "",
    "motors.py": (
        "from swarm_envs.compiled import kernel\n\n@kernel\ndef inner(x):\n    return x + 1\n"
    ),
    "physics/__init__.py": "",
    "physics/step.py": (
        "from swarm_envs.compiled import announce_compilation, kernel\n"
        "from swarm_envs.motors import inner\n\n"
        "@kernel\ndef outer(x):\n    return 2 * inner(x)\n\n"
        "def step(x):\n    announce_compilation(outer)\n    return outer(x)\n"
    ),
}
SCRIPT = """
from swarm_envs.physics.step import outer, step
print(step(3), step(3), sum(outer.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path):
    """A small package of the same name, with the real modules of compilation."""
    home = tmp_path / "swarm_envs"
    (home / "physics").mkdir(parents=True)
    for name, text in FILES.items():
        (home / name).write_text(text, encoding="utf-8")
    for name in ("borrowed.py", "compiled.py", "lowering.py"):
        shutil.copy(PACKAGE / name, home)
    return home


def run(package: Path, script: str = SCRIPT, **environment: str) -> tuple[str, str]:
    """What a script prints (two results and the number of cache hits), and its stderr."""
    inherited = {name: text for name, text in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=package.parent,
        env=inherited | {"PYTHONPATH": str(package.parent)} | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


def test_the_second_process_finds_the_kernel_and_says_nothing(package):
    first, said = run(package)
    assert first == "8 8 0"
    assert said.count(MESSAGE) == 1
    assert run(package) == ("8 8 1", "")


def test_a_kernel_that_is_compiled_after_one_that_was_kept_is_told(package):
    """As when an engine flies for the first time, and all else has flown before."""
    run(package)
    step = package / "physics" / "step.py"
    other = step.with_name("other.py")
    other.write_text(step.read_text(encoding="utf-8").replace("2 *", "3 *"), encoding="utf-8")
    both = "from swarm_envs.physics import step, other\nprint(step.step(3), other.step(3))"
    result, said = run(package, script=both)
    assert result == "8 12"
    assert said.count(MESSAGE) == 1


@pytest.mark.parametrize("edited", ["motors.py", "physics/step.py"])
def test_an_edit_to_either_file_recompiles(package, edited):
    run(package)
    source = package / edited
    text = source.read_text(encoding="utf-8").replace("x + 1", "x + 10").replace("2 *", "20 *")
    source.write_text(text, encoding="utf-8")  # of another size, or Python keeps its own bytecode
    expected = 2 * (3 + 10) if edited == "motors.py" else 20 * (3 + 1)
    result, said = run(package)
    assert result == f"{expected} {expected} 0"
    assert said.count(MESSAGE) == 1


def test_an_edit_to_another_module_of_the_base_recompiles(package):
    run(package)
    (package / "state.py").write_text("FIELDS = 3\n", encoding="utf-8")
    assert run(package)[0] == "8 8 0"


def test_a_read_only_installation_caches_with_the_user(package, tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    user = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    for folder in (package, package / "physics"):
        (folder / "__pycache__").write_text("no folder can be made here", encoding="utf-8")
    assert run(package, **user)[0] == "8 8 0"
    assert list(home.rglob("*.nbi"))
    assert run(package, **user) == ("8 8 1", "")


@pytest.mark.parametrize("suffix", ["nbc", "nbi"])
@pytest.mark.parametrize("size", [0, 100])
def test_a_damaged_cache_is_compiled_again_and_overwritten(package, suffix, size):
    run(package)
    files = list(package.rglob(f"*.{suffix}"))
    assert files
    for file in files:
        file.write_bytes(file.read_bytes()[:size])
    result, said = run(package)
    assert result == "8 8 0"
    assert said.count("\n") == 1
    assert ("cached kernel cannot be read" if suffix == "nbc" else MESSAGE) in said
    assert run(package) == ("8 8 1", "")


def test_without_any_folder_for_a_cache_the_message_says_what_to_set(package, tmp_path):
    nowhere = tmp_path / "file"
    for file in (package / "__pycache__", package / "physics" / "__pycache__", nowhere):
        file.write_text("no folder can be made here", encoding="utf-8")
    user = {"HOME": str(nowhere), "XDG_CACHE_HOME": str(nowhere)}
    for _ in range(2):
        result, said = run(package, **user)
        assert result == "8 8 0"
        assert "in every process" in said
        assert "NUMBA_CACHE_DIR" in said
    user["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
    run(package, **user)
    assert run(package, **user) == ("8 8 1", "")


def test_without_compilation_the_kernel_is_plain_python(package):
    script = "from swarm_envs.physics.step import step; print(step(3))"
    assert run(package, script, NUMBA_DISABLE_JIT="1") == ("8", "")


def test_division_by_zero_follows_ieee():
    @kernel
    def divide(a: float, b: float) -> float:
        return a / b

    assert divide(1.0, 0.0) == float("inf")


def test_a_borrowing_kernel_that_makes_an_array_is_refused():
    @borrowing_kernel
    def total(x: np.ndarray) -> float:
        return (2.0 * x).sum()

    with pytest.raises(numba.core.errors.NumbaError, match="NRT"):
        total(np.ones(3))


def test_a_borrowing_kernel_counts_no_references():
    @borrowing_kernel
    def fill(x: np.ndarray) -> None:
        row = x[1]
        for k in range(row.shape[0]):
            row[k] = k

    dispatcher: Any = fill
    dispatcher._cache = NullCache()  # code that was read from the disk cannot be looked at
    array = np.zeros((2, 3))
    fill(array)
    assert array.tolist() == [[0, 0, 0], [0, 1, 2]]
    code = dispatcher.inspect_llvm(dispatcher.signatures[0])
    assert "NRT_incref" not in code.split("define", 2)[1]
