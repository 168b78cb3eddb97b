"""`swarm-envs export`: flights, policies and force models for real drones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from swarm_envs.arguments import Seed
from swarm_envs.commands.checks import (
    Misuse,
    as_misuse,
    check_file,
    check_inputs,
    check_outputs,
    command_options,
    need_recording,
)
from swarm_envs.errors import unknown_name

if TYPE_CHECKING:
    from swarm_envs.deploy import Flight


OVERVIEW = """\
usage: swarm-envs export KIND [options]

kinds:
  trajectory  a flight or a plan as polynomial pieces for Crazyflies
  policy      a trained policy as a C header for a microcontroller
  force       a force model as a C header for a microcontroller

Run `swarm-envs export KIND --help` for the options of a kind."""
"""What `swarm-envs export` says without a kind."""


@dataclass(frozen=True, kw_only=True)
class HeaderOptions:
    """Where a header is written, and how it names what it defines."""

    out: Path
    """output header, such as learned.h"""
    name: str | None = None
    """prefix of all names in the header; default: the file name"""
    seed: Seed = 0
    """random seed of the header's self-test"""
    json: Path | None = None
    """also write the content and its costs to this file"""


@command_options
@dataclass(frozen=True, kw_only=True)
class ForceOptions(HeaderOptions):
    """Write a fitted force model as a C99 header for a microcontroller.

    The header contains float32 weights and needs no library; see docs/forces.md.
    """

    model: str = "learned"
    """`learned`, or a weights file of `swarm-envs fit`"""


@command_options
@dataclass(frozen=True, kw_only=True)
class PolicyOptions(HeaderOptions):
    """Write a trained policy as a C99 header for a microcontroller.

    The header selects the nearest neighbors, computes features and network, and updates the
    set-point, in float32 and without heap; see docs/deploy.md.
    """

    agent: str
    """swap-dagger, gates-dagger, pursuit-dagger, crowd-dagger, stack-dagger, mixed-dagger,
    sprint-dagger, delivery-dagger, ring-dagger, a .safetensors file, or the folder of a training
    run"""


def _check_outputs(options: HeaderOptions) -> str:
    """Refuse places that cannot be written; give the prefix."""
    for option, file in (("--out", options.out), ("--json", options.json)):
        if file is not None:
            check_file(option, file)
    return options.out.stem if options.name is None else options.name


def export_force(options: ForceOptions) -> None:
    """Write the header."""
    name = _check_outputs(options)
    from swarm_envs.interactions import load
    from swarm_envs.interactions.c_header import c_header

    with as_misuse(FileNotFoundError):
        model = load(options.model)
    text = c_header(model, name, options.seed)
    facts = {"model": model.name, "types": list(model.types), "weights": model.field.weights.size}
    _write(options, text, {"header": str(options.out), "name": name, **facts})
    print(f"wrote {options.out}: {name}_force_z(...), {facts['weights']} weights of {model.name!r}")


def export_policy(options: PolicyOptions) -> None:
    """Write the header, and print what it costs."""
    name = _check_outputs(options)
    from swarm_envs.agents import load
    from swarm_envs.agents.c_header import costs, policy_header

    check_inputs(options)
    policies: tuple[Any, ...] = getattr(load(options.agent), "policies", ())
    if len(policies) != 1:
        kind = f"{len(policies)} trained policies" if policies else "no trained policy"
        raise Misuse(
            f"agent {options.agent!r} is {kind}; name one, such as swap-dagger, or its "
            ".safetensors file"
        )
    policy, found = policies[0].policy, costs(policies[0].policy)
    text = policy_header(policy, name, options.seed)
    facts = {
        "policy": options.agent,
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


def _write(options: HeaderOptions, text: str, facts: dict[str, Any]) -> None:
    from swarm_envs.files import write_json, written_whole

    with written_whole(options.out) as partial:
        partial.write_text(text, encoding="utf-8")
    if options.json is not None:
        write_json(options.json, facts)


@dataclass(frozen=True, kw_only=True)
class TrajectoryOptions:
    """Fit polynomial pieces to a flight, check them, and write them for cflib and Crazyswarm.

    Writes drone_0.csv (pieces), drone_0_samples.csv and so on, and report.json; nothing if the
    checks fail. See docs/deploy.md.
    """

    file: Annotated[Path, tyro.conf.Positional]
    """recording of `swarm-envs fly --trajectory`, .parquet or .npz, or a plan of `SwarmPlan.save`,
    .npz or .json"""
    out: Path
    """output folder"""
    path: str = "flown"
    """path of a recording: `flown`, or `setpoint`, the input of the tracking controller"""
    yaw: str = "hold"
    """yaw of a recording: `hold`, that of the start, or `flown`"""
    tolerance: float = 0.01
    """largest distance from the path, m"""
    pieces: int = 31
    """largest number of pieces per drone; 31 fill the firmware's memory"""
    begin_s: float = 0.0
    """skip everything before this time, s"""
    end_s: float | None = None
    """skip everything after this time, s"""
    settle_s: float = 1.0
    """duration of ramps from and to rest if the flight starts or ends in motion, s; 0 refuses such
    flights"""
    rate: float = 100.0
    """samples per second in the sampled files"""
    json: Path | None = None
    """also write the report to this file"""


def export_trajectory(options: TrajectoryOptions) -> None:
    """Read, fit, check and write."""
    check_outputs(options.out, options.json)
    need_recording(options.file)
    from swarm_envs.deploy import settled
    from swarm_envs.deploy.export import export_flight, report_content, report_lines
    from swarm_envs.files import write_json

    flight, source = _read_flight(options)
    if options.begin_s > 0.0 or options.end_s is not None:
        end_s = flight.duration_s if options.end_s is None else options.end_s
        if not options.begin_s < end_s:
            raise Misuse(
                f"--begin-s is {options.begin_s:g}, but must lie before the end, {end_s:g}"
            )
        flight = flight.part(options.begin_s, end_s)
    if options.settle_s > 0.0:
        flight = settled(flight, options.settle_s)
    given = (options.tolerance, options.pieces, options.rate)
    found = export_flight(flight, options.out, *given, source=source, progress=True)
    if options.json is not None:
        write_json(options.json, {"source": source, **report_content(found)})
    print(*report_lines(found), sep="\n")
    print(f"wrote {len(found.drones)} trajectories of {found.duration_s:.2f} s into {options.out}")


def _read_flight(options: TrajectoryOptions) -> tuple[Flight, dict[str, Any]]:
    """The flight, and where it comes from."""
    import numpy as np

    from swarm_envs.deploy import flight_along, flight_of

    file = options.file
    if file.suffix not in (".parquet", ".npz", ".json"):
        valid = (".parquet", ".npz", ".json")
        raise Misuse(unknown_name("suffix", file.suffix, valid, f"of {str(file)!r}"))
    keys: set[str] = set()
    if file.suffix == ".npz":
        try:
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as content:
                keys = set(content.files)
        except (ValueError, EOFError) as error:
            raise ValueError(f"{file} is not an npz file: {error}") from error
    if file.suffix == ".json" or "trajectories_states" in keys:
        from swarm_envs.baselines.neural_swarm.planner.plan import SwarmPlan

        plan = SwarmPlan.load(file)
        about = {"file": file.name, "plan": plan.status, "seed": plan.seed}
        return flight_along(plan.reference, plan.duration, plan.team), about
    if "steps" in keys:
        raise ValueError(
            f"{file} is a plan on a grid, without sizes in metres; fly it by the agent rth3d and "
            "export the recording, or see docs/deploy.md for `on_grid` and `flight_along`"
        )
    from swarm_envs.viewing.trajectory import read_trajectory

    recording = read_trajectory(file)
    about = {
        "file": file.name,
        "task": recording.about.task,
        "agent": recording.about.agent,
        "seed": recording.about.seed,
        "path": options.path,
        "metrics": dict(recording.about.metrics),
    }
    return flight_of(recording, options.path, options.yaw), about


KINDS: Mapping[str, tuple[type, Callable[[Any], None]]] = {
    "trajectory": (TrajectoryOptions, export_trajectory),
    "policy": (PolicyOptions, export_policy),
    "force": (ForceOptions, export_force),
}
"""What can be exported: its options, read from the command line, and what exports it."""
