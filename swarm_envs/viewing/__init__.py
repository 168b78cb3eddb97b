"""Visualization: recordings and their files, replay pages, and a camera without a display."""

from swarm_envs.viewing.record import Recorder, Recording
from swarm_envs.viewing.replay import write_replay
from swarm_envs.viewing.trajectory import read_trajectory, write_trajectory

__all__ = ["Recorder", "Recording", "read_trajectory", "write_replay", "write_trajectory"]
