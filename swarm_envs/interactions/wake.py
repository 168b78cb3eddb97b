"""The model `wake`: downwash in closed form, fitted to the measured flights.

Below each drone there is a jet. At depth dz the jet has the width w = w0 + S dz, and exerts on a
drone at lateral distance r the downward force

    A (w0 / w)^p exp(-(r / w)^2 / 2) s(dz / 3 cm),   s the logistic function,

which vanishes above the jet's drone. The jet is tilted: its axis at depth dz is at the position at
which the upper drone was when the jet left it, by its own velocity (the relative velocity fits the
flights less well). Several jets exert less than their sum: (sum_k f_k^q)^(1/q). Near the ground the
downwash is reduced, and a drone has lift (ground effect). There is also linear drag.
"""

from __future__ import annotations

import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.compiled import equation
from swarm_envs.interactions.field import LOWEST_HEIGHT, ONSET, WAKE, ForceField, empty_field
from swarm_envs.interactions.packed import PackedField, Scratch
from swarm_envs.vehicles import GRAM_FORCE

FORMAT = "wake-1"  # The format name in files


def wake_field(parameters: dict[str, Any]) -> ForceField:
    """Return the force field of fitted parameters, in the format of `weights/wake.json`."""
    types = parameters["types"]
    field = empty_field(len(types))
    for a, upper in enumerate(types):
        for b, lower in enumerate(types):
            fit = parameters["pair"][f"{upper}>{lower}"]
            field.wake_pair[a, b] = fit["A_g"] * GRAM_FORCE, fit["w0_m"], fit["S"], fit["p"]
        lift = parameters["ground"][upper]
        field.wake_ground[a] = lift["G_g"] * GRAM_FORCE, lift["h_m"]
        field.wake_delay[a] = 1.0 / parameters["advection_speed"][upper]
        field.drag[a] = parameters["drag"][upper]
    mitigation, measured = parameters["mitigation"], parameters["input_range"]
    return field._replace(
        kind=WAKE,
        environment_range=np.array(measured["environment"], dtype=np.float64),
        pair_range=np.array(measured["pair"], dtype=np.float64),
        wake_combine=float(parameters["combine_q"]),
        wake_mitigation=np.array([mitigation["M"], mitigation["hm_m"]]),
    )


def load_wake(path: Path | None = None) -> tuple[tuple[str, ...], ForceField, dict[str, Any]]:
    """Return types, field and notes of the shipped model, or of a file of `swarm-envs fit`.

    Raises:
        ValueError: the file is damaged.
        FileNotFoundError: the file does not exist.
    """
    if path is None:
        file = resources.files("swarm_envs.interactions").joinpath("weights/wake.json")
        parameters = json.loads(file.read_text())
        return tuple(parameters["types"]), wake_field(parameters), {}
    if not path.is_file():
        raise FileNotFoundError(
            f"wake file {str(path)!r} does not exist; give the path of a file of `swarm-envs fit`"
        )
    try:
        parameters = json.loads(path.read_text(encoding="utf-8-sig"))
        _check(parameters)
        field = wake_field(parameters)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise ValueError(
            f"wake file {str(path)!r} is damaged or not a {FORMAT!r} file ({error}); fit it again "
            "by `swarm-envs fit --model wake`"
        ) from error
    return tuple(parameters["types"]), field, parameters


def _check(parameters: object) -> None:
    """Raise ValueError for invalid parameters, and for a model that kernels do not implement."""
    if not isinstance(parameters, dict) or parameters.get("format") != FORMAT:
        raise ValueError("it has another format")
    if parameters["advection_velocity"] != "neighbor":
        raise ValueError(
            f"advection_velocity is {parameters['advection_velocity']!r}, but must be 'neighbor'"
        )
    field = wake_field(parameters)
    for array in field:
        if not np.isfinite(array).all():
            raise ValueError("it has a number that is not finite")
    q, (lost, height) = field.wake_combine, field.wake_mitigation
    if q < 1.0 or not 0.0 <= lost <= 1.0 or height <= 0.0:
        raise ValueError(
            f"combine_q is {q:g}, M {lost:g} and hm_m {height:g}, but q must be at least 1, M 0 to "
            "1, and hm_m above 0"
        )
    if (field.wake_pair < 0.0).any() or (field.wake_pair[..., 1] == 0.0).any():
        raise ValueError("pair has a negative number, or a wake without width")
    if (field.wake_delay < 0.0).any() or (field.wake_ground < 0.0).any():
        raise ValueError("advection_speed or ground has a negative number")
    if (field.wake_ground[:, 1] == 0.0).any():
        raise ValueError("ground has a height h_m of 0")


@equation
def wake_forces(field: PackedField, total: int, scratch: Scratch) -> None:
    """Add the wake and ground forces on the first `total` drones, after `find_pairs`."""
    model, ground_effect = field.constants[0], field.constants[0]["wake_ground"]
    q, mitigation = model["wake_combine"], model["wake_mitigation"]
    for slot in range(total):
        scratch.drones[slot]["pushed"] = 0.0
    for at in range(scratch.counters[0]["pairs"]):
        pair = scratch.pairs[at]
        lower, upper = scratch.drones[pair["i"]], scratch.drones[pair["j"]]
        here, there, speed = lower["position"], upper["seen"], upper["velocity"]
        dx, dy, dz = there[0] - here[0], there[1] - here[1], there[2] - here[2]
        delay = max(dz, 0.0) * model["wake_delay"][upper["type"]]
        x, y = dx - speed[0] * delay, dy - speed[1] * delay
        fit, lateral = model["wake_pair"][upper["type"], lower["type"]], math.sqrt(x * x + y * y)
        width = fit[1] + fit[2] * max(dz, 0.0)
        aside = lateral / width
        shape = (fit[1] / width) ** fit[3] * math.exp(-0.5 * (aside * aside))
        force = fit[0] * shape / (1.0 + math.exp(-dz / ONSET))
        lower["pushed"] += (pair["weight"] * force) ** q
    for slot in range(total):
        drone = scratch.drones[slot]
        height, own = max(drone["position"][2], LOWEST_HEIGHT), ground_effect[drone["type"]]
        lost = mitigation[0] * math.exp(-height / mitigation[1])
        lift = own[0] * math.exp((LOWEST_HEIGHT - height) / own[1])
        drone["force"][2] += lift - (1.0 - lost) * drone["pushed"] ** (1.0 / q)
