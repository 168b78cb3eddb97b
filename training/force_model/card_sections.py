"""Sections of the model card that hold numbers, each a function of the reports."""

from __future__ import annotations

from typing import Any

Report = dict[str, Any]
"""A report as it was read from its file."""


def table(head: list[str], rows: list[list[str]]) -> str:
    """Markdown table; every column after the first is aligned right."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *rows)) + "\n"


def errors_section(learned: Report, measured: Report, wake: Report) -> str:
    """Errors on held-out blocks, beside trivial predictors, the wake and a measured fit."""
    found, raw = learned["findings"], measured["findings"]
    e, r, w = found["errors"], raw["errors"], wake["validation_mse_g2_by_scenario"]
    rows = [
        [
            name,
            f"{e['scenario_zero'][name]:.2f}",
            f"{e['scenario_scenario_mean'][name]:.2f}",
            f"{w[name]:.2f}",
            f"**{value:.2f}**",
            f"{r['scenario'][name]:.2f}",
        ]
        for name, value in e["scenario"].items()
    ]
    wake_total = min(v for k, v in wake["validation_mse_g2"].items() if k.startswith("tilted"))
    total = (
        f"{e['zero']:.2f} | {e['scenario_mean']:.2f} | {wake_total:.2f} | **{e['overall']:.2f}**"
    )
    rows.append(["all", *total.split(" | "), f"{r['overall']:.2f}"])
    body = table(
        ["scenario", "zero", "scenario mean", "wake", "learned", "measured form, raw labels"], rows
    )
    vehicle = found["errors_vehicle_offsets"]["overall"]
    return f"""## Validation error

Mean squared error of f_z on the held-out blocks, g^2. The first four columns use labels free of
offsets. The last is a separate fit of the paper's form to the labels as measured (no offset, no
anchor, no clamp, every neighbour seen), which does not ship: it stands beside an untuned
reference of 6.47 on the same blocks, the published weights' 6.06 and 6.29 of the paper's
architecture on the 100 Hz rows, and the paper's own 6.42 on its own split.

{body}
If only one offset per vehicle is taken out of the labels, not one per flight, the error of
`learned` is {vehicle:.2f}: the drift between flights stays in the labels.
"""


def axis_section(learned: Report) -> str:
    """Measured and modelled force on the axis."""
    rows = [
        [
            f"{b['above']} above {b['below']}",
            f"{b['lowest_m']:.1f}-{b['highest_m']:.1f}",
            str(b["rows"]),
            f"{b['measured_g']:.2f}",
            f"{b['model_g']:.2f}",
            f"{b['model_on_axis_g']:.2f}",
        ]
        for b in learned["findings"]["axis_bins"]
    ]
    head = ["pair", "below by, m", "rows", "measured", "learned, same rows", "on axis, at rest"]
    return f"""## On the axis

Rows with one neighbour within 5 cm laterally; mean force, g, offsets taken out. The last column is
the model exactly on the axis in the middle of the bin, both at rest.

{table(head, rows)}"""


def lipschitz_section(learned: Report) -> str:
    """Analytic bound and measured Lipschitz constants."""
    found = learned["findings"]
    bound = found["lipschitz_bound"]
    one, two = (found["lipschitz_measured"][k] for k in ("1", "2"))
    rows = [
        ["analytic bound", f"{bound['position_g_per_m']:,.0f}", f"{bound['input_g_per_unit']:,.0f}"]
    ]
    for name, m in (("one neighbour", one), ("two neighbours", two)):
        gradient = [m["position_gradient_g_per_m"], m["input_gradient_g_per_unit"]]
        ratio = [m["pair_ratio_g_per_m"], m["input_ratio_g_per_unit"]]
        rows.append([f"gradient, {name}", *(f"{value:.0f}" for value in gradient)])
        rows.append([f"random pairs, {name}", *(f"{value:.0f}" for value in ratio)])
    head = ["", "relative position, g/m", "whole input, g per m and m/s"]
    samples = learned["config"]["lipschitz_samples"]
    return f"""## Lipschitz constant

Of the function as it ships. The analytic bound is the product of spectral norms, with the window
(|d(w phi)| <= Lip phi + |dw| sup |phi|); the measured constants are the largest found by autograd
and by pairs at {samples:,} random inputs each, on axes, in the fading zone, near the ground, over
the whole clamped range: a search, so the true constant lies between the two. The
measured air changes by 100-150 g/m across a wake.

{table(head, rows)}"""


def drag_section(learned: Report) -> str:
    """Drag coefficients."""
    rows = [[name, *(f"{value:.4f}" for value in c)] for name, c in learned["drag"].items()]
    return f"""## Drag

Linear, -c v, N s/m, in both models. Horizontal: labels against velocity in rows away from wakes;
vertical: lone flight above the ground effect. The horizontal force has no other part: sideways
pushes of wakes are not modelled.

{table(["type", "x", "y", "z"], rows)}"""


def limits_section(learned: Report) -> str:
    """Where the models should not be trusted."""
    extremes = [
        [
            str(e["drones"]),
            f"{e['small_only'][0]:.1f} to {e['small_only'][1]:.1f}",
            f"{e['mixed'][0]:.1f} to {e['mixed'][1]:.1f}",
        ]
        for e in learned["findings"]["extremes"]
    ]
    return f"""## Where not to trust it

- Below 7 cm height: nothing was measured; inputs are clamped there.
- Above about 1 m/s (99 % of the logged speeds are below 0.67 m/s); speeds are clamped at the
  99.9 % quantile of the logs, so nothing grows beyond it.
- Beside or inside another drone: no flight was nearer than about 0.1 m vertically on the axis.
- Beyond 0.8 m vertically the window takes away a force that is still there (some 8 g under L).
- More than two neighbours: no flight had them. The network extrapolates: climbing the slope over
  relative positions found 343 g/m with three neighbours and 402 g/m with six. Largest forces (g) in
  random swarms packed into 0.6 x 0.6 x 1.5 m at up to 1 m/s per axis, overlaps included:

{table(["drones", "on S, all S", "on S or L, mixed"], extremes)}
- Three-drone scenarios with a large drone below (SL2L, LL2L): errors of 4-5 g rms. In LL2L the
  fit of the paper's form, which sees neighbours outside the interaction volume, does better: some
  of that force may come from where the window lets nothing through.
- Other vehicles, outdoors, walls: nothing was measured.
"""


def wake_section(wake: Report, learned: Report) -> str:
    """The closed form and its parameters."""
    tilts = {k: v for k, v in wake["validation_mse_g2"].items() if k.startswith("tilted")}
    listed = ", ".join(f"{name}: {value:.2f} g^2" for name, value in tilts.items())
    network = learned["findings"]["errors"]["overall"]
    rows = [
        [f"{name[0]} above {name[2]}", *(f"{pair[key]:.4f}" for key in ("A_g", "w0_m", "S", "p"))]
        for name, pair in wake["pair"].items()
    ]
    ground = ", ".join(
        f"{k}: {g['G_g']:.2f} g, {g['h_m']:.4f} m" for k, g in wake["ground"].items()
    )
    speed = ", ".join(f"{k}: {u:.2f} m/s" for k, u in wake["advection_speed"].items())
    share = wake["mitigation"]
    return f"""## The closed form

pair = A (w0/w)^p exp(-(r/w)^2/2) s(dz/0.03 m), w = w0 + S dz, r from an axis that a moving
neighbour leaves behind; pairs fade as in the network and join as (sum pair^q)^(1/q); the ground
takes a share off and adds its cushion (`training/force_model/wake_model.py`). Which velocity tilts
the axis was compared: {listed};
the better one ships ({wake["advection_velocity"]}). Network: {network:.2f} g^2. p is
bounded by 3: left free it runs to values that say nothing (8.6 for L above L).

{table(["pair", "A, g", "w0, m", "S", "p"], rows)}
Advection speed U by upper type: {speed}. q = {wake["combine_q"]:.3f}. Ground effect G and h:
{ground}. Mitigation M = {share["M"]:.3f} over hm = {share["hm_m"]:.4f} m.
"""
