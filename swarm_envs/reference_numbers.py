"""The parameters of `swarm_envs.reference`, as arrays of NumPy, torch or JAX.

They are arguments of its functions, so that they can be replaced, and differentiated by.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from swarm_envs.control.config import ControllerConfig, gains
from swarm_envs.interactions.base import InteractionModel, load
from swarm_envs.interactions.field import COMPOSED, DEEP_SET, NO_LIMIT, PAIRWISE, ForceField
from swarm_envs.interactions.packed import layers_of
from swarm_envs.state import FloatArray, IntArray, Parameters, parameters
from swarm_envs.vehicles import Vehicle, parse_team

__all__ = ["Numbers", "aerodynamics_of", "bodies_of", "gains_of"]

Numbers = dict[str, Any]
"""Parameters by name: arrays, numbers, and layers of networks."""


def bodies_of(team: str | Sequence[Vehicle], xp: ModuleType = np) -> Parameters:
    """Return masses, inertias etc. of a team, (N, ...), as arrays of the library `xp`."""
    return Parameters(*(xp.asarray(value) for value in parameters(parse_team(team))))


def gains_of(
    config: ControllerConfig | None = None, dt: float = 1.0 / 240.0, xp: ModuleType = np
) -> Numbers:
    """Return the parameters of a controller for steps of dt, s, as arrays of the library `xp`.

    | name | |
    |---|---|
    | `position`, `velocity`, `integral` | Lambda_p, K_v / m, Gamma_v, 1/s |
    | `attitude`, `rate`, `rate_integral` | (3,) Lambda_q, K_w / J, 1/s, Gamma_w / J, 1/s^2 |
    | `lead` | 1 if the motor lag is compensated, eq. (22), else 0 |
    | `thrust_rate_blend`, `desired_rate_blend`, `rate_error_blend` | 1 - exp(-2 pi f dt) |
    | `velocity_integral_limit`, `rate_integral_limit` | largest integrals, m, rad |
    | `min_vertical_thrust_fraction` | least vertical part of f_d over the weight |

    Raises:
        ValueError: the configuration has adaptation, or dt is not positive.
    """
    chosen = ControllerConfig() if config is None else config
    if chosen.adaptation is not None:
        raise ValueError(
            f"adaptation is {chosen.adaptation}, but must be None: the reference has no adaptation"
        )
    found = gains(chosen, dt)
    return {
        **{name: found[f"{name}_gain"] for name in ("position", "velocity", "integral")},
        **{
            name: xp.asarray(np.array([found[f"{name}_tilt"]] * 2 + [found[f"{name}_yaw"]]))
            for name in ("attitude", "rate", "rate_integral")
        },
        **{name: found[name] for name in _LOW_PASSES_AND_LIMITS},
    }


_LOW_PASSES_AND_LIMITS = (
    "lead",
    "thrust_rate_blend",
    "desired_rate_blend",
    "rate_error_blend",
    "velocity_integral_limit",
    "rate_integral_limit",
    "min_vertical_thrust_fraction",
)


def aerodynamics_of(
    model: str | InteractionModel, team: str | Sequence[Vehicle], xp: ModuleType = np
) -> Numbers:
    """Return the parameters of a force model for N drones, as arrays of the library `xp`.

    Those of drones are (N, ...). Those of pairs are (N, N-1, ...), for the force on drone i, the
    row, by each of the other drones, which `others` lists.

    | name | of | |
    |---|---|---|
    | `others` | | (N (N-1),) indices of the other drones for each drone, row by row |
    | `strength`, `width`, `spread`, `decay` | pairs | A (N), w0 (m), S, p of a jet |
    | `delay` | pairs | delay of the other drone's jet per depth, s/m |
    | `combine`, `mitigation` | | q; M and its decay height, m |
    | `lift`, `cushion` | drones | ground effect at 7 cm, N, and its decay height, m |
    | `drag` | drones | c (N, 3), N s/m |
    | `sides`, `depth` | | distances at which the weight of a pair begins to fade, and is 0, m |
    | `own_range`, `pair_range` | | (2, 4), (2, 6): least and largest measured (-z, -v), x_ij |
    | `anchor` | | height z_a above which the force on a lone drone is only drag, m |
    | `pair`, `own` | pairs, drones | networks of `learned` |
    | `phi`, `phi_env`, `rho` | pairs, drones, drones | networks of `deep-set` |

    Raises:
        ValueError: the model is a function or a sum of pairs, or lacks a vehicle's type.
    """
    found, drones = load(model), parse_team(team)
    field, own = found.field, found.type_indices(drones)
    if found.function is not None or field.kind == PAIRWISE:
        raise ValueError(
            f"interaction model {found.name!r} has no equations in swarm_envs.reference; use "
            "'wake', 'learned', 'deep-set', or a file that was fitted as one of these"
        )
    count = len(drones)
    others = np.array([[j for j in range(count) if j != i] for i in range(count)], np.int64)
    other_types = own[others.reshape(count, count - 1)]
    strength, width, spread, decay = np.moveaxis(field.wake_pair[other_types, own[:, None]], -1, 0)
    arrays = {
        "others": others.ravel(),
        "strength": strength,
        "width": width,
        "spread": spread,
        "decay": decay,
        "delay": field.wake_delay[other_types],
        "lift": field.wake_ground[own, 0],
        "cushion": field.wake_ground[own, 1],
        "drag": field.drag[own],
        "own_range": field.environment_range,
        "pair_range": field.pair_range,
    }
    networks = _networks(field, own, other_types)
    return {
        **{name: xp.asarray(value) for name, value in arrays.items()},
        **{
            name: [(xp.asarray(weight), xp.asarray(bias)) for weight, bias in layers]
            for name, layers in networks.items()
        },
        "combine": field.wake_combine,
        "mitigation": tuple(field.wake_mitigation.tolist()),
        "sides": tuple(field.window[:2].tolist()),
        "depth": tuple(field.window[2:].tolist()),
        "anchor": field.anchor_height or NO_LIMIT,
    }


Layers = list[tuple[FloatArray, FloatArray]]


def _networks(field: ForceField, own: IntArray, other_types: IntArray) -> dict[str, Layers]:
    """Return networks by name, with one for each drone or pair."""
    kinds, none = len(field.drag), np.zeros_like(own)

    def chosen(first: int, number: int, index: IntArray) -> Layers:
        layers = zip(*(layers_of(field, first + n) for n in range(number)), strict=True)
        stacked = [[np.stack(parts) for parts in zip(*layer, strict=True)] for layer in layers]
        return [(weight[index], bias[index]) for weight, bias in stacked]

    if field.kind == COMPOSED:
        pairs = kinds * kinds
        pair = chosen(0, pairs, other_types * kinds + own[:, None])
        return {"pair": pair, "own": chosen(pairs, kinds, own)}
    if field.kind == DEEP_SET:
        return {
            "phi": chosen(0, kinds, other_types),
            "phi_env": chosen(kinds, 1, none),
            "rho": chosen(kinds + 1, kinds, own),
        }
    return {}
