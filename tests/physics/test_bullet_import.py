"""What is said, and what flies, where pybullet is missing or broken."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from swarm_envs.physics.bullet import bullet_available, import_bullet

ROOT = Path(__file__).parents[2]
SCRIPT = """
from swarm_envs.envs.config import EnvConfig
print(EnvConfig().engine)
"""


def test_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    assert not bullet_available()
    with pytest.raises(ImportError, match=r"is not installed \(.*pybullet.*physics='batch'"):
        import_bullet()


def test_something_else_of_that_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", ModuleType("pybullet"))
    assert not bullet_available()
    with pytest.raises(ImportError, match=r"installed, but does not work \(.*'connect'"):
        import_bullet()


@pytest.mark.parametrize(
    "failure",
    [
        "ImportError('libbullet.so: undefined symbol')",
        "ModuleNotFoundError('No module named gone', name='gone')",
        "OSError('wrong ELF class')",
        "SystemError('built for another numpy')",
    ],
)
def test_broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, failure: str) -> None:
    (tmp_path / "pybullet").mkdir()
    (tmp_path / "pybullet" / "__init__.py").write_text(f"raise {failure}\n", encoding="utf-8")
    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    assert not bullet_available()
    cause = failure.split("'")[1]
    with pytest.raises(ImportError, match=rf"is installed, but does not work \({cause}\)"):
        import_bullet()


def test_the_compiled_twin_flies_where_pybullet_is_broken(tmp_path: Path) -> None:
    (tmp_path / "pybullet.py").write_text("raise ImportError('no such symbol')", encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "batch\n"
