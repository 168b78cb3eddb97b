"""Fits for any set of types: three, invented ones, ones that rows show on one side only."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from swarm_envs.interactions import load
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.pipeline import WEIGHTS, fit
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.vehicles import LARGE, SMALL, SMALL_STRONG, Vehicle

STRONG: Vehicle = dataclasses.replace(SMALL_STRONG, interaction_type="S*")
HUGE: Vehicle = dataclasses.replace(LARGE, interaction_type="XL")


def rows_of(types: tuple[str, ...], count: int = 1500) -> InteractionRows:
    """Rows in which a neighbour pushes down by 2 g times one plus its type's index, if above."""
    rng = np.random.default_rng(0)
    ego, kind = rng.integers(len(types), size=(2, count))
    neighbor = rng.uniform(-1.0, 1.0, (count, 1, 6)) * [0.1, 0.1, 0.6, 0.3, 0.3, 0.3]
    force = np.zeros((count, 3))
    force[:, 2] = np.where(neighbor[:, 0, 2] > 0.0, -2.0 * (1 + kind), 0.0)
    return InteractionRows(
        types=types,
        ego_type=ego,
        position=rng.uniform(0.4, 1.2, (count, 3)),
        velocity=rng.uniform(-0.2, 0.2, (count, 3)),
        neighbor=neighbor,
        neighbor_type=kind[:, None],
        force_g=force,
        flight=np.zeros(count, dtype=np.int64),
        step=np.arange(count),
        vehicle=50 + ego,
        scenario=np.zeros(count, dtype=np.int64),
        validation=np.arange(count) // 100 % 5 == 0,
        scenario_names=("pairs",),
    )


def config_of(rows: InteractionRows, folder: Path, model: str, steps: int = 20) -> FitConfig:
    save_rows(folder / "rows.npz", rows)
    return FitConfig(
        data=folder / "rows.npz", out=folder, model=model, steps=steps,  # type: ignore[arg-type]
        offsets="none", lipschitz_samples=0, learning_rate=1e-2, batch_size=128, progress=False,
    )  # fmt: skip


@pytest.mark.parametrize("model", ["deep-set", "pairwise"])
def test_three_types_one_of_them_invented_are_fitted_and_fly(model: str, tmp_path: Path) -> None:
    report = fit(config_of(rows_of(("S", "S*", "XL")), tmp_path, model, steps=250))
    assert report.notes == []
    assert report.findings.errors.overall < 0.6 * report.findings.errors.zero
    found = load(str(tmp_path / WEIGHTS[model]))
    assert found.types == ("S", "S*", "XL")
    position = [[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]]
    force = [
        found.forces(position, np.zeros((1, 2, 3)), (STRONG, upper))[0, 0, 2]
        for upper in (SMALL, HUGE)
    ]
    assert force[1] < force[0] < 0.0
    with pytest.raises(ValueError, match="unknown interaction type 'L'"):
        found.forces(position, np.zeros((1, 2, 3)), "SL")


@pytest.mark.parametrize("model", ["deep-set", "pairwise"])
def test_a_type_that_is_never_a_neighbour_feels_but_does_not_push(
    model: str, tmp_path: Path
) -> None:
    rows = rows_of(("S", "L"))
    report = fit(config_of(rows.select(rows.neighbor_type[:, 0] == 0), tmp_path, model))
    notes = [note for note in report.notes if "explains nothing" not in note]
    assert notes and all("'L' is a neighbour" in note for note in notes)
    assert report.notes[0] in "\n".join(report.lines())
    found = load(str(tmp_path / WEIGHTS[model]))
    assert found.notes["notes"] == notes
    position = np.array([[[0.0, 0.0, 0.8], [0.0, 0.0, 1.1]]])
    still = np.zeros((1, 2, 3))
    assert found.forces(position, still, "LL")[0, 0, 2] == 0.0
    assert found.forces(position, still, "LS")[0, 0, 2] != 0.0


def test_a_fitted_wake_is_read_back_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    report = fit(config_of(rows_of(("S", "L")), tmp_path, "wake"))
    path = tmp_path / "wake.json"
    found = load(path)
    assert found.types == ("S", "L")
    errors = report.findings.errors
    assert errors.overall < 0.5 * errors.zero
    position = [[[0.0, 0.0, 0.8], [0.02, 0.0, 1.1]]]
    force = found.forces(position, np.zeros((1, 2, 3)), "SL")[0, 0, 2]
    assert force / 0.00980665 == pytest.approx(-4.0, abs=0.8)
    content = json.loads(path.read_text())
    for change, reason in (
        ({"format": "wake-0"}, "its format is another"),
        ({"advection_velocity": "relative"}, "only 'neighbor'"),
        ({"pair": {}}, "'S>S'"),
        ({"combine_q": "two"}, "could not convert"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(ValueError, match=f"damaged or not a 'wake-1' file .*{reason}"):
            load(path)
    path.write_text("{")
    with pytest.raises(ValueError, match="fit it again by `swarm-envs fit --model wake`"):
        load(path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        load(tmp_path / "no.json")
