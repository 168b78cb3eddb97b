"""The page about deployment: its commands run in order, its C compiles."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from swarm_envs.cli import main
from tests.helpers.c_programs import COMPILER, STRICT, needs_compiler

PAGE = (Path(__file__).parents[2] / "docs" / "deploy.md").read_text(encoding="utf-8")


def blocks(kind: str) -> list[str]:
    """The page's blocks of code of a kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_commands_run_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    ours = [shlex.split(line)[1:] for line in lines if line.startswith("swarm-envs ")]
    assert len(ours) == 3
    for call in ours:
        assert main(call) == 0, call
    assert len(list(Path("real").glob("drone_?.csv"))) == 4
    assert Path("policy.h").is_file()


@needs_compiler
def test_its_c_compiles(tmp_path: Path) -> None:
    (block,) = blocks("c")
    for kind, file in (("force", "learned.h"), ("policy", "policy.h")):
        name = ["--policy", "swap-ppo"] if kind == "policy" else []
        assert main(["export", kind, *name, "--out", str(tmp_path / file)]) == 0
    (tmp_path / "app.c").write_text(block)
    command = [str(COMPILER), *STRICT, "-c", "app.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
