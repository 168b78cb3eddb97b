"""Figures and tables of Neural-Swarm2, and studies of its controller, as scripts.

Shi, Hönig, Shi, Yue, Chung, *Planning and Control of Heterogeneous Multirotor Swarms using Learned
Interactions*. `python -m examples.papers.neural_swarm2 --help` lists them; docs/papers.md has
the results. Not reproduced: Fig. 2, the idea of a proof; Fig. 3, a search tree without numbers,
which ends in the left column of Fig. 6; Fig. 4, a block diagram.

They need `swarm-envs[train]`.
"""
