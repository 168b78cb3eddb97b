"""From paths on a grid to flight: splines, how close they come, corridors."""
