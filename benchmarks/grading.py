"""The cost of grading beyond `swarm-envs evaluate`: `python -m benchmarks.grading`.

The swap assignment's starter flies 64 episodes as `evaluate` and as `grade` fly it, in turns, each
in a process of its own; CPU time of all its processes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

from benchmarks.rows import Row, run, spread
from swarm_envs import assignments

EPISODES = 64
STARTER = Path(assignments.__file__).parent / "swap" / "swap.py"
COMMANDS = {
    "evaluate": "evaluate --task swap --layout random --team SSSSSSSSLLLLLLLL",
    "grade": "grade --assignment swap",
}


def cpu_s(command: str) -> float:
    """CPU time of a command and of all its processes, s."""
    words = f"{COMMANDS[command]} --episodes {EPISODES} --agent {STARTER}:MyAgent"
    before = os.times()
    subprocess.run(
        [sys.executable, "-m", "swarm_envs", *words.split()], check=True, capture_output=True
    )
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def measure(options: argparse.Namespace) -> list[Row]:
    """CPU time of both commands, and their ratio, side by side."""
    times = [(cpu_s("evaluate"), cpu_s("grade")) for _ in range(options.repetitions)]
    evaluate, grade = zip(*times, strict=True)
    about = {"unit": "CPU s", "drones": 16}
    return [
        {"what": f"evaluate, {EPISODES} episodes", **about} | spread(evaluate),
        {"what": f"grade, {EPISODES} episodes", **about} | spread(grade),
        {"what": "grade over evaluate", **about, "unit": ""} | spread([g / e for e, g in times]),
    ]


if __name__ == "__main__":
    run(__doc__, measure, repetitions=5)
