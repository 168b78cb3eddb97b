"""Flights along paths on a grid: splines, clearances, and smoothing in corridors."""
