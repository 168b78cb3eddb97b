"""The model card of the weights that ship, written from their JSON reports.

`python -m swarm_envs.training.force_model.card --weights DIR` reads the reports there and writes
`MODEL_CARD.md` beside them, so that no number is copied by hand.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from swarm_envs.files import written_whole

Report = dict[str, Any]
"""A report as it was read from its file."""


def table(head: list[str], rows: list[list[str]]) -> str:
    """Markdown table; every column after the first is aligned right."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *rows)) + "\n"


REPORTS = ("learned", "deep-set", "learned-v0", "measured", "wake", "comparison")
"""Names of the reports: of models, of a fit in measured mode, and of whole flights."""


def errors_section(reports: dict[str, Report]) -> str:
    """Errors on held-out blocks, beside trivial predictors and a measured fit."""
    fits = [reports[n]["findings"] for n in ("learned", "deep-set", "learned-v0", "measured")]
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
    head = ["scenario", "zero", "scenario mean", "wake", "learned", "deep-set", "learned-v0"]
    return f"""## Errors on blocks of known flights

Mean squared error of f_z on the held-out blocks, g^2. These blocks lie between training rows of the
same flights; what a model knows of the air, the next section tells better. All but the last column
use labels free of offsets. The last is a separate fit of the paper's form to the labels as measured
(no offset, no anchor, no clamp, every neighbour seen), which does not ship: it stands beside an
untuned reference of 6.47 on the same blocks, the published weights' 6.06 and 6.29 of the paper's
architecture on the 100 Hz rows, and the paper's own 6.42 on its own split.

{table([*head, "measured form, raw labels"], rows)}"""


def comparison_section(comparison: Report) -> str:
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
    listed = "\n".join(differences)
    return f"""## Errors on whole flights

Cross-validation in {comparison["config"]["folds"]} parts of the {comparison["flights"]} flights,
every model refitted for each part by its usual recipe (`composed` is that of `learned`, `deep-set`
that of `learned-v0`), g^2. `flown` rows leave out drones at 1.5 m/s and above: in these flights
they fall, 139 rows whose labels (-40 g on average) say that the rotors no longer turn as commanded.
A composed model is not fitted to them. Of the error of all rows they make 0.5 g^2 for it and for
the wake, 0.2 for the deep set, which says that whoever sinks fast is pushed down hard.

{table(["rows", *errors], rows)}
Differences on the same rows, with the interval that holds 95 % of a bootstrap over flights:

{listed}

The aim was to be better than both by 0.4 g^2. It is met against the wake, not against the deep set.
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


def lipschitz_section(learned: Report, deep_set: Report) -> str:
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
    steep = max(
        m["position_gradient_g_per_m"] for m in deep_set["findings"]["lipschitz_measured"].values()
    )
    return f"""## Lipschitz constant

Of the function as it ships. The analytic bound is the product of spectral norms, with the window
(|d(w phi)| <= Lip phi + |dw| sup |phi|); the measured constants are the largest found by autograd
and by pairs at {samples:,} random inputs each, on axes, in the fading zone, near the ground, over
the whole clamped range: a search, so the true constant lies between the two. The
measured air changes by 100-150 g/m across a wake.

{table(head, rows)}
`deep-set` is trained without a penalty of slopes, and is steeper where nothing was measured (up to
{steep:,.0f} g/m found) than `learned-v0`, which has one.
"""


def drag_section(learned: Report) -> str:
    """Drag coefficients."""
    rows = [[name, *(f"{value:.4f}" for value in c)] for name, c in learned["drag"].items()]
    return f"""## Drag

Linear, -c v, N s/m, in all models. Horizontal: labels against velocity in rows away from wakes;
vertical: lone flight above the ground effect. Only `learned` has another horizontal force, a pull
towards the axis of a wake; part of it may be error of the attitude, which the labels cannot tell.

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
- More than two neighbours: no flight had them. In `learned` they never lift, and push no more than
  their sum; nothing else is known of them. `deep-set` and `learned-v0` extrapolate: of drones that
  the pairs of a crowd push down by more than 2 g, `learned-v0` lifts a third to a half. Largest
  forces (g) of `learned` in random swarms packed into 0.6 x 0.6 x 1.5 m at up to 1 m/s per axis,
  overlaps included:

{table(["drones", "on S, all S", "on S or L, mixed"], extremes)}
- Three-drone scenarios with a large drone below (SL2L, LL2L): errors of 4-5 g rms.
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
takes a share off and adds its cushion (`training/force_model/wake_fit.py`). Which velocity tilts
the axis was compared: {listed};
the better one ships ({wake["advection_velocity"]}). Network: {network:.2f} g^2. p is
bounded by 3: left free it runs to values that say nothing (8.6 for L above L).

{table(["pair", "A, g", "w0, m", "S", "p"], rows)}
Advection speed U by upper type: {speed}. q = {wake["combine_q"]:.3f}. Ground effect G and h:
{ground}. Mitigation M = {share["M"]:.3f} over hm = {share["hm_m"]:.4f} m.
"""


@dataclass(frozen=True, kw_only=True)
class CardConfig:
    """Where the reports are."""

    weights: Path
    """folder with the reports; the card is written there"""


def write_card(config: CardConfig) -> Path:
    """Write `MODEL_CARD.md` and return its path."""
    reports = {name: _read(config.weights / f"{name}.json") for name in REPORTS}
    learned, wake = reports["learned"], reports["wake"]
    sections = (
        _head(learned),
        _labels(learned),
        _function(learned),
        comparison_section(reports["comparison"]),
        errors_section(reports),
        axis_section(learned),
        lipschitz_section(learned, reports["deep-set"]),
        drag_section(learned),
        limits_section(learned),
        wake_section(wake, learned),
        _making(reports),
    )
    path = config.weights / "MODEL_CARD.md"
    with written_whole(path) as partial:
        partial.write_text("\n".join(sections))
    return path


def _read(path: Path) -> Report:
    content: Report = json.loads(path.read_text())
    return content


def _head(learned: Report) -> str:
    found = learned["findings"]
    return f"""# Interaction forces: `learned`, `wake`, `deep-set`, `learned-v0`

Written by `swarm_envs.training.force_model.card` from the JSON reports beside this file.

Interaction force on small quadrotors (types S, a Crazyflie 2.X, and L, a larger frame) from their
neighbours and the ground, in gram-force. `learned` joins the pushes of pairs, each a wake and a
network; `wake` is a closed form with 25 numbers; `deep-set` is the heterogeneous deep
set of Neural-Swarm2 (eq. 10), and `learned-v0` the one that was called `learned` before. All are
fitted by our own trainer to the same rows.

## Data

The public flight logs of the Neural-Swarm authors (aerorobotics/neural-swarm, commit 48b1851),
which **states no licence**: the logs are not part of this project, and none of their files or
code is. The parameters were estimated from {found["rows"]:,} rows of 192 flights of one to three
drones, every third step of 100 Hz logs, in twelve scenarios; {found["validation_rows"]:,} rows in
five-second blocks, all robots of a flight together, are held out. SHA-256 of the table:
`{learned["data_sha256"]}`.

Filter of the rows, the authors' own: some neighbour within |dx|, |dy| <= 0.35 m, or no neighbour
at all; z > 0.07 m (S), 0.085 m (L); |f_z| <= 50 g, and f_z <= 35 g above 0.25 m. In rows of three
drones 18-27 % of the neighbours lie outside the interaction volume: the window masks them here.
"""


def _labels(learned: Report) -> str:
    offsets = learned["vehicle_offsets_g"]
    listed = ", ".join(f"{vehicle}: {value:+.2f}" for vehicle, value in offsets.items())
    return f"""## Labels and calibration offsets

The label is mass times acceleration minus modelled thrust. Far from everything it is not zero but
biased, by vehicle and by flight: in flights of a lone large drone above the ground effect its mean
goes from +0.3 to +4.7 g, and between the thirds of one such flight by 0.6 g (median). That is error
of mass, thrust curve and battery, not air, so it is taken out of the labels. Rule:
{learned["offset_rule"]}.

Offsets of the vehicles, g: {listed}.

The vertical drag below is taken out of the labels too, since it is added back to the force.
"""


def _function(learned: Report) -> str:
    c = learned["config"]
    return f"""## Function and training of `learned`

Each pair of types has a wake as below, with numbers of its own, and a ReLU network 5-32-32-2 that
corrects it; each type has a network 3-16-16-1 for the ground. Inputs are the same however the swarm
is turned about the vertical, or mirrored. Pushes are never negative and join as (sum push^q)^(1/q);
near the ground a share of them is lost. Wakes, networks, delay, q and the share are fitted
together. Pairs fade over the outer 0.1 m (lateral, edge 0.35 m) and 0.3 m (vertical, edge 1.1 m);
inputs are clamped to the measured range; the ground's network at {c["anchor_height_m"]} m is
subtracted, so a lone drone at or above that height gets exactly zero. The second output of a pair's
network leans its push towards the axis of the wake; it learns from the horizontal labels, with
offsets by flight taken out, and changes nothing of the vertical fit.

SOAP {c["learning_rate"]}, cosine to zero, {c["epochs"]:g} passes in batches of {c["batch_size"]},
seed {c["seed"]}, mean squared error; after each step every weight matrix whose spectral norm
exceeds {c["max_spectral_norm"]:g}^2 is scaled down to it. Left out after
short trials on some of the flights: noise on the neighbours' positions together with weights by
type, four teachers, the upper drone's own speed as further inputs (0.1 g^2 better in an early
variant). Not tried: a history of the neighbours' states, and their thrust.
"""


def _making(reports: dict[str, Report]) -> str:
    learned, wake = reports["learned"], reports["wake"]
    data = wake["provenance"]["data"]
    return f"""## How they were made

```
{learned["command"]}
{reports["deep-set"]["command"]}
{reports["learned-v0"]["command"]}
python -m swarm_envs.training.force_model --mode measured --data {data} --out DIR
python -m swarm_envs.training.force_model.wake_fit --data {data} --out DIR
python -m swarm_envs.training.force_model.compare --data {data} --out DIR
python -m swarm_envs.training.force_model.card --weights DIR
```
In this order: `learned`, `deep-set`, `learned-v0`, the fit in measured mode, `wake`, the comparison
and this card. Seed {learned["config"]["seed"]}; {learned["wall_time_s"]:.0f} s for `learned` with
its evaluation on a share of a core of a busy machine, {wake["provenance"]["wall_time_s"]:.0f} s for
the closed form.
"""


if __name__ == "__main__":
    write_card(tyro.cli(CardConfig, description="Write the model card from the reports."))
