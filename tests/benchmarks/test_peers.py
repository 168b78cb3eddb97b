"""Peers are measured where nothing of ours is, and what goes wrong there is shown."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks import peers

BATCH = ("48/240 Hz", 1, 4, 1)


def interpreter(path: Path, script: str) -> str:
    """A program that takes an interpreter's place."""
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


def test_measuring_needs_no_package_but_the_peer():
    """Without site-packages there is neither ours nor anything that we require."""
    words = f"-I -S {peers.__file__} {peers.BATCH_PEER} 48 240 1 4 1"
    bare = [sys.executable, *words.split()]
    output = subprocess.check_output(bare, text=True, stderr=subprocess.DEVNULL)
    assert json.loads(output.splitlines()[-1]) == {"note": "not installed"}


@pytest.mark.skipif(sys.platform == "win32", reason="the programs are shell scripts")
@pytest.mark.parametrize(
    ("script", "note"),
    [
        ("echo 'a warning'; echo '{\"note\": \"not installed\"}'", "not installed"),
        ('echo \'{"note": "TypeError: no such option"}\'', "TypeError: no such option"),
        ("echo 'Killed by something' >&2; exit 9", "Killed by something"),
        ("exit 3", "the process ended with status 3"),
    ],
)
def test_a_row_says_why_it_has_no_number(script, note, tmp_path):
    row = peers.batch_peer_row(interpreter(tmp_path / "python", script), *BATCH)
    assert (row["value"], row["note"]) == (None, note)
