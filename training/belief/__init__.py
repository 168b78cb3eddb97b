"""The force model that the compensated controller feeds forward, from simulated flights.

Its files are called `belief`. Command: `python -m swarm_envs.training.belief --out DIR --seed 0`,
and `--collection.interactions wake` for an environment with another force model.
"""
