"""The model card of the weights that ship, written from their JSON reports.

`python -m swarm_envs.training.force_model.card --weights DIR` reads `learned.json` and
`wake.json` there and writes `MODEL_CARD.md` beside them, so that no number is copied by hand.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from swarm_envs.files import written_whole
from swarm_envs.training.force_model.card_sections import (
    Report,
    axis_section,
    drag_section,
    errors_section,
    limits_section,
    lipschitz_section,
    wake_section,
)


@dataclass(frozen=True, kw_only=True)
class CardConfig:
    """Where the reports are."""

    weights: Path
    """folder with `learned.json` and `wake.json`; the card is written there"""
    measured: Path | None = None
    """report of a fit with `--mode measured`; by default `measured.json` in `weights`"""


def write_card(config: CardConfig) -> Path:
    """Write `MODEL_CARD.md` and return its path."""
    learned = _read(config.weights / "learned.json")
    wake = _read(config.weights / "wake.json")
    measured = _read(config.measured or config.weights / "measured.json")
    sections = (
        _head(learned),
        _labels(learned),
        _function(learned),
        errors_section(learned, measured, wake),
        axis_section(learned),
        lipschitz_section(learned),
        drag_section(learned),
        limits_section(learned),
        wake_section(wake, learned),
        _making(learned, wake),
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
    return f"""# Interaction forces: `learned.safetensors` and `wake.json`

Written by `swarm_envs.training.force_model.card` from `learned.json`, `measured.json` and
`wake.json` beside this file.

Vertical interaction force on small quadrotors (types S, a Crazyflie 2.X, and L, a larger frame)
from their neighbours and the ground, in gram-force. `learned.safetensors` is the heterogeneous
deep set of Neural-Swarm2 (eq. 10), fitted by our own trainer; `wake.json` is a closed form with
{_wake_count()} numbers, fitted to the same rows.

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


def _wake_count() -> int:
    return 4 * 4 + 3 * 2 + 3


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
    return f"""## Function and training

phi of S, L: 6-25-40-40-20; phi of the environment: 4-25-40-40-20 on (-z, -v); rho of S, L:
20-40-40-40-1; ReLU. Added to the paper's form, in training and in use alike: pairs fade over the
outer 0.1 m (lateral, edge 0.35 m) and 0.3 m (vertical, edge 1.1 m) of the interaction volume;
inputs are clamped to the measured range; and the baseline rho(phi_env at {c["anchor_height_m"]} m)
is subtracted, so a lone drone at or above {c["anchor_height_m"]} m gets exactly zero from the
network.

Adam {c["learning_rate"]}, cosine to zero, {c["steps"]} steps of {c["batch_size"]} rows, seed
{c["seed"]}; after each step every weight matrix whose spectral norm exceeds
{c["max_spectral_norm"]} is scaled down to it. The weights are those of the last step: validation
chose none of them, but it was looked at while the settings below were chosen, and the on-axis
forces too.
- Rows are turned and mirrored at random (eight symmetries of the square).
- Squared errors are weighed by the inverse mean square label of the drone's type to the power
  {c["balance"]}, or the large drones' noise drowns the small ones' forces.
- Neighbours' relative positions and velocities get noise of {c["position_jitter_m"]} m and
  {c["velocity_jitter"]} m/s: without it the ReLU network overshoots on the axis.
- On {c["slope_inputs"]} random inputs per step, slopes above {c["slope_limit"]} g per m (or m/s)
  are penalised (weight {c["slope_weight"]}), or the force becomes steep where nothing was measured.
"""


def _making(learned: Report, wake: Report) -> str:
    data = wake["provenance"]["data"]
    return f"""## How it was made

```
{learned["command"]}
python -m swarm_envs.training.force_model --mode measured --data {data} --out DIR2
python -m swarm_envs.training.force_model.wake_fit --data {data} --out DIR
python -m swarm_envs.training.force_model.card --weights DIR
```
Seed {learned["config"]["seed"]}; {learned["wall_time_s"]:.0f} s on one core of a busy machine for
the network with its evaluation, {wake["provenance"]["wall_time_s"]:.0f} s for the closed form.
"""


if __name__ == "__main__":
    write_card(tyro.cli(CardConfig, description="Write the model card from the reports."))
