"""Files that cannot be written are refused before any work."""

from __future__ import annotations

import os

import pytest

from swarm_envs.cli import main
from swarm_envs.files import LOCK, claimed, write_json

COMMANDS = ["plan --json", "fly --json", "evaluate --json", "demo --json"]
NO_FOLDERS = ["collect --out", "fit --data rows.npz --out", "demo --out"]


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("/proc/sub/out.json", "cannot be written"),  # root may, says its permission, and cannot
        ("file/out.json", "is a file; name a folder"),
        ("folder.json", "is a folder; name a file"),
        ("a" * 300 + ".json", "cannot be reached"),
    ],
)
def test_refused_before_the_work(command, path, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "1000")
    (tmp_path / "file").touch()
    (tmp_path / "folder.json").mkdir()
    try:
        assert main([*command.split(), path]) == 2
    except SystemExit as end:
        assert end.code == 2
    shown = capsys.readouterr()
    assert said in shown.err and f"--json is {path!r}" in shown.err
    assert not shown.out


@pytest.mark.parametrize("command", NO_FOLDERS)
def test_a_file_in_place_of_a_folder_is_refused_and_kept(command, tmp_path, capsys):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    assert main([*command.split(), str(tmp_path / "file")]) == 2
    assert "error: --out is" in capsys.readouterr().err
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    "words",
    [
        ["benchmark", "--agent", "hover", "--task", "swap-random-2-v1"],
        ["collect", "--teams", "S"],
        ["curriculum"],
        ["demo"],
        ["evaluate", "--agent", "hover"],
        ["fit", "--data", __file__],
        ["plan", "--grid", "6x6x6"],
        ["reproduce", "all"],
        ["reproduce", "dmpc-swarm", "--figure", "4"],
        ["reproduce", "neural-swarm2", "--figure", "5"],
        ["reproduce", "rth3d", "--figure", "5"],
        ["train", "--drones", "2", "--steps", "1000"],
        ["train-sweep", "--seeds", "0", "1"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_folder_into_which_another_process_writes_is_refused(words, tmp_path, capsys):
    with claimed(tmp_path):
        assert main([*words, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"process {os.getpid()} writes into {str(tmp_path)!r}; wait for its end" in said
    assert [file.name for file in tmp_path.iterdir()] == [LOCK]


def test_the_longest_name_can_be_written(tmp_path):
    path = tmp_path / ("a" * 250 + ".json")
    write_json(path, {})
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
