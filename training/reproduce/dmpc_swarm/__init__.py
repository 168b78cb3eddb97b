"""Figures of DMPC-Swarm, remade on the package's MLR-DMPC.

`flights`: a swarm through a sequence of targets; `cells`: the experiments; `pictures`: what is
drawn; `page`: a flight as a replay page; `options`: `swarm-envs reproduce dmpc-swarm`.
"""
