"""Long studies as cells that are kept: one that was interrupted goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from swarm_envs.files import write_json

Cell = dict[str, Any]
"""The numbers of one cell, ready for JSON."""


def run_cells(
    path: Path,
    settings: Mapping[str, Any],
    cells: Mapping[str, Callable[[], Cell]],
    progress: bool = True,
) -> dict[str, Cell]:
    """Compute every cell that the file does not hold yet, and write the file after each.

    Args:
        path: JSON file with `settings` and `cells`; made, or gone on with.
        settings: what all cells share, ready for JSON.
        cells: what computes each, by name.
        progress: show a progress bar.

    Returns:
        The cells in the order asked for.

    Raises:
        ValueError: the file is damaged, or was made with other settings.
    """
    wanted = json.loads(json.dumps(dict(settings)))
    found = _read(path, wanted)
    done = {name: found[name] for name in cells if name in found}
    with tqdm(total=len(cells), initial=len(done), desc=path.stem, disable=not progress) as bar:
        for name, compute in cells.items():
            if name in done:
                continue
            bar.set_postfix_str(name)
            found[name] = done[name] = json.loads(json.dumps(compute(), allow_nan=False))
            write_json(path, {"settings": wanted, "cells": found})
            bar.update()
    return {name: done[name] for name in cells}


def _read(path: Path, wanted: Mapping[str, Any]) -> dict[str, Cell]:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        made, cells = content["settings"], dict(content["cells"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{str(path)!r} is damaged ({error}); delete it") from error
    differing = sorted(k for k in wanted.keys() | made.keys() if wanted.get(k) != made.get(k))
    if differing:
        raise ValueError(
            f"{str(path)!r} was made with other {', '.join(differing)}; choose another folder by "
            "--out, or delete it"
        )
    return cells


def draw_seeds(seed: int, count: int) -> list[int]:
    """Seeds of so many flights, drawn from one.

    Raises:
        ValueError: the seed is negative, or the count below one.
    """
    if seed < 0:
        raise ValueError(f"seed is {seed}, but must be 0 or more")
    if count < 1:
        raise ValueError(f"the number of flights is {count}, but must be 1 or more")
    return [int(s) for s in np.random.SeedSequence(seed).generate_state(count)]
