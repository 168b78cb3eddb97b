"""`swarm-envs train-sweep`: one training run a seed and variant, and what they come to."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents.evaluation import bootstrap_interval, frozen_seeds, interquartile_mean
from swarm_envs.agents.policy import FILE, read_policy
from swarm_envs.arguments import Count, Seed
from swarm_envs.commands import train
from swarm_envs.commands.checks import (
    Misuse,
    check_outputs,
    command_options,
    need_torch,
)
from swarm_envs.commands.mistakes import read_options
from swarm_envs.files import claimed, write_json
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.scale_out.jobs import Job
from swarm_envs.training.scale_out.options import ScaleOptions

REPORT, MARKER, SCORES = "sweep.json", "options.json", "scores.json"
"""Files of a sweep: its report, the options that it was begun with, and in each run's folder what
was measured on the seeds for reporting."""
_OURS = ("out", "json", "seed", "progress")  # Options of `train` that the sweep itself gives


@command_options
@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """Train with several seeds, and optionally several variants of the options, and compare them.

    Each run has its own folder `OUT/VARIANT/seed-K`, as of `swarm-envs train`, and all policies are
    evaluated on the same episodes. An interrupted command resumes when it is run again. A run that
    fails is reported with its error, and the exit status is 1.
    """

    out: Path
    """folder of all runs and of sweep.json; on a cluster, on shared storage"""
    seeds: list[Seed] = field(default_factory=lambda: [0, 1, 2, 3, 4])
    """random seeds, one per run"""
    set: list[str] = field(default_factory=list)
    """options of `train` for every run, NAME=VALUE, such as `drones=4 hidden=128,128`"""
    compare: list[str] = field(default_factory=lambda: [""])
    """variants: more such options, each variant in quotes, such as `"hidden=64,64" "hidden=128,128
    ent_coef=0.01"`"""
    episodes: Count = 1024
    """number of evaluation episodes per layout"""
    report_seed: Seed = 7
    """random seed of the evaluation, as of `evaluate --seed`"""
    json: Path | None = None
    """also write the report to this file"""
    scale: ScaleOptions = field(default_factory=ScaleOptions)
    """parallel training"""

    def __post_init__(self) -> None:
        """Refuse runs that would be flown twice."""
        folders = [_folder(variant) for variant in self.compare]
        for name, given in (("--seeds", self.seeds), ("--compare", folders)):
            if not given or len(dict.fromkeys(given)) < len(given):
                raise ValueError(f"{name} is {given}; name one or more, each once")


def train_arguments(settings: Sequence[str]) -> list[str]:
    """Arguments of `swarm-envs train` for NAME=VALUE settings."""
    found: list[str] = []
    for setting in settings:
        name, equals, value = setting.partition("=")
        name = name.replace("-", "_")
        if not equals or not value:
            raise Misuse(f"{setting!r} is no setting; write NAME=VALUE, such as hidden=128,128")
        if name in _OURS:
            rule = f"each run of a sweep has its own {name}"
            raise Misuse(f"{setting!r} is not for --set or --compare: {rule}")
        option = name.replace("_", "-")
        if value in ("true", "false"):
            found.append(f"--{option}" if value == "true" else f"--no-{option}")
        else:
            found += [f"--{option}", *value.split(",")]
    return found


def parse(arguments: Sequence[str]) -> RlConfig:
    """Read the arguments of one run as `swarm-envs train` does."""
    try:
        return read_options(RlConfig, arguments, "swarm-envs train", prefixes=True)
    except Misuse as error:
        raise Misuse(f"--set and --compare take options of `swarm-envs train`: {error}") from error


def train_one(
    arguments: list[str], marker: str, digest: str, episodes: int, seed: int
) -> dict[str, Any]:
    """Train a run, or find it finished, and judge its policy on seeds that nothing was chosen on.

    A job of the sweep, done wherever that is; killed, it resumes.
    """
    from swarm_envs.training.rl.run import finished_report, train_policy

    check_marker(Path(marker), digest)
    config = parse(arguments)
    task = train.check_training(config)
    report = finished_report(config, task) or train_policy(config, task)
    measured = _judged(config, task, episodes, seed)
    return {"measured": measured, **{name: report[name] for name in ("steps", "cpu_s", "wall_s")}}


def _judged(config: RlConfig, task: str, episodes: int, seed: int) -> dict[str, float]:
    """Measures on the seeds for reporting, as they were written, if of this policy and seeds."""
    from swarm_envs.training.rl.recipes import evaluate_policy, recipe_of, with_recipe

    policy, path = read_policy(config.out / FILE), config.out / SCORES
    about = {"episodes": episodes, "seed": seed, "policy": policy.digest, "version": __version__}
    if path.is_file():
        written = json.loads(path.read_text(encoding="utf-8"))
        if all(written.get(name) == value for name, value in about.items()):
            found: dict[str, float] = written["measured"]
            return found
    layouts = recipe_of(task).evaluation_layouts(str(with_recipe(config, task).layout))
    options = {"interactions": config.interactions}
    seeds = frozen_seeds(seed, episodes)
    measured = evaluate_policy(policy, task, layouts, seeds, options, config.teams)
    write_json(path, {**about, "measured": measured})
    return measured


def write_marker(path: Path, content: object) -> str:
    """Write the file by which workers know that they see the same folder; give its digest."""
    write_json(path, content)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_marker(path: Path, digest: str) -> None:
    """Refuse a machine that does not see what `write_marker` wrote."""
    if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != digest:
        raise OSError(
            f"machine {platform.node()!r} does not see {str(path)!r} as the one that began the "
            "sweep wrote it; choose a folder by --out on storage that all machines share"
        )


def run_sweep(options: SweepOptions) -> int:
    """Train all, print and write; return how many runs failed."""
    need_torch()
    check_outputs(options.out, options.json, (".json",))
    runs = {name: _arguments(options, *name) for name in _names(options)}
    for arguments in runs.values():
        train.check_training(parse(arguments))
    with claimed(options.out):
        found = _train(options, runs)
        report = _report(options, found)
        for path in filter(None, (options.out / REPORT, options.json)):
            write_json(path, report)
            print(f"wrote {path}", flush=True)
    print(_table(report))
    for line in _failures(report):
        print(line, file=sys.stderr)
    return sum("error" in entry for entry in found.values())


def _names(options: SweepOptions) -> list[tuple[str, int]]:
    return [(variant, seed) for variant in options.compare for seed in options.seeds]


def _folder(variant: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", variant).strip("-.") or "runs"


def _arguments(options: SweepOptions, variant: str, seed: int) -> list[str]:
    out = options.out.absolute() / _folder(variant) / f"seed-{seed}"
    settings = train_arguments([*options.set, *variant.split()])
    shown = "--progress" if options.scale.alone else "--no-progress"
    return [*settings, "--seed", str(seed), "--out", str(out), shown]


def _train(
    options: SweepOptions, runs: dict[tuple[str, int], list[str]]
) -> dict[tuple[str, int], dict[str, Any]]:
    marker = options.out.absolute() / MARKER
    given = {name: value for name, value in asdict(options).items() if name not in _NOT_RESULT}
    about: dict[str, Any] = {"marker": str(marker), "digest": write_marker(marker, given)}
    about |= {"episodes": options.episodes, "seed": options.report_seed}
    labels = {f"{variant} seed {seed}".strip(): (variant, seed) for variant, seed in runs}
    jobs = [
        Job(f"{__name__}:train_one", {**about, "arguments": runs[name]}, label)
        for label, name in labels.items()
    ]
    found = {}
    with (
        options.scale.open() as workers,
        tqdm(total=len(jobs), unit="run", desc="sweep", disable=options.scale.alone) as bar,
    ):
        for outcome in workers.run(deque(jobs)):
            failed = outcome.error is not None
            result = {"error": outcome.error} if failed else outcome.result
            found[labels[outcome.job.label]] = result
            sys.stderr.write(outcome.trace)
            bar.update()
    return {name: found[name] for name in runs}


_NOT_RESULT = ("out", "json", "scale")


def _report(options: SweepOptions, found: dict[tuple[str, int], dict[str, Any]]) -> dict[str, Any]:
    variants = []
    for variant in options.compare:
        runs = [{"seed": seed, **found[variant, seed]} for seed in options.seeds]
        whole = [entry for entry in runs if "error" not in entry]
        measured = over_seeds(whole) if whole else {}
        folder = str(options.out / _folder(variant))
        variants.append({"options": variant, "folder": folder, "measured": measured, "runs": runs})
    about = {"set": options.set, "episodes": options.episodes, "report_seed": options.report_seed}
    return {**about, "version": __version__, "variants": variants}


def over_seeds(runs: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Interquartile mean over training seeds of each measure, with its bootstrap interval."""
    found = {}
    for name in runs[0]["measured"]:
        values = np.array([run["measured"][name] for run in runs])
        found[name] = {
            "iqm": float(interquartile_mean(values)),
            "interval": bootstrap_interval(values),
            "each": values.tolist(),
        }
    return found


def _table(report: dict[str, Any]) -> str:
    """A line a variant: interquartile means and intervals over its runs."""
    from swarm_envs.training.scoreboard.standings import align_columns

    names = list(dict.fromkeys(name for v in report["variants"] for name in v["measured"]))
    rows = [["options", "runs", *(name.replace("_", " ") for name in names), "CPU, min"]]
    for variant in report["variants"]:
        whole = [entry for entry in variant["runs"] if "error" not in entry]
        cells = [_cell(name, variant["measured"].get(name)) for name in names]
        spent = sum(entry["cpu_s"] for entry in whole) / max(len(whole), 1) / 60
        rows.append([variant["options"] or "-", str(len(whole)), *cells, f"{spent:.1f}"])
    return "\n" + "\n".join(align_columns(rows))


def _failures(report: dict[str, Any]) -> list[str]:
    return [
        f"{variant['options']} seed {entry['seed']} FAILED: {entry['error']}".strip()
        for variant in report["variants"]
        for entry in variant["runs"]
        if "error" in entry
    ]


def _cell(name: str, measure: dict[str, Any] | None) -> str:
    if measure is None:
        return "-"
    low, high = measure["interval"]
    if name.endswith(_SHARES):
        return f"{measure['iqm']:.1%} ({100 * low:.1f}-{100 * high:.1f})"
    return f"{measure['iqm']:.3g} ({low:.3g}-{high:.3g})"


_SHARES = ("_success", "_collision")
"""Measures that are shares of episodes; others have units of their own."""
