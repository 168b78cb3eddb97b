"""Fig. 5: heat maps of the force on a small drone, and superposition gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from examples.papers.common import Row, within, write_compared
from examples.papers.neural_swarm2.heat_maps import (
    MAP_CASES,
    ForceMap,
    force_map,
    plot_gaps,
    plot_heat_maps,
)
from examples.papers.neural_swarm2.published_weights import PublishedWeights
from swarm_envs.interactions import load

READINGS = (
    # name, what is read, the paper's value, the same from their published weights, g; the gap there
    # is that of rho(phi_env) + sum of rho(phi_j), the paper's expression
    ("ground_effect", "(a): small drone at (0, 0.05)", 5.0, 1.7),
    ("two_above", "(e): small drone at (0, 0.3)", -10.0, -12.4),
    ("superposition_gap", "(g): most that the sum of pairs overestimates", 11.4, 3.7),
)
"""Numbers read off Fig. 5. The published weights give neither the first nor the last: nothing is
tuned to them."""
FORM = (
    "the form of the model: networks of a code, fitted to the same flights, say otherwise than "
    "sums of wakes; the authors' published weights say {authors:+.1f} g"
)


def figure_5(
    out: Path = Path("neural_swarm2"),
    model: str = "learned",
    clone: Path | None = None,
) -> None:
    """Draw the heat maps and the superposition gaps of a force model (Fig. 5).

    Writes `figure_5.json` (`readings` beside the paper's, of this model, `deep-set` and with
    `clone` the authors'; `cases`), `figure_5.png` and `superposition_gaps.png`.

    Args:
        out: folder, made if missing.
        model: force model, `learned`, `wake`, or a path of weights.
        clone: of crazyswarm2 or neural-swarm, which have the authors' weights.
    """
    forces = load(model)
    name = Path(forces.name).name
    maps = [force_map(forces, case) for case in tqdm(MAP_CASES, "Fig. 5")]
    others: dict[str, Any] = {"deep-set": load("deep-set")}
    if clone is not None:
        others["published"] = PublishedWeights(clone)
    read = {other: readings([force_map(m, c) for c in MAP_CASES]) for other, m in others.items()}
    summary = summarize_maps(maps, name, read)
    compared = [
        compare(model_name, row) for row in summary["readings"] for model_name in (name, *read)
    ]
    write_compared(out / "figure_5.json", summary, compared)
    plot_heat_maps(out / "figure_5.png", maps, name)
    plot_gaps(out / "superposition_gaps.png", maps, name)


def readings(maps: Sequence[ForceMap]) -> dict[str, float]:
    """Return what `READINGS` reads off maps, g; a gap is what the sum of pairs has too much."""
    by_letter = {m.case.letter: m for m in maps}
    return {
        "ground_effect": round(by_letter["a"].at(0.0, 0.05), 3),
        "two_above": round(by_letter["e"].at(0.0, 0.3), 3),
        "superposition_gap": round(max(0.0, float(-by_letter["g"].gap_g.min())), 3),
    }


def summarize_maps(
    maps: Sequence[ForceMap], model: str, others: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """Return the numbers of the eight maps and the paper's readings, ready for JSON."""
    by_letter = {m.case.letter: m for m in maps}
    all_models = {model: readings(maps), **others}
    keys = ("name", "what", "paper_g", "published_weights_g")
    found = [
        dict(zip(keys, row, strict=True)) | {f"{n}_g": own[row[0]] for n, own in all_models.items()}
        for row in READINGS
    ]
    moving = np.abs(by_letter["d"].force_g - by_letter["c"].force_g)
    a, b = by_letter["a"], by_letter["b"]
    return {
        "model": model,
        "readings": found,
        "moving_changes_force_by_g": round(float(moving[by_letter["c"].free].max()), 3),
        "mitigation_g": {f"z={z}": round(b.at(0.0, z) - a.at(0.0, z), 3) for z in (0.3, 0.1, 0.07)},
        "cases": [_summarize_map(m) for m in maps],
        "gap_means": "sum of pairs minus joint force: negative where the pairs push down more",
    }


def _summarize_map(found: ForceMap) -> dict[str, Any]:
    case = found.case
    inside = found.force_g[found.free]
    gap = {}
    for name, free_only in (("where_free", True), ("anywhere", False)):
        value, y, z = found.extreme_gap(free_only)
        gap[name] = {"gap_g": round(value, 3), "y_m": round(y, 3), "z_m": round(z, 3)}
    return {
        "case": case.letter,
        "neighbors": [n._asdict() for n in case.neighbors],
        "ground": case.ground,
        "paper_states": case.stated,
        "assumed": case.assumed,
        "lowest_g": round(float(inside.min()), 3),
        "highest_g": round(float(inside.max()), 3),
        "superposition_gap": gap if len(case.neighbors) > 1 else None,
    }


def compare(model: str, reading: Mapping[str, Any]) -> Row:
    """Return a model's reading beside the paper's; its form and the authors' weights explain it."""
    paper, authors = reading["paper_g"], reading["published_weights_g"]
    return Row(
        f"{reading['what']}, g, `{model}`",
        f"{paper:+g}",
        reading[f"{model}_g"],
        within(paper, 0.25),
        FORM.format(authors=authors),
        (min(0.0, 1.3 * paper), max(0.0, paper)),
    )
