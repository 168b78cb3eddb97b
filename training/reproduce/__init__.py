"""Figures and tables of the papers, remade with our models, the paper's value beside ours.

`cases`, `forces`, `maps`, `heatmaps`: Fig. 5 of Neural-Swarm2 and its superposition gap; `bins`,
`bin_plots`: calibration against measured bins; `larger`: more drones than were measured; `figure`:
all of it. `ablation`: Table III (needs torch). `options`: the command `swarm-envs reproduce`.
"""

from swarm_envs.training.reproduce.figure import format_summary, reproduce_figure

__all__ = ["format_summary", "reproduce_figure"]
