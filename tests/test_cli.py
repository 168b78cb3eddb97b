"""The command `swarm-envs`: its commands, its help, its exit codes."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import swarm_envs
from swarm_envs.cli import COMMANDS, main


def test_no_command_and_help_list_every_command(capsys):
    assert main([]) == 2
    assert main(["--help"]) == 0
    listed = capsys.readouterr().out
    assert all(listed.count(f"\n  {name} ") == 2 for name in COMMANDS)


def test_the_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"swarm-envs {swarm_envs.__version__}\n"


def test_the_program_exits_with_the_command_s_code():
    script = [sys.executable, "-m", "swarm_envs.cli", "dmeo"]
    done = subprocess.run(script, capture_output=True, text=True)
    assert done.returncode == 2
    assert "unknown command 'dmeo'; did you mean 'demo'?" in done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_help_explains_every_option(name, capsys):
    if name in ("fit", "collect"):
        pytest.importorskip("torch")
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert "--seed" in text
    assert "--out" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--swap", "3"], "--swaps"),
        (["--swaps", "many"], "many"),
        (["--seed", "-3"], "--seed is -3, but must be 0 or more"),
        (["--swaps", "0"], "--swaps is 0, but must be from 1 to 1000"),
    ],
)
def test_bad_options_are_explained_with_exit_code_2(arguments, said, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "120")
    with pytest.raises(SystemExit) as end:
        main(["demo", "--out", str(tmp_path / "out"), *arguments])
    assert end.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_written_is_a_failure(capsys, tmp_path):
    (tmp_path / "file").touch()
    assert main(["demo", "--out", str(tmp_path / "file")]) == 1
    assert "swarm-envs demo: error:" in capsys.readouterr().err


def test_the_demo_prints_its_table_and_writes_its_numbers_twice(capsys, tmp_path):
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    arguments = ["demo", "--out", str(out), "--swaps", "1", "--no-video", "--json", str(copy)]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert "L2S" in said.out
    assert str(out / "summary.json") in said.out
    assert "flights: 100%" in said.err
    summary = json.loads(copy.read_text())
    assert summary == json.loads((out / "summary.json").read_text())
    assert summary["swaps"] == 1
