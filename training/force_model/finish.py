"""Last steps from joined files to the rows of a fit: what is held out, and what is too little."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from swarm_envs.training.flight_logs.options import LogOptions
from swarm_envs.training.flight_logs.report import (
    FileReport,
    LogReport,
    ScenarioReport,
    calibrate,
    scenario_report,
    uncalibrated,
)
from swarm_envs.training.flight_logs.split import (
    block_count,
    held_out_blocks,
    is_guarded,
    is_held_out,
)
from swarm_envs.training.interaction_rows.join import vehicle_name, with_present_types
from swarm_envs.training.interaction_rows.rows import BoolArray, IntArray, InteractionRows


class Joined(NamedTuple):
    """Rows of several files."""

    rows: InteractionRows
    """Of all files together."""
    origin: IntArray
    """(R,) which file each row is from."""
    files: list[FileReport]
    """What became of each file."""
    unmarked: BoolArray
    """(F,) whether the file's rows come without a mark of what is held out."""

    def select(self, keep: BoolArray, reason: str) -> Joined:
        """Return only the rows of an (R,) mask; what goes is counted under `reason` by file."""
        lost = np.bincount(self.origin[~keep], minlength=len(self.files))
        files = [
            dataclasses.replace(f, dropped=f.dropped | {reason: int(n)}) if n else f
            for f, n in zip(self.files, lost, strict=True)
        ]
        return self._replace(rows=self.rows.select(keep), origin=self.origin[keep], files=files)


def finish(
    joined: Joined, refused: Sequence[FileReport], options: LogOptions
) -> tuple[InteractionRows, LogReport]:
    """Hold out blocks where none are marked; leave out what is too little; report.

    Args:
        joined: rows of the sound files.
        refused: files that are not among them.
        options: block length, share, guard gap, seed; how many rows are enough.

    Raises:
        ValueError: no row is left.
    """
    joined = _split(joined, options)
    names = _vehicle_names(joined.rows)
    left_out = uncalibrated(joined.rows, names, options)
    unknown = [number for name, number in names.items() if name in left_out]
    joined = joined.select(~np.isin(joined.rows.vehicle, unknown), "vehicle not calibrated")
    scenarios = _scenarios(joined.rows, options)
    small = [k for k, name in enumerate(joined.rows.scenario_names)
             if scenarios[name].refused is not None]  # fmt: skip
    joined = joined.select(~np.isin(joined.rows.scenario, small), "scenario too small")
    if not len(joined.rows):
        reasons = {r: n for f in joined.files for r, n in f.dropped.items()}
        said = [c.refused for c in left_out.values()] + [s.refused for s in scenarios.values()]
        said = [reason for reason in said if reason]
        raise ValueError(f"no row is left of {len(joined.files)} files ({reasons}): {said[0]}")
    rows = with_present_types(_without_scenarios(joined.rows, small))
    count = np.bincount(joined.origin, minlength=len(joined.files))
    files = [dataclasses.replace(f, rows=int(n)) for f, n in zip(joined.files, count, strict=True)]
    files = sorted([*files, *refused], key=lambda file: file.file)
    vehicles = calibrate(rows, names) | left_out
    held_out = int(rows.validation.sum())
    scenarios = {k: s for k, s in scenarios.items() if s.training_rows or s.validation_rows}
    return rows, LogReport(files, scenarios, vehicles, len(rows), held_out)


def _split(joined: Joined, options: LogOptions) -> Joined:
    """Hold out blocks of time of the flights of files without marks, or of every table."""
    tables = np.array([file.kind == "table" for file in joined.files])
    drawn = joined.unmarked | (tables & options.resplit)
    chosen = drawn[joined.origin]
    if not chosen.any():
        return joined
    rows = joined.rows
    held_out, guarded = rows.validation & ~chosen, np.zeros(len(rows), dtype=np.bool_)
    flights = np.unique(rows.flight[chosen])
    time = rows.step / options.rate_hz
    start = {flight: float(time[rows.flight == flight].min()) for flight in flights}
    lengths = [
        block_count(float(time[rows.flight == flight].max()) - start[flight], options)
        for flight in flights
    ]
    blocks = held_out_blocks(lengths, options.validation_share, options.split_seed)
    for flight, own in zip(flights, blocks, strict=True):
        place = np.flatnonzero(rows.flight == flight)
        held_out[place] = is_held_out(time[place] - start[flight], own, options)
        guarded[place] = is_guarded(time[place] - start[flight], own, options)
    note = f"held-out blocks of {options.block_s:g} s are drawn, {options.guard_s:g} s apart"
    files = [
        dataclasses.replace(f, notes=(*f.notes, note)) if d else f
        for f, d in zip(joined.files, drawn, strict=True)
    ]
    marked = dataclasses.replace(rows, validation=held_out)
    return joined._replace(rows=marked, files=files).select(~guarded, "guard gap")


def _vehicle_names(rows: InteractionRows) -> dict[str, int]:
    return {vehicle_name(rows, int(v)): int(v) for v in np.unique(rows.vehicle)}


def _scenarios(rows: InteractionRows, options: LogOptions) -> dict[str, ScenarioReport]:
    found = {}
    for index, name in enumerate(rows.scenario_names):
        own = rows.scenario == index
        training = int((own & ~rows.validation).sum())
        found[name] = scenario_report(training, int(own.sum()) - training, options)
    return found


def _without_scenarios(rows: InteractionRows, small: list[int]) -> InteractionRows:
    kept = [k for k in range(len(rows.scenario_names)) if k not in small]
    place = np.zeros(len(rows.scenario_names), dtype=np.int64)
    place[kept] = np.arange(len(kept))
    names = tuple(rows.scenario_names[k] for k in kept)
    return dataclasses.replace(rows, scenario=place[rows.scenario], scenario_names=names)
