"""Training of one policy for all drones, with Stable-Baselines3 or DAgger.

Order of reading: `rl_config` (options), `validation` (defaults of a task, validation of policies),
`runs` (the common parts), then `sb3`, or `dagger` with `labels` and `teachers`; `encoders` has the
networks.

Command: `swarm-envs train --out DIR --seed 0`; the page is docs/rl.md.
"""
