"""Reinforcement learning: one policy for all drones, by PPO, MAPPO, SAC or DAgger.

Order of reading: `run` (a run from its options to its report), `learner` (what the algorithms
share), `ppo`, `mappo`, `sac` or `dagger`; besides these `rl_config` (options and schedules) and
`recipes` (what is particular to each task).

Command: `swarm-envs train --out DIR --seed 0`; the page is docs/rl.md.
"""
