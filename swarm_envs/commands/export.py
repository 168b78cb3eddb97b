"""`swarm-envs export`: flights, policies and force models for real drones."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from swarm_envs.commands.checks import Misuse, check_file
from swarm_envs.errors import unknown_name


class Kind(NamedTuple):
    """What can be exported."""

    options: type
    """Read from the command line."""
    run: Callable[[Any], None]
    """Does it."""


_WHERE = {
    "trajectory": ("export_trajectory", "TrajectoryOptions"),
    "policy": ("export", "PolicyOptions"),
    "force": ("export", "ForceOptions"),
}
KINDS = tuple(_WHERE)
"""The kinds by name."""
OVERVIEW = """\
usage: swarm-envs export KIND [options]

kinds:
  trajectory  a flight or a plan as the polynomial pieces that Crazyflies fly
  policy      a trained policy as a C header for a microcontroller
  force       a force model as a C header for a microcontroller

`swarm-envs export KIND --help` explains a kind's options."""
"""What `swarm-envs export` says without a kind."""


def find_kind(name: str) -> Kind:
    """The kind of this name.

    Raises:
        Misuse: there is none.
    """
    if name not in _WHERE:
        raise Misuse(unknown_name("kind", name, KINDS))
    module, options = _WHERE[name]
    found = importlib.import_module(f"swarm_envs.commands.{module}")
    return Kind(getattr(found, options), getattr(found, f"export_{name}"))


@dataclass(frozen=True, kw_only=True)
class ForceOptions:
    """Write a fitted force model as a C99 header for a microcontroller.

    It holds the weights as float32 and needs no library; see docs/forces.md.
    """

    out: Path
    """the header to write, such as learned.h"""
    model: str = "learned"
    """`learned`, or the path of weights that `swarm-envs fit` made"""
    name: str | None = None
    """prefix of everything that the header defines; by default the file's name"""
    seed: int = 0
    """the states of the header's self-test are drawn from it"""
    json: Path | None = None
    """write what the header holds to this file too"""

    def __post_init__(self) -> None:
        """Refuse a seed that no generator takes."""
        _check_seed(self.seed)


@dataclass(frozen=True, kw_only=True)
class PolicyOptions:
    """Write a trained policy as a C99 header for a microcontroller.

    It picks the nearest neighbours, makes the features, evaluates the network and steers the
    set-point, in float32 and without heap; see docs/deploy.md.
    """

    policy: str
    """swap-ppo, swap-ppo-8, formation-ppo, ring-ppo, a .safetensors file, or a training run's
    folder"""
    out: Path
    """the header to write, such as policy.h"""
    name: str | None = None
    """prefix of everything that the header defines; by default the file's name"""
    seed: int = 0
    """the states of the header's self-test are drawn from it"""
    json: Path | None = None
    """write what the header holds and costs to this file too"""

    def __post_init__(self) -> None:
        """Refuse a seed that no generator takes."""
        _check_seed(self.seed)


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise ValueError(f"--seed is {seed}, but must be 0 or more")


def _check_outputs(options: ForceOptions | PolicyOptions) -> str:
    """Refuse places that cannot be written; give the prefix."""
    for option, file in (("--out", options.out), ("--json", options.json)):
        if file is not None:
            check_file(option, file)
    return options.out.stem if options.name is None else options.name


def export_force(options: ForceOptions) -> None:
    """Write the header.

    Raises:
        Misuse: there is no such place to write.
        ValueError: there is no such model, or the name is none in C.
    """
    name = _check_outputs(options)
    from swarm_envs.interactions import load
    from swarm_envs.interactions.c_header import c_header

    model = load(options.model)
    text = c_header(model, name, options.seed)
    facts = {"model": model.name, "types": list(model.types), "weights": model.field.weights.size}
    _write(options, text, {"header": str(options.out), "name": name, **facts})
    print(f"wrote {options.out}: {name}_force_z(...), {facts['weights']} weights of {model.name!r}")


def export_policy(options: PolicyOptions) -> None:
    """Write the header, and print what it costs.

    Raises:
        Misuse: there is no such place to write, or the agent is no trained policy.
        FileNotFoundError: there is no such policy.
        ValueError: the policy is damaged, or the name is none in C.
    """
    name = _check_outputs(options)
    from swarm_envs.agents import load
    from swarm_envs.agents.c_header import costs, policy_header
    from swarm_envs.agents.policy import PolicyAgent

    agent = load(options.policy)
    if not isinstance(agent, PolicyAgent):
        raise Misuse(f"agent {options.policy!r} is no trained policy; name one, such as swap-ppo")
    policy, found = agent.policy, costs(agent.policy)
    text = policy_header(policy, name, options.seed)
    facts = {
        "policy": options.policy,
        "weights_sha256": policy.digest,
        "flash_bytes": found.flash_bytes,
        "stack_bytes": found.stack_bytes,
        "multiply_adds": found.products,
        "function_calls": found.functions,
        "estimated_us_stm32f405": round(found.microseconds, 1),
    }
    _write(options, text, {"header": str(options.out), "name": name, **facts})
    print(
        f"wrote {options.out}: {name}_act(...), {found.flash_bytes} bytes of weights, "
        f"{found.stack_bytes} of stack, {found.products} multiply-adds, about "
        f"{found.microseconds:.0f} us on an STM32F405 (estimated)"
    )


def _write(options: ForceOptions | PolicyOptions, text: str, facts: dict[str, Any]) -> None:
    from swarm_envs.files import write_json, written_whole

    with written_whole(options.out) as partial:
        partial.write_text(text, encoding="utf-8")
    if options.json is not None:
        write_json(options.json, facts)
