"""Starter: the force of a wake that decays with the distance from its axis, by least squares."""

import numpy as np

WIDTH, LENGTH = 0.3, 0.5  # of a wake, m; change them


class MyModel:
    def features(self, rows):
        """Return features (R, F) of the rows, of which the force is a weighted sum."""
        there = rows.neighbor_type >= 0  # (R, K); empty slots are zero
        x, y, z = np.moveaxis(rows.neighbor[..., :3], -1, 0)  # p_j - p_i, m
        wake = np.exp(-(x**2 + y**2) / WIDTH**2) * (z > 0) * there
        return (wake * np.exp(-np.abs(z) / LENGTH)).sum(axis=1)[:, None]

    def fit(self, rows):
        self.weights, *_ = np.linalg.lstsq(self.features(rows), rows.force_g[:, 2], rcond=None)

    def predict(self, rows):
        """Return vertical forces (R,), gram-force."""
        return self.features(rows) @ self.weights
