"""Files that cannot be written are refused before any work."""

from __future__ import annotations

import pytest

from swarm_envs.cli import main
from swarm_envs.files import write_json


@pytest.mark.parametrize("command", ["plan", "fly", "evaluate"])
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
        assert main([command, "--json", path]) == 2
    except SystemExit as end:
        assert end.code == 2
    shown = capsys.readouterr()
    assert said in shown.err and f"--json is {path!r}" in shown.err
    assert not shown.out


def test_the_longest_name_can_be_written(tmp_path):
    path = tmp_path / ("a" * 250 + ".json")
    write_json(path, {})
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
