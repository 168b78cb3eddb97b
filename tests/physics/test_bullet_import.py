"""Without a working pybullet, messages say why, and the compiled engine flies."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

import pytest

from swarm_envs import swap_v1
from swarm_envs.physics.bullet import bullet_available, import_bullet


def check_fallback(message: str) -> None:
    """Bullet cannot be had, and the compiled twin flies by default."""
    assert not bullet_available()
    with pytest.raises(ImportError, match=message):
        import_bullet()
    with pytest.raises(ImportError, match=r"pybullet.*physics='batch'"):
        swap_v1.parallel_env(physics="bullet")
    env = swap_v1.parallel_env()
    assert env.physics_name == "batch"
    env.reset(seed=1)


def test_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    check_fallback(r"is not installed \(.*pip install pybullet.*physics='batch'")


def test_something_else_of_that_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", ModuleType("pybullet"))
    check_fallback(r"installed, but does not work \(.*'connect'")


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
    (tmp_path / "pybullet.py").write_text(f"raise {failure}\n", encoding="utf-8")
    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    cause = failure.split("'")[1]
    check_fallback(rf"is installed, but does not work \({cause}\)")
