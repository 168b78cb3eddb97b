"""`python -m swarm_envs`: the command `swarm-envs`."""

import runpy

if __name__ == "__main__":
    runpy.run_module("swarm_envs.cli", run_name="__main__", alter_sys=True)
