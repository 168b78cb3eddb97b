"""PettingZoo environments for swarms of small quadrotors that blow on each other."""

__version__ = "0.0.1"
