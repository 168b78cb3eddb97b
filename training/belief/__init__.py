"""Fit of the force model that the compensated controller feeds forward, to simulated flights.

The model is called a belief, to distinguish it from the true force model of the environment.
Command: `python -m swarm_envs.training.belief --out DIR --seed 0`, with
`--collection.interactions wake` for an environment with another force model.
"""
