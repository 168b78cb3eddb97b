"""Figures 6 and 7 of Neural-Swarm2: plans that know the forces, and plans that do not, flown.

`scenarios`: who swaps places with whom. `plant`: the planner's own model, tracked by a PID, as
published. `trials`: plan, track, measure. `figure_6`, `figure_7`: the pictures and tables.
"""
