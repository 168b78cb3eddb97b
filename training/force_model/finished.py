"""A folder that holds a finished fit is not overwritten by another one."""

from __future__ import annotations

import json
from pathlib import Path

from swarm_envs.training.force_model.config import FitConfig
from swarm_envs.training.provenance import differing, json_ready

_NO_RESULT = ("data", "out", "progress", "json", "tensorboard")
"""Options that change nothing of the result; what the data is, its digest says."""


def check_finished(path: Path, config: FitConfig, data_sha256: str) -> None:
    """Check that a report, if there is one, is of the same fit, which may then run again.

    Args:
        path: of the report.
        config: of this fit, settled.
        data_sha256: of its data.

    Raises:
        ValueError: the report is of other data or options, or it cannot be read.
    """
    if not path.is_file():
        return
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        made = {**report["config"], "data_sha256": report["data_sha256"]}
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{str(path)!r} is not the report of a fit; choose another folder or delete it"
        ) from error
    config_now = json.loads(json.dumps(json_ready(config)))
    wanted = {**config_now, "data_sha256": data_sha256}
    kept = [{k: v for k, v in c.items() if k not in _NO_RESULT} for c in (made, wanted)]
    differences = differing(*kept)
    if differences:
        raise ValueError(
            f"{str(path)!r} is of a finished fit with other data or options: {differences}; "
            "choose another folder or delete that one"
        )
