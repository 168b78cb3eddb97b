"""Learning: one policy for all drones, by Stable-Baselines3 or by DAgger.

Order of reading: `rl_config` (options), `choosing` (defaults of a task, and how policies are
compared), `runs` (what all runs share), then `sb3` or `dagger` with `labels` and `teachers`;
`encoders` has the networks.

Command: `swarm-envs train --out DIR --seed 0`; the page is docs/rl.md.
"""
