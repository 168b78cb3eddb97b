"""Figures and tables of the papers, remade with our models, the paper's value beside ours.

`cases`, `forces`, `maps`, `heatmaps`: Fig. 5 of Neural-Swarm2 and its superposition gap; `bins`,
`bin_plots`: calibration against measured bins; `larger`: more drones than were measured; `figure`:
all of it. `ablation`: Table III (needs torch). `flight_cases`, `flown`, `paired`: the flight tests
of Fig. 8, 9 and 1, flown by `swarm_envs.baselines.neural_swarm.flights`; `flight_report`,
`flight_claims`, `swap_plot`, `ring_plot`, `flight_tests`: what is made of them. `options`: the
command `swarm-envs reproduce neural-swarm2`; `papers`: what other papers it knows.
"""

from swarm_envs.training.reproduce.figure import format_summary, reproduce_figure

__all__ = ["format_summary", "reproduce_figure"]
