"""The model card of the weights that ship: `model_card.txt` with the numbers of their reports.

`python docs/model_card.py --weights DIR` reads the JSON reports there and
writes `MODEL_CARD.md` beside them, so that no number is copied by hand.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from swarm_envs.files import written_whole

Report = dict[str, Any]
"""A report as it was read from its file."""
REPORTS = ("learned", "deep-set", "measured", "wake", "comparison")
"""Names of the reports: of models, of a fit in measured mode, and of whole flights."""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown table; every column after the first is aligned right."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *rows)) + "\n"


def _errors(reports: dict[str, Report]) -> str:
    """Errors on held-out blocks, beside trivial predictors and a measured fit."""
    fits = [reports[n]["findings"] for n in ("learned", "deep-set", "measured")]
    errors, wake = [found["errors"] for found in fits], reports["wake"]
    e, w = errors[0], wake["validation_mse_g2_by_scenario"]
    rows = [
        [
            name,
            f"{e['scenario_zero'][name]:.2f}",
            f"{e['scenario_scenario_mean'][name]:.2f}",
            f"{w[name]:.2f}",
            f"**{e['scenario'][name]:.2f}**",
            *(f"{other['scenario'][name]:.2f}" for other in errors[1:]),
        ]
        for name in e["scenario"]
    ]
    wake_total = min(v for k, v in wake["validation_mse_g2"].items() if k.startswith("tilted"))
    total = [e["zero"], e["scenario_mean"], wake_total, *(other["overall"] for other in errors)]
    rows.append(["all", *(f"{value:.2f}" for value in total)])
    head = ["scenario", "zero", "scenario mean", "wake", "learned", "deep-set"]
    return _table([*head, "measured form, raw labels"], rows)


def _comparison(comparison: Report) -> dict[str, Any]:
    """Errors on flights that the models have not seen, and paired differences."""
    errors = comparison["errors"]
    names = [name for name in errors["composed"] if name not in ("all", "flown")]
    rows = [
        [name, *(f"{own[name]:.2f}" for own in errors.values())]
        for name in (*names, "all", "flown")
    ]
    differences = [
        f"- {d['model']} less {d['other']}, {d['rows']} rows: {d['mean']:+.2f} "
        f"({d['low']:+.2f} to {d['high']:+.2f})"
        for d in comparison["differences"]
    ]
    return {
        "folds": comparison["config"]["folds"],
        "flights": comparison["flights"],
        "comparison_table": _table(["rows", *errors], rows),
        "differences": "\n".join(differences),
    }


def _axis(learned: Report) -> str:
    """Measured and modelled force on the axis."""
    rows = [
        [
            f"{b['above']} above {b['below']}",
            f"{b['lowest_m']:.1f}-{b['highest_m']:.1f}",
            str(b["rows"]),
            *(f"{b[name]:.2f}" for name in ("measured_g", "model_g", "model_on_axis_g")),
        ]
        for b in learned["findings"]["axis_bins"]
    ]
    head = ["pair", "below by, m", "rows", "measured", "learned, same rows", "on axis, at rest"]
    return _table(head, rows)


def _lipschitz(found: Report) -> str:
    """Largest gradients."""
    rows = []
    for name, count in (("one neighbour", "1"), ("two neighbours", "2")):
        m = found["lipschitz_measured"][count]
        gradient = [m["position_gradient_g_per_m"], m["input_gradient_g_per_unit"]]
        rows.append([name, *(f"{value:.0f}" for value in gradient)])
    return _table(["", "relative position, g/m", "whole input, g per m and m/s"], rows)


def _extremes(found: Report) -> str:
    """Largest forces in random swarms."""
    rows = [
        [
            str(e["drones"]),
            *(f"{e[who][0]:.1f} to {e[who][1]:.1f}" for who in ("small_only", "mixed")),
        ]
        for e in found["extremes"]
    ]
    return _table(["drones", "on S, all S", "on S or L, mixed"], rows)


def _closed_form(wake: Report) -> dict[str, str]:
    """The wake's parameters."""
    tilts = {k: v for k, v in wake["validation_mse_g2"].items() if k.startswith("tilted")}
    rows = [
        [f"{name[0]} above {name[2]}", *(f"{pair[key]:.4f}" for key in ("A_g", "w0_m", "S", "p"))]
        for name, pair in wake["pair"].items()
    ]
    ground = wake["ground"].items()
    return {
        "tilts": ", ".join(f"{name}: {value:.2f} g^2" for name, value in tilts.items()),
        "wakes_table": _table(["pair", "A, g", "w0, m", "S", "p"], rows),
        "speed": ", ".join(f"{k}: {u:.2f} m/s" for k, u in wake["advection_speed"].items()),
        "ground": ", ".join(f"{k}: {g['G_g']:.2f} g, {g['h_m']:.4f} m" for k, g in ground),
    }


@dataclass(frozen=True, kw_only=True)
class CardConfig:
    """Where the reports are."""

    weights: Path
    """folder with the reports; the card is written there"""


def write_card(config: CardConfig) -> Path:
    """Write `MODEL_CARD.md` and return its path."""
    reports: dict[str, Report] = {
        name: json.loads((config.weights / f"{name}.json").read_text()) for name in REPORTS
    }
    learned, wake = reports["learned"], reports["wake"]
    found, measured = learned["findings"], reports["deep-set"]["findings"]["lipschitz_measured"]
    drag = [[name, *(f"{value:.4f}" for value in c)] for name, c in learned["drag"].items()]
    offsets = learned["vehicle_offsets_g"].items()
    text = Path(__file__).with_name("model_card.txt").read_text(encoding="utf-8")
    card = text.format(
        **{**learned, "rows": found["rows"], "validation_rows": found["validation_rows"]},
        offsets=", ".join(f"{vehicle}: {value:+.2f}" for vehicle, value in offsets),
        **_comparison(reports["comparison"]),
        errors_table=_errors(reports),
        axis_table=_axis(learned),
        lipschitz_table=_lipschitz(found),
        steep=max(m["position_gradient_g_per_m"] for m in measured.values()),
        drag_table=_table(["type", "x", "y", "z"], drag),
        extremes_table=_extremes(found),
        overall=found["errors"]["overall"],
        wake=wake,
        **_closed_form(wake),
    )
    path = config.weights / "MODEL_CARD.md"
    with written_whole(path) as partial:
        partial.write_text(card)
    return path


if __name__ == "__main__":
    write_card(tyro.cli(CardConfig, description="Write the model card from the reports."))
