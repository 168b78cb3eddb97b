"""The demonstration: stacked swaps with and without compensation, as table, picture and video.

The flight test of Neural-Swarm2 (Fig. 8): drones in a stack change places and cross half way in
one vertical line, so that the upper ones blow on the lowest. Both controllers fly the same swaps
with the same gains, filters and trajectories; they differ in the believed force alone.
"""

from swarm_envs.baselines.neural_swarm.demo.report import crashed_flights, format_table
from swarm_envs.baselines.neural_swarm.demo.run import run_demo

__all__ = ["crashed_flights", "format_table", "run_demo"]
