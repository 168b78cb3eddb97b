"""The cost of grading beyond `swarm-envs evaluate`: `python -m benchmarks.grading`.

The swap assignment's starter flies 256 episodes of 8 drones as `evaluate` and as `grade` fly it,
in turns, each in a process of its own; CPU time of all its processes. Then the grader's and the
work's CPU time of one decision for many teams at once, with an agent that does nothing.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.rows import Row, run, spread
from swarm_envs import assignments, make
from swarm_envs.commands.grading.confinement import descendants
from swarm_envs.commands.grading.remote import RemoteBatchAgent, opened, remote_agent

OPTIONS = {"task": "swap", "layout": "random", "drones": 8}
STARTER = Path(assignments.__file__).parent / "swap" / "swap.py"
GRADE = """
import sys
from dataclasses import replace
from swarm_envs import assignments
from swarm_envs.cli import main
flown = replace(assignments.ASSIGNMENTS["swap"], flown={options!r})
assignments.ASSIGNMENTS = {{"swap": flown}}
sys.exit(main(["grade", "--assignment", "swap", *{words!r}]))
"""
EVALUATE = """
import sys
from swarm_envs.cli import main
sys.exit(main(["evaluate", "--task", "swap", "--layout", "random", "--drones", "8", *{words!r}]))
"""
STILL = """
import numpy as np
class Still:
    requires, privileged = {'action': 'acceleration', 'decision_rate': 10}, False
    def reset(self, env, seed): pass
    def act(self, observations, view): return {n: np.zeros(3, np.float32) for n in observations}
    def act_batch(self, rows): return np.zeros((*rows.shape[:-1], 3), np.float32)
"""
"""A decision costs its agent nothing."""


def cpu_s(code: str, episodes: int) -> float:
    """CPU time of a command and of all its processes, s."""
    words = ["--episodes", str(episodes), "--agent", f"{STARTER}:MyAgent"]
    before = os.times()
    command = [sys.executable, "-c", code.format(options=OPTIONS, words=words)]
    subprocess.run(command, check=True, capture_output=True)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])


def ratio_rows(repetitions: int, episodes: int) -> list[Row]:
    """CPU time of both commands, and their ratio, side by side."""
    times = [(cpu_s(EVALUATE, episodes), cpu_s(GRADE, episodes)) for _ in range(repetitions)]
    evaluate, grade = zip(*times, strict=True)
    about = {"unit": "CPU s", "drones": 8}
    return [
        {"what": f"evaluate, {episodes} episodes", **about} | spread(evaluate),
        {"what": f"grade, {episodes} episodes", **about} | spread(grade),
        {"what": "grade over evaluate", **about, "unit": ""} | spread([g / e for e, g in times]),
    ]


def decision_row(environments: int, repetitions: int, times: int = 100) -> Row:
    """CPU time of a decision for so many teams of 8, ms: the grader's and the work's."""
    env = make("swap_v1", num_drones=8, layout="random", physics="batch", num_neighbors=7)
    env.reset(seed=0)
    rows = np.repeat(env.core.rows, environments, axis=0)
    flown = {"task": "swap_v1", "options": {"num_drones": 8, "num_neighbors": 7}}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "still.py"
        work.write_text(STILL, encoding="utf-8")
        with opened(f"{work}:Still", "fly") as (process, made):
            agent = remote_agent(process, made, flown)
            assert isinstance(agent, RemoteBatchAgent)
            agent.reset(env, 0)
            agent.act_batch(rows)
            found = []
            for _ in range(repetitions):
                before = cpu_of_both()
                for _ in range(times):
                    agent.act_batch(rows)
                found.append(1e3 * (cpu_of_both() - before) / times)
    size = f"{rows.nbytes / 1024:.0f} KiB"
    about = {"what": f"decision, rows of {size}", "unit": "CPU ms", "drones": 8}
    return {**about, "environments": environments} | spread(found)


def cpu_of_both() -> float:
    """CPU time of this process and of those that it has begun, s."""
    found = time.process_time()
    for process in descendants():
        spent = Path(f"/proc/{process}/schedstat").read_text().split()[0]
        found += int(spent) / 1e9
    return found


def measure(options: argparse.Namespace) -> list[Row]:
    """All rows."""
    decisions = [decision_row(count, options.repetitions) for count in (1, 64)]
    return [*decisions, *ratio_rows(options.repetitions, 256)]


if __name__ == "__main__":
    run(__doc__, measure, repetitions=5)
