"""What a reader crosses to follow one step: the package's files and functions that it calls.

    python -m tests.helpers.traced          a table, in the order in which they are first called

One `env.step` of four drones on Bullet is traced, the second of an episode. Kernels are called as
the Python that they are written in: `NUMBA_DISABLE_JIT` is read when numba is imported, so the
trace runs in a process of its own. Lambdas and comprehensions are not counted: they are read where
they stand.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import FrameType

Crossed = dict[str, list[str]]
"""Functions by file of the package, both in the order in which they are first called."""


def crossed() -> Crossed:
    """What a step of the package that would be imported here crosses."""
    spec = find_spec("swarm_envs")
    if spec is None or spec.origin is None:
        raise ImportError("swarm_envs cannot be found")
    where = str(Path(spec.origin).parent.parent)
    interpreted = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": where}
    command = [sys.executable, "-P", __file__, "--trace"]
    output = subprocess.check_output(command, env=interpreted, text=True)
    found: Crossed = json.loads(output.splitlines()[-1])
    return found


def trace() -> Crossed:
    """Trace the step, in a process in which nothing is compiled."""
    import numpy as np

    import swarm_envs
    from swarm_envs import swap_v0

    root, found = Path(swarm_envs.__file__).parent, Crossed()

    def look(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if event != "call" or code.co_name.startswith("<"):
            return
        file = Path(code.co_filename)
        if file.is_relative_to(root):
            names = found.setdefault(file.relative_to(root).as_posix(), [])
            if code.co_qualname not in names:
                names.append(code.co_qualname)

    env = swap_v0.parallel_env(num_drones=4, physics="bullet")
    env.reset(seed=0)
    still = {agent: np.zeros(3, np.float32) for agent in env.agents}
    env.step(still)
    sys.setprofile(look)
    env.step(still)
    sys.setprofile(None)
    env.close()
    return found


def table(found: Mapping[str, Sequence[str]]) -> str:
    """A line for each function, under the name of its file, and the numbers of both."""
    lines = []
    for file, names in found.items():
        lines += [file, *(f"    {name}" for name in names)]
    functions = sum(len(names) for names in found.values())
    return "\n".join([*lines, f"{len(found)} files, {functions} functions"])


if __name__ == "__main__":
    print(json.dumps(trace()) if "--trace" in sys.argv else table(crossed()))
