"""A trained policy as a C99 header: float32, no heap, for the processor of a real drone.

It holds everything between what drones know of each other and the set-point: who is near, the
features, the network, and what its actions do to the set-point. The C text is that of the templates
in `swarm_envs/c_templates/policy/`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import swarm_envs
from swarm_envs.agents import features
from swarm_envs.agents.features import FORCE_WIDTH, FULL, LOAD_WIDTH, OWN_WIDTH, REFERENCE, TYPES
from swarm_envs.agents.networks import ANY, Layers
from swarm_envs.agents.policy import Policy
from swarm_envs.c_text import (
    array_definition,
    array_rows,
    check_prefix,
    comment_lines,
    fill_templates,
    literal,
    type_enumeration,
)
from swarm_envs.envs.actions import ACCELERATION_LAG, ACTIONS
from swarm_envs.envs.observation import Float32Array, observation_layout, observation_width
from swarm_envs.tasks.base import ACCELERATION_LIMIT, SPEED_LIMIT
from swarm_envs.vehicles import VEHICLES

__all__ = ["costs", "policy_header"]

CYCLES_PER_PRODUCT, CYCLES_PER_FUNCTION, CLOCK_HZ = 6.0, 150.0, 168e6
"""Assumed of a Cortex-M4F (STM32F405) that runs from flash: load two numbers, multiply, add; and
one tanhf, expf or sqrtf of newlib."""
SAMPLES = 16  # states in the header's self-test
_UNSEEN = 2  # at most as many others, in these states, beyond those that the policy observes
_TAKEN = ("TYPES", "SELF_TEST", "POLICY_H", "NEIGHBOURS", "ACTIONS")
_STEERING = ("acceleration", "velocity")  # actions that move a set-point
_MOTIONS = ("position", "velocity", "acceleration")
_GOAL_OWN = "    float time_left;   /* share of the clock that is left, from 1 to 0 */"
_REFERENCE_OWN = """\
    float reference_position[3];     /* where it should be now, m */
    float reference_velocity[3];     /* m/s */
    float reference_acceleration[3]; /* m/s^2 */"""
_LOADS = ("thrust_margin", "mass_ratio", "battery")
_DRONE_LOAD = """
    float thrust_margin; /* largest thrust at this charge over the weight, less 1 */
    float mass_ratio;    /* mass over 34 g */
    float battery;       /* charge, from 0 to 1 */"""
_OWN_FORCE = "\n    float force[3]; /* predicted force of the air over the weight, world frame */"
_OWN_OBSTACLES = """
    int obstacles;               /* how many of these there are, nearest first */
    float obstacle[%d][3];        /* from it to the nearest point of each, m */"""
_POOLED = {
    "mean": "count > 0 ? sum[k] / (float)count : 0.0f",
    "sum": "sum[k]",
    "max": "count > 0 ? largest[k] : 0.0f",
}  # of each way of pooling: what comes out
_ACTIVE = {"tanh": "tanhf(sum)", "relu": "(sum > 0.0f ? sum : 0.0f)"}  # after a hidden layer


@dataclass(frozen=True)
class Costs:
    """What one decision takes."""

    weights: int  # numbers of all networks
    products: int  # multiply-adds of one decision with every neighbour there
    functions: int  # calls of tanhf, expf and sqrtf
    stack_bytes: int  # about

    @property
    def flash_bytes(self) -> int:
        """Read-only memory that the weights take."""
        return 4 * self.weights

    @property
    def microseconds(self) -> float:
        """Estimated on an STM32F405; see `CYCLES_PER_PRODUCT`."""
        cycles = CYCLES_PER_PRODUCT * self.products + CYCLES_PER_FUNCTION * self.functions
        return cycles / CLOCK_HZ * 1e6


def costs(policy: Policy) -> Costs:
    """What one decision takes with every neighbour there."""
    note, sizes = policy.note, policy.note.sizes
    networks = policy.networks.values()
    actors = [_products(network.layers) for network in networks]
    codes = [_products((*(n.phi or ()), *(n.score or ()))) for n in networks]
    products = max(a[0] for a in actors) + note.num_neighbors * max(c[0] for c in codes)
    hidden = max(a[1] for a in actors) - ACTIONS[note.action].width
    tanhs = hidden + note.num_neighbors * max(c[1] for c in codes)
    if note.activation == "relu":
        tanhs = note.num_neighbors * (note.encoder == "attention")
    per_neighbor = {REFERENCE: 2, FULL: 8}.get(note.features, 5)
    lengths = 1 + note.num_neighbors * per_neighbor
    lengths += (3 + 2 * note.num_obstacles) * (note.features == FULL)
    rows = 2 if note.encoder == "mlp" else 4
    kept = note.num_neighbors * _code(policy) if note.encoder == "attention" else 0
    stack = 4 * (rows * _widest(policy) + sizes.neighbor + kept) + 8 * note.num_neighbors + 200
    weights = sum(weight.size + bias.size for weight, bias in _all_layers(policy))
    return Costs(weights, products, tanhs + lengths, stack)


def _all_layers(policy: Policy) -> list[tuple[Float32Array, Float32Array]]:
    parts = [part for n in policy.networks.values() for part in (n.layers, n.phi, n.score)]
    return [layer for layers in parts for layer in layers or ()]


def _code(policy: Policy) -> int:  # width of a set's codes; 1 where there is no set
    return max(len(n.phi[-1][1]) if n.phi else 1 for n in policy.networks.values())


def _products(layers: Layers) -> tuple[int, int]:  # multiply-adds, and outputs of all layers
    return sum(w.size for w, _ in layers), sum(b.size for _, b in layers)


def _widest(policy: Policy) -> int:
    sizes = policy.note.sizes
    shapes = [max(weight.shape) for weight, _ in _all_layers(policy)]
    return max(sizes.own, sizes.neighbor, *shapes)


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
    kind = {REFERENCE: "reference", FULL: "full"}.get(note.features, "goal")
    steering = ["setpoint", note.action] if note.action in _STEERING else []
    helpers = ["cut"] * (kind == "full") + ["obstacles"] * bool(note.num_obstacles)
    parts = ["head", *helpers, f"{kind}_features", note.encoder, "act", *steering, "self_test"]
    words = {
        "name": name,
        "NAME": name.upper(),
        "provenance": comment_lines(_provenance(policy)),
        "meaning": "\n".join(f" * {line}" for line in _meaning(policy, name)),
        "costs": comment_lines(_cost_lines(policy)),
        "rate": str(note.decision_rate),
        "neighbours": str(note.num_neighbors),
        "places": str(max(note.num_neighbors, 1)),
        "actions": str(ACTIONS[note.action].width),
        "types": type_enumeration(name.upper(), tuple(VEHICLES), _TAKEN),
        "widest": str(_widest(policy)),
        "own_width": str(sizes.own),
        "neighbour_width": str(sizes.neighbor),
        "reference": str(OWN_WIDTH + len(TYPES)),
        "samples": str(SAMPLES),
        **_network_words(policy, name),
        **_feature_words(policy, name),
        **_constants(policy),
        **_self_test_words(policy, np.random.default_rng(seed)),
    }
    return fill_templates([f"policy/{part}.h" for part in parts], words)


def _provenance(policy: Policy) -> list[str]:
    note = policy.note
    lines = [
        f"policy for {note.task}: {note.encoder}, features {note.features}, "
        f"teams of {note.teams} drones",
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
    if mode in _STEERING:
        limits = f"{ACCELERATION_LIMIT:g} m/s^2 and {SPEED_LIMIT:g} m/s"
        return [
            f"An action is the set-point's {mode} over its limit ({limits}); {name}_steer() and",
            f"{name}_advance() move it as the simulator does. Let the controller follow it.",
        ]
    return [f"What actions mean: action {mode!r} of swarm_envs.envs.actions."]


def _cost_lines(policy: Policy) -> list[str]:
    found = costs(policy)
    return [
        f"read-only memory: {found.flash_bytes} bytes of weights",
        f"stack: about {found.stack_bytes} bytes; no other RAM",
        f"a decision: {found.products} multiply-adds, {found.functions} of tanhf, expf and sqrtf",
        f"estimated {found.microseconds:.0f} us on an STM32F405 at {CLOCK_HZ / 1e6:g} MHz, if a "
        f"multiply-add takes {CYCLES_PER_PRODUCT:g}",
        f"cycles and a call {CYCLES_PER_FUNCTION:g}; measure on your target before you rely on it",
    ]


def _network_words(policy: Policy, name: str) -> dict[str, str]:
    """Tables of weights, and of networks by the type of who acts and who is seen."""
    weights: list[str] = []
    layers: list[str] = []

    def define(place: str, network: Layers | None) -> str:
        """Add a network's tables, and give its initialiser."""
        if network is None:
            return "{0, 0}"
        rows = []
        for k, (weight, bias) in enumerate(network):
            numbers = np.column_stack([bias, weight]).ravel()
            weights.append(array_definition(f"{place}_{k}", numbers))
            rows.append(f"{{{place}_{k}, {weight.shape[1]}, {weight.shape[0]}}}")
        layers.append(f"static const struct {name}_layer {place}[] = {{{', '.join(rows)}}};")
        return f"{{{place}, {len(rows)}}}"

    owners = (ANY,) if ANY in policy.networks else tuple(VEHICLES)
    found = [policy.networks.get(owner) for owner in owners]
    for kind in ("actor", "phi", "score")[: {"mlp": 1, "deep-set": 2}.get(policy.note.encoder, 3)]:
        field = "layers" if kind == "actor" else kind
        rows = [
            define(f"{name}_{kind}_{k}", getattr(network, field) if network else None)
            for k, network in enumerate(found)
        ]
        table = f"{name}_{kind}s"
        layers.append(f"static const struct {name}_network {table}[] = {{{', '.join(rows)}}};")
    who = "0" if ANY in policy.networks else "self->type"
    return {
        "tables": "\n".join(weights),
        "networks": "\n".join(layers),
        "who": who,
        "active": _ACTIVE[policy.note.activation],
    }


def _feature_words(policy: Policy, name: str) -> dict[str, str]:
    """What differs between sets of features, and between encoders of neighbours."""
    note, sizes = policy.note, policy.note.sizes
    tracks = note.features == REFERENCE
    finite, others_finite = _finite(policy, name)
    width, code = sizes.own, _code(policy)
    pooled = [
        f"values[0][{width + j * code} + k] = {_POOLED[way]};"
        for j, way in enumerate(note.pooling.split("-"))
    ]
    known = [f"type == {k}" for k, token in enumerate(VEHICLES) if token in note.types]
    return {
        "own": _own_fields(policy),
        **_full_words(policy, name),
        "own_types": _one_hot(name, sizes.own_type, "self"),
        "neighbour_types": _one_hot(name, sizes.neighbor_type, "other"),
        "unused_goal": "; not used by this policy" if tracks else "",
        "unused_type": "" if sizes.typed else "; not used by this policy",
        "own_sound": finite,
        "other_sound": f"{name}_known(other[j].type){others_finite}",
        "known": f"return {' || '.join(known)};" if known else "(void)type; return 1;",
        "pooling": note.pooling,
        "pooled": "\n        ".join(pooled),
        "code": str(code),
    }


def _finite(policy: Policy, name: str) -> tuple[str, str]:
    """Conditions of C that what is known of the drone itself, and of another, is finite."""
    note = policy.note
    goal = [f"{name}_sound(self->goal)", "own->time_left - own->time_left == 0.0f"]
    motions = [f"{name}_sound(own->reference_{what})" for what in _MOTIONS]
    checks = {REFERENCE: motions, FULL: goal + motions}.get(note.features, goal)
    others = [] if note.features == REFERENCE else [f"{name}_sound(other[j].goal)"]
    if note.observe_load:
        checks += [f"self->{load} - self->{load} == 0.0f" for load in _LOADS]
        others += [f"other[j].{load} - other[j].{load} == 0.0f" for load in _LOADS]
    if note.observe_force:
        checks.append(f"{name}_sound(own->force)")
    if note.num_obstacles:
        checks.append(f"own->obstacles >= 0 && own->obstacles <= {note.num_obstacles}")
    gap = " &&\n                "
    return gap.join(checks), "".join(gap + check for check in others)


def _own_fields(policy: Policy) -> str:
    """What the header's structure of the drone itself holds for the policy's features."""
    note = policy.note
    fields = {REFERENCE: _REFERENCE_OWN, FULL: f"{_GOAL_OWN}\n{_REFERENCE_OWN}"}
    more = _OWN_FORCE * note.observe_force
    if note.num_obstacles:
        more += _OWN_OBSTACLES % note.num_obstacles
    return fields.get(note.features, _GOAL_OWN) + more


def _full_words(policy: Policy, name: str) -> dict[str, str]:
    """What C does with loads, a predicted force and obstacles; nothing where there are none."""
    note, load = policy.note, policy.note.observe_load
    mine = [f"\n    *more++ = self->{name};" for name in _LOADS]
    force = "\n    for (k = 0; k < 3; k++) *more++ = own->force[k];" * note.observe_force
    beside = policy.note.sizes.neighbor - LOAD_WIDTH * load - 5
    seen = [f"\n    x[{beside + 5 + k}] = other->{name};" for k, name in enumerate(_LOADS)]
    test = [f"            drones[j].{name} = *s++;\n" for name in _LOADS]
    return {
        "full_own": str(len(TYPES) + OWN_WIDTH + 10),
        "beside_at": str(beside),
        "drone_load": _DRONE_LOAD * load,
        "own_load": "".join(mine) * load,
        "own_force": force,
        "own_obstacles": f"\n    {name}_obstacles(own, x + 11, more);" * bool(note.num_obstacles),
        "obstacles": str(note.num_obstacles),
        "neighbour_load": "".join(seen) * load,
        "test_load": "".join(test) * load,
    }


def _one_hot(name: str, start: int | None, whose: str) -> str:
    """A line that writes a type among the features; none where they do not hold types."""
    if start is None:
        return ""
    types = f"{name.upper()}_TYPES"
    return f"\n    for (k = 0; k < {types}; k++) x[{start} + k] = {whose}->type == k ? 1.0f : 0.0f;"


def _constants(policy: Policy) -> dict[str, str]:
    """Lengths, limits and times that the text names."""
    step = 1.0 / policy.note.decision_rate
    values = {
        "speed": SPEED_LIMIT,
        "limit": ACCELERATION_LIMIT,
        "step": step,
        "tau": max(ACCELERATION_LAG, 0.5 * step),
        "goal_reach": features.GOAL_REACH,
        "near": features.NEAR,
        "ahead": features.AHEAD,
        "goal_seen": features.OTHERS_GOAL,
        "reach": features.REACH,
        "fast": features.FAST,
        "beside": features.BESIDE,
        "above": features.ABOVE,
    }
    return {name: literal(value) for name, value in values.items()}


class KnownState(NamedTuple):
    """What one drone knows: of all drones, itself first, and of itself alone. World frame, SI."""

    position: Float32Array  # (M, 3) m
    velocity: Float32Array  # (M, 3) m/s
    goal: Float32Array  # (M, 3) m
    types: npt.NDArray[np.int64]  # (M,) index among `VEHICLES`
    up: Float32Array  # (3,) direction of thrust
    thrust: np.float32  # Share of the largest
    setpoint: Float32Array  # (3,) m
    task: Float32Array
    """(1,) share of the clock that is left; or (9,) the reference's position, velocity and
    acceleration; or both."""
    load: Float32Array
    """(M, 3) thrust margin, mass ratio and charge; (M, 0) if they are not observed."""
    near: Float32Array
    """(...) predicted force over the weight (3), if it is observed; number of obstacles and (3) m
    to each that can be observed, if any."""


def draw_state(policy: Policy, others: int, rng: np.random.Generator) -> KnownState:
    """A state as might be met in flight, with so many others."""
    note, count = policy.note, 1 + others
    known = [k for k, token in enumerate(VEHICLES) if not note.types or token in note.types]
    position = rng.uniform([-1.0, -1.0, 0.4], [1.0, 1.0, 2.0], (count, 3))
    velocity = rng.normal(0.0, 0.5, (count, 3))
    up = rng.normal([0.0, 0.0, 1.0], 0.2)
    task = np.array([rng.uniform()])
    if note.features in (REFERENCE, FULL):
        place = position[0] + rng.normal(0.0, 0.1, 3)
        moving = [place, rng.normal(0.0, 0.5, 3), rng.normal(0.0, 0.8, 3)]
        task = np.concatenate([task] * (note.features == FULL) + moving)
    load = rng.uniform(0.2, 1.5, (count, 3 * note.observe_load))
    near: list[Any] = [rng.normal(0.0, 0.3, FORCE_WIDTH * note.observe_force)]
    if note.num_obstacles:
        ways = rng.normal(0.0, 0.8, (note.num_obstacles, 3))
        near += [[rng.integers(note.num_obstacles + 1)], ways.ravel()]
    goal = rng.uniform([-1.5, -1.5, 0.5], [1.5, 1.5, 2.0], (count, 3))
    return KnownState(
        position.astype(np.float32),
        velocity.astype(np.float32),
        goal.astype(np.float32),
        np.asarray(rng.choice(known, count)),
        (up / np.linalg.norm(up)).astype(np.float32),
        np.float32(rng.uniform(0.3, 0.8)),
        (position[0] + rng.normal(0.0, 0.05, 3)).astype(np.float32),
        task.astype(np.float32),
        load.astype(np.float32),
        np.concatenate(near).astype(np.float32),
    )


def _observation_row(policy: Policy, state: KnownState) -> Float32Array:
    """(width,) what a drone would observe in a state, as far as policies look at it."""
    note = policy.note
    layout = {f.name: f.where for f in observation_layout(*note.form)}
    row = np.zeros(observation_width(*note.form))
    position, velocity, goal = (np.asarray(part, np.float64) for part in state[:3])
    codes = np.eye(len(VEHICLES))[state.types]
    entries = {
        "self.position": position[0],
        "self.velocity": velocity[0] / SPEED_LIMIT,
        "self.thrust": state.thrust,
        "self.setpoint_offset": state.setpoint - position[0],
        "self.type": codes[0],
    }
    distance = np.square(position[1:] - position[0]).sum(axis=1)
    for k, j in enumerate(1 + np.argsort(distance, kind="stable")[: note.num_neighbors]):
        entries |= {
            f"neighbor_{k}.position": position[j] - position[0],
            f"neighbor_{k}.velocity": (velocity[j] - velocity[0]) / SPEED_LIMIT,
            f"neighbor_{k}.goal": goal[j] - position[j],
            f"neighbor_{k}.type": codes[j],
            f"neighbor_{k}.mask": np.ones(1),
        }
        entries |= _loads(f"neighbor_{k}", state.load[j])
    if note.features in (REFERENCE, FULL):
        place, speed, acceleration = np.asarray(state.task[-9:], np.float64).reshape(3, 3)
        entries |= {
            "task.reference_position": place - position[0],
            "task.reference_velocity": speed / SPEED_LIMIT,
            "task.reference_acceleration": acceleration / ACCELERATION_LIMIT,
        }
    if note.features != REFERENCE:
        entries |= {"task.goal": goal[0] - position[0], "task.time_left": state.task[:1]}
    entries |= _loads("self", state.load[0])
    if note.observe_force:
        entries["self.force"] = state.near[:FORCE_WIDTH]
    if note.num_obstacles:
        count, *ways = state.near[FORCE_WIDTH * note.observe_force :]
        for k, way in enumerate(np.reshape(ways, (-1, 3))[: int(count)]):
            entries |= {f"obstacle_{k}.offset": way, f"obstacle_{k}.mask": np.ones(1)}
    for name, values in entries.items():
        row[layout[name]] = values
    row[layout["self.attitude"]][2::3] = state.up
    return row.astype(np.float32)


def _loads(whose: str, load: Float32Array) -> dict[str, Float32Array]:
    return {f"{whose}.{name}": load[k : k + 1] for k, name in enumerate(_LOADS[: len(load)])}


def decide(policy: Policy, states: list[KnownState]) -> Float32Array:
    """(S, width) the policy's actions in so many states."""
    return policy.actions(np.stack([_observation_row(policy, state) for state in states]))


def _self_test_words(policy: Policy, rng: np.random.Generator) -> dict[str, str]:
    """States with which the header tests itself, with none to more others than are observed."""
    note = policy.note
    drones, kinds, numbers, states = 1 + note.num_neighbors + _UNSEEN, [], [], []
    for n in range(SAMPLES):
        others = n % drones
        state = draw_state(policy, others, rng)
        states.append(state)
        moving = np.concatenate([state.position, state.velocity, state.goal, state.load], axis=1)
        whole = np.zeros((drones, moving.shape[1]), np.float32)
        whole[: len(moving)] = moving
        own = [state.up, [state.thrust], state.setpoint, state.task, state.near]
        numbers.append(np.concatenate([whole.ravel(), *own]).astype(np.float32))
        kinds.append([others, *state.types, *[state.types[0]] * (drones - 1 - others)])
    vector, own_lines = "        for (k = 0; k < 3; k++) own.{0}[k] = *s++;", []
    if note.features != REFERENCE:
        own_lines.append("        own.time_left = *s++;")
    if note.features in (REFERENCE, FULL):
        own_lines += [vector.format(f"reference_{what}") for what in _MOTIONS]
    if note.observe_force:
        own_lines.append(vector.format("force"))
    if note.num_obstacles:
        own_lines.append("        own.obstacles = (int)*s++;")
        own_lines += [vector.format(f"obstacle[{k}]") for k in range(note.num_obstacles)]
    return {
        "drones": str(drones),
        "kinds": str(1 + drones),
        "numbers": str(len(numbers[0])),
        "test_kinds": array_rows(np.array(kinds, dtype=np.int64)),
        "test_states": array_rows(np.array(numbers)),
        "test_actions": array_rows(decide(policy, states)),
        "test_own": "\n".join(own_lines),
    }
