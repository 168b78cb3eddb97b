"""A trained policy as a C99 header: float32, no heap, for the processor of a real drone.

Everything between what drones know of each other and the set-point stands in it: who is near,
what the network is told, the network, and what its actions do to the set-point.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

import swarm_envs
from swarm_envs.agents import c_source, c_steering
from swarm_envs.agents.c_samples import SAMPLES, samples
from swarm_envs.agents.c_words import constants, feature_words
from swarm_envs.agents.feature_sets import REFERENCE
from swarm_envs.agents.networks import ANY, Layers, Network
from swarm_envs.agents.policy_file import Policy
from swarm_envs.c_text import array, check_prefix, comment, enumeration, filled
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

CYCLES_PER_PRODUCT, CYCLES_PER_FUNCTION, CLOCK_HZ = 6.0, 150.0, 168e6
"""Assumed of a Cortex-M4F (STM32F405) that runs from flash: load two numbers, multiply, add; and
one tanhf, expf or sqrtf of newlib."""
_TAKEN = ("TYPES", "SELF_TEST", "POLICY_H", "NEIGHBOURS", "ACTIONS")


@dataclass(frozen=True)
class Costs:
    """What one decision takes."""

    weights: int
    """Numbers of all networks."""
    products: int
    """Multiply-adds of one decision with every neighbour there."""
    functions: int
    """Calls of tanhf, expf and sqrtf."""
    stack_bytes: int
    """About."""

    @property
    def flash_bytes(self) -> int:
        """Read-only memory that the weights take."""
        return 4 * self.weights

    @property
    def microseconds(self) -> float:
        """Estimated on an STM32F405; see `CYCLES_PER_PRODUCT`."""
        cycles = CYCLES_PER_PRODUCT * self.products + CYCLES_PER_FUNCTION * self.functions
        return cycles / CLOCK_HZ * 1e6


def policy_header(policy: Policy, name: str = "policy", seed: int = 0) -> str:
    """Source of a header that decides as a policy does.

    Args:
        policy: of any kind that is trained here.
        name: prefix of everything that the header defines.
        seed: from which the states of the header's self-test are drawn.

    Raises:
        ValueError: the name cannot begin an identifier of C.
    """
    check_prefix(name)
    note, sizes = policy.note, policy.note.sizes
    width, types = ACTIONS[note.action].width, tuple(VEHICLES)
    words = {
        "name": name,
        "NAME": name.upper(),
        "provenance": comment(_provenance(policy)),
        "meaning": "\n".join(f" * {line}" for line in _meaning(policy, name)),
        "costs": comment(_costs_told(policy)),
        "rate": str(note.decision_rate),
        "neighbours": str(note.num_neighbors),
        "places": str(max(note.num_neighbors, 1)),
        "actions": str(width),
        "types": enumeration(name.upper(), types, _TAKEN),
        "widest": str(_widest(policy)),
        "own_width": str(sizes.own),
        "neighbour_width": str(sizes.neighbor),
        "samples": str(SAMPLES),
        **_networks(policy, name),
        **feature_words(policy),
        **constants(policy),
        **samples(policy, np.random.default_rng(seed)),
    }
    return filled(filled("".join(_texts(policy)), words), words)


def _texts(policy: Policy) -> list[str]:
    kept = policy.note.features == REFERENCE
    steers = {
        "acceleration": [c_steering.SETPOINT, c_steering.STEER_ACCELERATION],
        "velocity": [c_steering.SETPOINT, c_steering.STEER_VELOCITY],
    }
    return [
        c_source.HEAD,
        c_source.REFERENCE if kept else c_source.GOAL,
        c_source.DEEP_SET if policy.note.encoder == "deep-set" else c_source.MLP,
        c_source.ACT,
        *steers.get(policy.note.action, []),
        c_steering.TEST,
    ]


def _provenance(policy: Policy) -> list[str]:
    note = policy.note
    told = f"{note.encoder}, features {note.features}, teams of {note.teams} drones"
    lines = [
        f"policy for {note.task}: {told}",
        f"weights: SHA-256 {policy.digest}",
        f"exported by swarm-envs {swarm_envs.__version__}",
    ]
    config = policy.provenance.get("config")
    if isinstance(config, Mapping):
        chosen = [f"{k} {config[k]}" for k in ("algo", "steps", "seed") if k in config]
        lines.append(f"trained by {', '.join(chosen)}" if chosen else json.dumps(config)[:80])
    if note.types:
        lines.append(f"trained with vehicles {', '.join(note.types)}, and refuses others")
    return lines


def _meaning(policy: Policy, name: str) -> list[str]:
    mode = policy.note.action
    if mode in ("acceleration", "velocity"):
        limits = f"{ACCELERATION_LIMIT:g} m/s^2 and {SPEED_LIMIT:g} m/s"
        return [
            f"Actions are {mode}s of the set-point over its limit ({limits}); {name}_steer() and",
            f"{name}_advance() move it as the simulator does. Let the controller follow it.",
        ]
    return [f"What actions mean: action {mode!r} of swarm_envs.envs.actions."]


def costs(policy: Policy) -> Costs:
    """What one decision takes with every neighbour there."""
    note, sizes = policy.note, policy.note.sizes
    networks = policy.networks.values()
    weights = sum(_numbers(part) for n in networks for part in _parts(n))
    actors = [_products(n.layers) for n in networks]
    codes = [max(map(_products, n.phi.values())) if n.phi else (0, 0) for n in networks]
    products = max(a[0] for a in actors) + note.num_neighbors * max(c[0] for c in codes)
    hidden = max(a[1] for a in actors) - ACTIONS[note.action].width
    tanhs = hidden + note.num_neighbors * max(c[1] for c in codes)
    told = 1 + note.num_neighbors * (2 if note.features == REFERENCE else 5)
    rows = 4 if note.encoder == "deep-set" else 2
    stack = 4 * (rows * _widest(policy) + sizes.neighbor) + 8 * note.num_neighbors + 200
    return Costs(weights, products, tanhs + told, stack)


def _parts(network: Network) -> list[Layers]:
    return [network.layers, *(network.phi or {}).values()]


def _numbers(layers: Layers) -> int:
    return sum(weight.size + bias.size for weight, bias in layers)


def _products(layers: Layers) -> tuple[int, int]:
    """Multiply-adds, and outputs of all layers."""
    return sum(w.size for w, _ in layers), sum(b.size for _, b in layers)


def _costs_told(policy: Policy) -> list[str]:
    found = costs(policy)
    return [
        f"read-only memory: {found.flash_bytes} bytes of weights",
        f"stack: about {found.stack_bytes} bytes; no other RAM",
        f"a decision: {found.products} multiply-adds, {found.functions} of tanhf, expf and sqrtf",
        f"estimated {found.microseconds:.0f} us on an STM32F405 at {CLOCK_HZ / 1e6:g} MHz, if a "
        f"multiply-add takes {CYCLES_PER_PRODUCT:g}",
        f"cycles and a call {CYCLES_PER_FUNCTION:g}; measure on your target before you rely on it",
    ]


def _widest(policy: Policy) -> int:
    sizes = policy.note.sizes
    layers = [layer for n in policy.networks.values() for part in _parts(n) for layer in part]
    return max(sizes.own, sizes.neighbor, *(max(weight.shape) for weight, _ in layers))


def _networks(policy: Policy, name: str) -> dict[str, str]:
    """Tables of weights, and of networks by the type of who acts and who is seen."""
    types = tuple(VEHICLES)
    tables: list[tuple[str, str]] = []
    actors: list[str] = []
    phis: list[str] = []
    inner: tuple[str, ...] = (ANY,)
    for owner in (ANY,) if ANY in policy.networks else types:
        network = policy.networks.get(owner)
        place = f"{name}_actor_{len(actors)}"
        actors.append(_network(place, network.layers if network else None, tables))
        if network is not None and network.phi is not None:
            inner = (ANY,) if ANY in network.phi else types
        phi = (network.phi if network else None) or {}
        found = [
            _network(f"{name}_phi_{len(phis)}_{k}", phi.get(token), tables)
            for k, token in enumerate(inner)
        ]
        phis.append("{" + ", ".join(found) + "}")
    lines = [f"static const struct {name}_network {name}_actors[] = {{{', '.join(actors)}}};"]
    if policy.note.encoder == "deep-set":
        rows = ", ".join(phis)
        lines.append(
            f"static const struct {name}_network {name}_phis[][{len(inner)}] = {{{rows}}};"
        )
    who = "0" if ANY in policy.networks else "self->type"
    weights = [text for kind, text in tables if kind == "weights"]
    layers = [text for kind, text in tables if kind == "layers"]
    return {
        "tables": "\n".join(weights),
        "networks": "\n".join([*layers, *lines]),
        "actor_of": f"&{name}_actors[{who}]",
        "phi_of": f"&{name}_phis[{who}][{'0' if inner == (ANY,) else 'o->type'}]",
    }


def _network(place: str, layers: Layers | None, tables: list[tuple[str, str]]) -> str:
    """Initialiser of a network, whose numbers are added to the tables."""
    if layers is None:
        return "{0, 0}"
    rows = []
    for k, (weight, bias) in enumerate(layers):
        numbers = np.column_stack([bias, weight]).ravel()
        tables.append(("weights", array(f"{place}_{k}", numbers)))
        rows.append(f"{{{place}_{k}, {weight.shape[1]}, {weight.shape[0]}}}")
    prefix = place.rsplit("_actor_", 1)[0].rsplit("_phi_", 1)[0]
    tables.append(
        ("layers", f"static const struct {prefix}_layer {place}[] = {{{', '.join(rows)}}};")
    )
    return f"{{{place}, {len(rows)}}}"
