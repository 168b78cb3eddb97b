"""On the measured flights: what velocities are worth, and what a sum over pairs misses."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarm_envs.training.force_model import FitConfig, fit
from swarm_envs.training.force_model.evaluate import Errors
from swarm_envs.training.reproduce.ablation import is_three_drones


def three_drones(errors: Errors) -> float:
    """Mean over the scenarios of three drones, g^2."""
    found = [error for name, error in errors.scenario.items() if is_three_drones(name)]
    assert len(found) == 6
    return sum(found) / 6


@pytest.mark.slow
def test_velocities_and_joint_wakes_count_on_measured_flights(
    shared_data: Path, tmp_path: Path
) -> None:
    errors = {}
    for name in ("deep-set", "blind", "pairwise"):
        config = FitConfig(
            data=shared_data / "data" / "neural_swarm_flights_33hz.npz",
            out=tmp_path / name,
            model="pairwise" if name == "pairwise" else "deep-set",
            mode="measured",
            relative_velocity=name != "blind",
            steps=6000,
            schedule="cosine",
            average_share=0.0,
            optimiser="adam",
            teachers=0,
            lipschitz_samples=0,
            progress=False,
        )
        errors[name] = fit(config).findings.errors
    assert errors["blind"].overall > errors["deep-set"].overall + 0.3
    assert errors["pairwise"].overall > errors["deep-set"].overall
    assert three_drones(errors["pairwise"]) > three_drones(errors["deep-set"])
