"""Files are written whole, folders by one process at a time, and refused before any work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from swarm_envs.cli import main
from swarm_envs.files import LOCK, claimed, read_npz, write_json
from swarm_envs.training.interaction_rows import read_rows

HOLD = """
import sys, time
from pathlib import Path
from swarm_envs.files import claimed
with claimed(Path(sys.argv[1])):
    print('held', flush=True)
    time.sleep(60)
"""

HALF = """
import sys
from pathlib import Path
from swarm_envs.files import written_whole
with written_whole(Path(sys.argv[1])) as partial:
    partial.write_text('half')
    print('begun', flush=True)
    sys.stdin.read()
"""

needs_locks = pytest.mark.skipif(os.name == "nt", reason="no flock on this system")


def test_a_file_is_old_or_whole_and_nothing_is_left_behind(tmp_path):
    path = tmp_path / "new" / "a.json"
    write_json(path, {"a": 1})
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"a": float("nan")})
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["a.json"]


@needs_locks
def test_a_folder_is_claimed_by_one_at_a_time(tmp_path):
    folder = tmp_path / "run"
    with claimed(folder):
        with (
            pytest.raises(BlockingIOError, match=rf"process {os.getpid()} writes into .*run"),
            claimed(folder),
        ):
            pass
        with claimed(tmp_path / "other"):
            pass
    with claimed(folder):
        pass


@needs_locks
def test_a_claim_dies_with_its_process_and_what_it_left_half_written_is_removed(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    half = tmp_path / f".checkpoint.{holder.pid}.partial.safetensors"
    kept = tmp_path / "a.partial.txt"
    for file in (half, kept):
        file.write_bytes(b"half")
    with pytest.raises(BlockingIOError, match=f"process {holder.pid} "), claimed(tmp_path):
        pass
    assert half.exists()
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    holder.stdout.close()
    with claimed(tmp_path):
        assert not half.exists()
        assert kept.exists()


def test_a_folder_that_was_made_for_nothing_is_removed(tmp_path):
    (tmp_path / "there").mkdir()
    for name in ("made", "there", "used"):
        with pytest.raises(ValueError, match="no model"), claimed(tmp_path / name):
            if name == "used":
                (tmp_path / name / "report.json").touch()
            raise ValueError("no model")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["there", "used"]
    with claimed(tmp_path / "made"):
        assert (tmp_path / "made").is_dir()


@needs_locks
def test_what_a_killed_writer_left_is_removed_by_the_next(tmp_path):
    """Also where no folder is claimed; what a living process writes is left alone."""
    target = tmp_path / "a[1].json"
    command = [sys.executable, "-c", HALF, str(target)]
    writer = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert writer.stdin is not None and writer.stdout is not None
    with writer.stdin, writer.stdout:
        assert writer.stdout.readline() == b"begun\n"
        write_json(target, 1)
        assert len(list(tmp_path.iterdir())) == 2  # it is not half written, but being written
        writer.send_signal(signal.SIGKILL)
        writer.wait()
    write_json(target, 2)
    assert [file.name for file in tmp_path.iterdir()] == [target.name]
    assert target.read_text(encoding="utf-8") == "2\n"


COMMANDS = ["fly --json", "evaluate --json", "demo --json"]
NO_FOLDERS = ["collect --out", "fit --data rows.npz --out", "demo --out"]


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("/proc/sub/out.json", "cannot be written"),  # root may, says its permission, and cannot
        ("file/out.json", "is a file; name a folder"),
        ("folder.json", "is a folder; name a file"),
        ("a" * 300 + ".json", "cannot be accessed"),
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
        ["benchmark", "--agent", "hover", "--task", "swap-random-2-v2"],
        ["collect", "--teams", "S"],
        ["demo"],
        ["evaluate", "--agent", "hover"],
        ["fit", "--data", __file__],
        ["train", "--drones", "2", "--steps", "1000"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_folder_into_which_another_process_writes_is_refused(words, tmp_path, capsys):
    with claimed(tmp_path):
        assert main([*words, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"process {os.getpid()} writes into {str(tmp_path)!r}; wait for it, end it" in said
    assert [file.name for file in tmp_path.iterdir()] == [LOCK]


def test_a_file_that_unpacks_to_gigabytes_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "a.npz"
    archive = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED)
    with archive, archive.open("a.npy", "w") as member:
        header = {"descr": "<f8", "fortran_order": False, "shape": (40_000_000,)}
        np.lib.format.write_array_header_1_0(member, header)
        for _ in range(320):
            member.write(bytes(1_000_000))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(ValueError, match=r"a\.npz unpacks to 0\.3 GB"):
        read_npz(path)
    with pytest.raises(ValueError, match=r"it cannot be read \(.* unpacks to 0\.3 GB"):
        read_rows(path)


def test_the_longest_name_can_be_written(tmp_path):
    path = tmp_path / ("a" * 250 + ".json")
    write_json(path, {})
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
