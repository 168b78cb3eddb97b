"""What becomes of the files of a fit: what too little data leaves out, and the report of it.

The report is by file, by vehicle and by scenario. Nothing is dropped without a word.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from swarm_envs.state import BoolArray, IntArray
from swarm_envs.training.flight_logs.log_options import LogOptions
from swarm_envs.training.interaction_rows import InteractionRows
from swarm_envs.training.interaction_rows.calibration import quiet_rows
from swarm_envs.training.interaction_rows.row_tables import vehicle_name, with_present_types
from swarm_envs.vehicles import VEHICLES

__all__ = ["LogReport"]

PLAUSIBLE_SHARE = 0.15
"""Calibration offset over weight above which the mass or the thrust curve can hardly be right."""


@dataclass(frozen=True)
class FileReport:
    """What became of one file."""

    file: str  # Its name
    refused: str | None = None  # Message of the rule it breaks, with its name; nothing was used
    drones: dict[str, str] = field(default_factory=dict)
    """Type by name, of a flight log; of a table this, times and acceleration have no meaning."""
    seconds: float = 0.0  # Time that all drones have in common
    gap_seconds: float = 0.0  # Of it, in gaps of some drone's log
    uncommon_seconds: float = 0.0  # Time of the longest log outside of it, left out
    rate_hz: float = 0.0  # Samples per second
    acceleration: str = ""  # `logged` or `differentiated`
    ignored_columns: tuple[str, ...] = ()  # Columns that nothing reads
    entries: int = 0  # Of all drones on the common clock
    rows: int = 0  # Rows that it gave
    dropped: dict[str, int] = field(default_factory=dict)
    """Entries that are no rows, by reason; with `rows` they make up `entries`."""
    notes: tuple[str, ...] = ()  # What else there is to say


@dataclass(frozen=True)
class Calibration:
    """What lone flight says of one vehicle."""

    id: int  # In the rows
    type: str  # Of the vehicle
    rows: int  # Quiet rows from which its offset comes
    quiet_rows: int  # Training rows aloft, slow and away from wakes
    offset_g: float | None
    """Median vertical label of those: error of mass and thrust curve. None without such rows."""
    refused: str | None = None  # Why none of its rows was used


@dataclass(frozen=True)
class ScenarioReport:
    """Rows of one scenario."""

    training_rows: int  # Rows that are learned from
    validation_rows: int  # Rows that are held out
    refused: str | None = None  # Why it was left out


@dataclass(frozen=True)
class LogReport:
    """What became of logs on their way to rows."""

    files: list[FileReport]
    """What became of each file."""
    scenarios: dict[str, ScenarioReport]
    """Rows of each scenario."""
    vehicles: dict[str, Calibration]
    """The calibration of each physical vehicle."""
    rows: int
    """Rows that all files gave."""
    validation_rows: int
    """Those of them that are held out."""
    not_read: tuple[str, ...] = ()
    """What else lies in the folder."""

    def lines(self) -> list[str]:
        """Return the report as lines of text."""
        bad = [file for file in self.files if file.refused is not None]
        seconds = sum(file.seconds for file in self.files)
        time = f"{seconds:.0f} s, " if seconds else ""
        barren = sum(file.refused is None and not file.rows for file in self.files)
        idle = f", {barren} of them {'gives' if barren == 1 else 'give'} no row" if barren else ""
        said = [
            f"{len(self.files) - len(bad)} of {len(self.files)} files are sound{idle}: "
            f"{time}{self.rows} rows, {self.validation_rows} of them held out"
        ]
        said += [f"refused {file.refused}" for file in bad]
        if self.not_read:
            said.append(
                f"not read: {', '.join(self.not_read)}; data is .csv, .parquet and .npz right in "
                "the folder"
            )
        for file in self.files:
            said += [f"{file.file}: {note}" for note in _notes(file)]
        for name, scenario in self.scenarios.items():
            if scenario.refused is not None:
                said.append(f"left out scenario {name}: {scenario.refused}")
        for name, vehicle in self.vehicles.items():
            said.append(f"{vehicle.type} {name}: calibration offset {_offset(vehicle)}")
            said += _implausible(name, vehicle)
        return said


def _notes(file: FileReport) -> list[str]:
    notes = list(file.notes)
    if not file.drones and any(file.dropped.values()):
        reasons = ", ".join(f"{name}: {n}" for name, n in file.dropped.items() if n)
        notes.append(f"{file.rows} of {file.entries} rows are used (left out: {reasons})")
    if file.ignored_columns:
        notes.append(f"ignored columns {', '.join(file.ignored_columns)}")
    if file.gap_seconds > 0.0:
        notes.append(f"{file.gap_seconds:.2f} s in gaps are left out")
    if file.uncommon_seconds > 0.1:
        notes.append(f"{file.uncommon_seconds:.2f} s that not all drones logged are left out")
    if file.refused is None and file.rows == 0:
        reasons = ", ".join(f"{name}: {n}" for name, n in file.dropped.items() if n)
        notes.append(f"gives no row ({reasons})")
    return notes


def _offset(vehicle: Calibration) -> str:
    if vehicle.refused is not None:
        return f"unknown, so its {vehicle.rows} rows are left out: {vehicle.refused}"
    if vehicle.offset_g is None:
        return "unknown: no row is aloft, slow and away from wakes; add lone flight"
    return f"{vehicle.offset_g:+.2f} g from {vehicle.quiet_rows} rows aloft, slow, away from wakes"


def _implausible(name: str, vehicle: Calibration) -> list[str]:
    kinds = [v for v in VEHICLES.values() if v.interaction_type == vehicle.type]
    if vehicle.offset_g is None or not kinds:
        return []
    share = abs(vehicle.offset_g) / (kinds[0].mass * 1000.0)
    if share <= PLAUSIBLE_SHARE:
        return []
    return [
        f"warning: the calibration offset of {vehicle.type} {name} is {100 * share:.0f} % of its "
        f"weight, but {100 * PLAUSIBLE_SHARE:.0f} % is usual at most; check mass, voltage, rotors"
    ]


class JoinedRows(NamedTuple):
    """Rows of several files."""

    rows: InteractionRows  # Of all files together
    origin: IntArray  # (R,) which file each row is from
    files: list[FileReport]  # What became of each file

    def select(self, keep: BoolArray, reason: str) -> JoinedRows:
        """Return only the rows of an (R,) mask; what goes is counted under `reason` by file."""
        lost = np.bincount(self.origin[~keep], minlength=len(self.files))
        files = [
            replace(f, dropped=f.dropped | {reason: int(n)}) if n else f
            for f, n in zip(self.files, lost, strict=True)
        ]
        return JoinedRows(self.rows.select(keep), self.origin[keep], files)


def without_scarce_data(
    joined: JoinedRows, refused: Sequence[FileReport], options: LogOptions
) -> tuple[InteractionRows, LogReport]:
    """Leave out vehicles without calibration, then scenarios with too few rows; and report.

    `refused` are the files that gave none of the rows.
    """
    numbers = np.unique(joined.rows.vehicle).tolist()
    vehicles = {vehicle_name(joined.rows, number): number for number in numbers}
    unknown = _uncalibrated(joined.rows, vehicles, options)
    left_out = [vehicles[name] for name in unknown]
    joined = joined.select(~np.isin(joined.rows.vehicle, left_out), "vehicle not calibrated")
    scenarios = _scenarios(joined.rows, options)
    small = [k for k, report in enumerate(scenarios.values()) if report.refused is not None]
    joined = joined.select(~np.isin(joined.rows.scenario, small), "scenario too small")
    if not len(joined.rows):
        reasons = [vehicle.refused for vehicle in unknown.values()]
        reasons += [scenario.refused for scenario in scenarios.values()]
        raise ValueError(_no_row_left(joined.files, [text for text in reasons if text]))
    rows = with_present_types(_without_scenarios(joined.rows, small))
    count = np.bincount(joined.origin, minlength=len(joined.files))
    files = [replace(f, rows=int(n)) for f, n in zip(joined.files, count, strict=True)]
    files = sorted([*files, *refused], key=lambda file: file.file)
    calibration = _calibrations(rows, vehicles) | unknown
    held_out = int(rows.validation.sum())
    return rows, LogReport(files, scenarios, calibration, len(rows), held_out)


def _no_row_left(files: Sequence[FileReport], reasons: Sequence[str]) -> str:
    dropped = sum((Counter(file.dropped) for file in files), Counter[str]())
    counts = ", ".join(f"{reason}: {count}" for reason, count in dropped.items())
    why = "; ".join(["fly more, or nearer to each other", *reasons[:1]])
    return f"no row is left of {len(files)} files (left out: {counts}); {why}"


def _calibrations(rows: InteractionRows, vehicles: dict[str, int]) -> dict[str, Calibration]:
    """Offsets by vehicle name; see `interaction_rows.calibration` for what a quiet row is."""
    quiet = quiet_rows(rows) & ~rows.validation
    found = {}
    for name, vehicle in vehicles.items():
        own = rows.vehicle == vehicle
        if not own.any():
            continue
        labels = rows.force_g[own & quiet, 2]
        offset = round(float(np.median(labels)), 3) if len(labels) else None
        kind = rows.types[int(rows.ego_type[own][0])]
        found[name] = Calibration(vehicle, kind, int(own.sum()), len(labels), offset)
    return found


def _uncalibrated(
    rows: InteractionRows, vehicles: dict[str, int], options: LogOptions
) -> dict[str, Calibration]:
    """Vehicles with too few quiet rows, by name, and why none of theirs can be used."""
    reason = (
        f"fewer than {options.min_quiet_rows} training rows are aloft, slow and away from wakes; "
        "add lone flight, or fit with --offsets none if the labels are exact"
    )
    found = _calibrations(rows, vehicles)
    return {
        name: replace(calibration, refused=reason)
        for name, calibration in found.items()
        if calibration.quiet_rows < options.min_quiet_rows
    }


def _scenarios(rows: InteractionRows, options: LogOptions) -> dict[str, ScenarioReport]:
    """Rows of every scenario; refused are those with too few to learn from."""
    found = {}
    for index, name in enumerate(rows.scenario_names):
        own = rows.scenario == index
        held_out = int((own & rows.validation).sum())
        training, reason = int(own.sum()) - held_out, None
        if training < options.min_scenario_rows:
            reason = (
                f"it has {training} training rows, but must have {options.min_scenario_rows}; fly "
                "it longer, or set min_scenario_rows lower"
            )
        found[name] = ScenarioReport(training, held_out, reason)
    return found


def _without_scenarios(rows: InteractionRows, small: list[int]) -> InteractionRows:
    kept = [k for k in range(len(rows.scenario_names)) if k not in small]
    place = np.zeros(len(rows.scenario_names), dtype=np.int64)
    place[kept] = np.arange(len(kept))
    names = tuple(rows.scenario_names[k] for k in kept)
    return replace(rows, scenario=place[rows.scenario], scenario_names=names)
