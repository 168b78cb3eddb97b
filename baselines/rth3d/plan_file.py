"""Files of grid plans: npz without pickle, written whole, validated when read."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.rth3d.grid import check_instance
from swarm_envs.baselines.rth3d.plan import GridPlan
from swarm_envs.baselines.rth3d.records import PhaseRecord
from swarm_envs.baselines.rth3d.validation import validate
from swarm_envs.errors import unknown_name
from swarm_envs.files import written_whole

VERSION = 1
"""Of the format; a file of another is refused."""
_KEPT = ("method", "winner", "seed", "bound", "before_compaction")


def _check_suffix(path: Path) -> None:
    if path.suffix != ".npz":
        raise ValueError(unknown_name("suffix", path.suffix, (".npz",), f"of {str(path)!r}"))


def write_plan(path: Path, plan: GridPlan) -> None:
    """Write a plan; see `GridPlan.save`."""
    _check_suffix(path)
    about: dict[str, Any] = {name: getattr(plan, name) for name in _KEPT}
    about["phases"] = [dataclasses.asdict(phase) for phase in plan.phases]
    about |= {"version": VERSION, "shape": list(plan.shape)}
    # Steps compress four times better than places.
    steps = np.diff(plan.paths, axis=0).astype(np.int8)
    with written_whole(path) as partial:
        np.savez_compressed(
            partial,
            steps=steps,
            starts=plan.starts,
            goals=plan.goals,
            obstacles=plan.obstacles,
            about=np.array(json.dumps(about)),
        )


def read_plan(path: Path) -> GridPlan:
    """Read a plan; see `GridPlan.load`."""
    _check_suffix(path)
    try:
        # numpy leaves a file open that it opens itself and cannot read.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        return _assemble(json.loads(str(arrays.pop("about"))), arrays)
    except OSError:
        raise
    except (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        what = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"{str(path)!r} is no plan, or damaged: {what}") from error


def _assemble(about: dict[str, Any], arrays: dict[str, Any]) -> GridPlan:
    if about["version"] != VERSION:
        raise ValueError(f"it is of version {about['version']!r}, but must be of {VERSION}")
    given = (arrays["starts"], arrays["goals"], about["shape"], arrays["obstacles"])
    instance = check_instance(*given)
    steps = arrays["steps"]
    if steps.dtype != np.int8 or steps.shape[1:] != instance.starts.shape:
        raise ValueError(f"its steps are {steps.dtype} of shape {steps.shape}")
    paths = np.empty((len(steps) + 1, *instance.starts.shape), dtype=np.int16)
    paths[0] = instance.starts
    for t, step in enumerate(steps):
        np.add(paths[t], step, out=paths[t + 1])
    report = validate(paths, *given)
    if not report:
        raise ValueError(f"its paths are not feasible: {report.reason}")
    return GridPlan(
        paths=paths,
        starts=instance.starts,
        goals=instance.goals,
        shape=instance.shape,
        obstacles=instance.obstacles,
        lower_bound=instance.lower_bound,
        phases=tuple(PhaseRecord(**phase) for phase in about["phases"]),
        valid=bool(report),
        **{name: about[name] for name in _KEPT},
    )
