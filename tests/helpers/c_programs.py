"""C programs that run exported headers, and the compiler with all its warnings as errors."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.agents.c_header import policy_header
from swarm_envs.agents.c_samples import KnownState
from swarm_envs.agents.feature_sets import REFERENCE
from swarm_envs.agents.policy_file import Policy

COMPILER = next(filter(None, map(shutil.which, ("gcc", "cc", "clang"))), None)
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion"]
STRICT += ["-Wconversion", "-Wshadow", "-ffp-contract=off"]
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
MOST = 9
"""Drones in a row of the program's input."""

# Reads states of up to nine drones and a set-point, writes what the drone does and what becomes of
# the set-point in a decision of so many seconds.
PROGRAM = """
#define PILOT_SELF_TEST
#include "pilot.h"
#include <stdio.h>
struct row { int others, types[9]; float moving[9][9], up[3], thrust, setpoint[12], task[9], dt; };
int main(void)
{
    struct row r;
    while (fread(&r, sizeof r, 1, stdin) == 1) {
        struct pilot_drone drones[9];
        struct pilot_own own;
        struct { float sound, action[4], setpoint[12]; } out = {0};
        int j, k;
        for (j = 0; j < 9; j++) {
            for (k = 0; k < 3; k++) {
                drones[j].position[k] = r.moving[j][k];
                drones[j].velocity[k] = r.moving[j][3 + k];
                drones[j].goal[k] = r.moving[j][6 + k];
            }
            drones[j].type = r.types[j];
        }
        for (k = 0; k < 3; k++) own.up[k] = r.up[k], own.setpoint[k] = r.setpoint[k];
        own.thrust = r.thrust;
        @task@
        out.sound = (float)pilot_act(drones, &own, r.others, drones + 1, out.action);
        @steer@
        if (fwrite(&out, sizeof out, 1, stdout) != 1) return 2;
    }
    return pilot_self_test() < 1e-5f ? 0 : 1;
}
"""
STEER = """{
            struct pilot_setpoint s;
            for (k = 0; k < 3; k++) {
                s.position[k] = r.setpoint[k], s.velocity[k] = r.setpoint[3 + k];
                s.acceleration[k] = r.setpoint[6 + k], s.jerk[k] = r.setpoint[9 + k];
            }
            pilot_steer(out.action, &s);
            pilot_advance(&s, r.dt);
            for (k = 0; k < 3; k++) {
                out.setpoint[k] = s.position[k], out.setpoint[3 + k] = s.velocity[k];
                out.setpoint[6 + k] = s.acceleration[k], out.setpoint[9 + k] = s.jerk[k];
            }
        }"""
REFERENCES = """for (k = 0; k < 3; k++) {
            own.reference_position[k] = r.task[k], own.reference_velocity[k] = r.task[3 + k];
            own.reference_acceleration[k] = r.task[6 + k];
        }"""
ROW = np.dtype(
    [
        ("others", np.int32),
        ("types", np.int32, MOST),
        ("moving", np.float32, (MOST, 9)),
        ("up", np.float32, 3),
        ("thrust", np.float32),
        ("setpoint", np.float32, 12),
        ("task", np.float32, 9),
        ("dt", np.float32),
    ]
)


def as_row(state: KnownState) -> np.ndarray:
    """A row of the program's input."""
    row = np.zeros((), ROW)
    count = len(state.position)
    row["others"], row["types"][:count] = count - 1, state.types
    moving = np.concatenate([state.position, state.velocity, state.goal], axis=1)
    row["moving"][:count] = moving
    row["up"], row["thrust"], row["dt"] = state.up, state.thrust, 0.1
    row["setpoint"][:3], row["task"][: len(state.task)] = state.setpoint, state.task
    return row


def in_c(policy: Policy, folder: Path, rows: np.ndarray) -> np.ndarray:
    """(rows, 17): whether it decided, its action, the set-point after the decision."""
    (folder / "pilot.h").write_text(policy_header(policy, "pilot"))
    task = REFERENCES if policy.note.features == REFERENCE else "own.time_left = r.task[0];"
    steer = STEER if policy.note.action in ("acceleration", "velocity") else ""
    program = PROGRAM.replace("@task@", task).replace("@steer@", steer)
    (folder / "program.c").write_text(program)
    build(folder, "program.c")
    done = subprocess.run([folder / "program"], input=rows.tobytes(), capture_output=True)
    assert done.returncode == 0, "the header's own test finds it wrong"
    return np.frombuffer(done.stdout, np.float32).reshape(-1, 17)


def build(folder: Path, *sources: str) -> None:
    """Compile sources in a folder into a program called `program`."""
    command = [str(COMPILER), *STRICT, *sources, "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
