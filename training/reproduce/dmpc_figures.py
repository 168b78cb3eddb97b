"""The figures of DMPC-Swarm on the package's MLR-DMPC, and a sweep of message loss."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from swarm_envs.arguments import Count, typed
from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, formation, scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel
from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.training.reproduce import dmpc_flights
from swarm_envs.training.reproduce.claims import (
    Between,
    Claim,
    Extent,
    Reason,
    about,
    claims_of,
    exactly,
)
from swarm_envs.training.reproduce.dmpc_flights import (
    CRASH_M,
    JAM_S,
    LOSSES,
    MODES,
    THEIRS,
    ReferenceFlight,
    fly_circle,
    fly_sequence,
    median_total,
    plot_formations,
    plot_jam,
    plot_losses,
    plot_sequence,
    recording_of,
)
from swarm_envs.training.reproduce.study import Cell, Cells, Report, Study, StudyOptions, drawing

_PAPER = "dmpc-swarm"  # as `swarm-envs reproduce` names the paper
_Fly = Callable[..., ReferenceFlight]
_APART_M = 0.25  # scaled distance that references keep
_APART = Between(_APART_M)


@partial(typed, owner="--")
@dataclass(frozen=True, kw_only=True)
class DmpcSwarmOptions(StudyOptions):
    """Reproduce a figure of DMPC-Swarm, with the times of the public simulation.

    `--figure 3a` draws the formations, `--figure 3b` flies through them with one, two and three
    compute units, `--figure 3c` with each trigger, `--figure 4` a circle while no compute unit
    hears anything for two seconds. `--study loss` sweeps the share of messages lost, met by our
    recovery, by the paper's, and not at all.
    What takes a while resumes when it is interrupted and run again.
    """

    paper: ClassVar[str] = _PAPER

    figure: Literal["3a", "3b", "3c", "4"] | None = None
    """number of the figure"""
    study: Literal["loss"] | None = None
    """the sweep of losses"""
    seeds: Count = 3
    """how many, each a run of every cell"""
    replay: bool = True
    """write a replay page of each cell's first run"""


OPTIONS = DmpcSwarmOptions  # What `swarm-envs reproduce dmpc-swarm` takes


def _setups_of(options: DmpcSwarmOptions) -> dict[str, list[dict[str, Any]]]:
    """What is flown in each cell of a figure or of the sweep, one run a seed."""
    varied: dict[str, dict[str, Any]]
    if options.figure == "3b":
        varied = {f"{m} CU{'s' * (m > 1)}": {"compute_units": m} for m in (1, 2, 3)}
    elif options.figure == "3c":
        varied = {trigger: {"trigger": trigger} for trigger in ("RR", "DT", "HT")}
    elif options.figure == "4":
        rounds = round(JAM_S / MlrDmpcConfig().round_s)
        jam = LossModel(jams=(Jam(first_round=0, last_round=rounds - 1, receivers="units"),))
        varied = {f"jam, {n}": {"loss": jam, "recovery": mode} for n, mode in MODES.items()}
    else:
        varied = {
            f"{100 * loss:g} %, {name}": {"loss": loss, "recovery": mode}
            for name, mode in MODES.items()
            for loss in LOSSES
        }
    seeds = range(options.seed, options.seed + options.seeds)
    usual = {"trigger": "HT"}  # the published one
    return {name: [usual | v | {"seed": s} for s in seeds] for name, v in varied.items()}


@functools.cache  # a cell's first flight is measured, and drawn
def _first_flight(fly: _Fly, **options: Any) -> ReferenceFlight:
    return fly(**options)


def _measure(fly: _Fly, setups: Sequence[dict[str, Any]]) -> Cell:
    flights = [_first_flight(fly, **setups[0]), *(fly(**options) for options in setups[1:])]
    totals = [flight.total_s for flight in flights]
    least = [float(flight.scaled_distance.min()) for flight in flights]
    return {
        "seeds": [options["seed"] for options in setups],
        "total_s": totals,
        "legs_s": [flight.legs_s for flight in flights],
        "arrived": sum(total is not None for total in totals),
        "least_scaled_distance_m": least,
        "crashes": sum(distance < CRASH_M for distance in least),
    }


def _grid(fly: _Fly, options: DmpcSwarmOptions) -> Cells:
    _first_flight.cache_clear()
    return {name: partial(_measure, fly, runs) for name, runs in _setups_of(options).items()}


def _settings(options: DmpcSwarmOptions) -> dict[str, Any]:
    return {"seeds": [options.seed + k for k in range(options.seeds)]}


def _report(fly: _Fly, options: DmpcSwarmOptions, cells: Mapping[str, Cell]) -> Report:
    """The picture, the table and the pages; cells of an earlier run are flown again to be drawn."""
    name = options.chosen.file
    files: dict[str, Callable[[Path], object]] = {}
    if options.study is not None:
        files[f"{name}.png"] = partial(plot_losses, cells=cells)
    else:
        setups = _setups_of(options)
        flights = {cell: _first_flight(fly, **runs[0]) for cell, runs in setups.items()}
        sequence = partial(plot_sequence, figure=str(options.figure), cells=cells)
        draw = plot_jam if options.figure == "4" else sequence
        files[f"{name}.png"] = partial(draw, flights=flights)
        if options.replay:
            from swarm_envs.viewing.replay import write_replay

            for cell, flight in flights.items():
                plain = "".join(c if c.isalnum() else "_" for c in cell).strip("_")
                page = recording_of(flight, cell, options.seed)
                files[f"{name}_{plain}.html"] = partial(write_replay, recording=page)
    theirs = {**THEIRS, "jam, ours": None, "jam, none": None}  # of which there is no time
    summary = {"cells": dict(cells), "theirs_s": theirs}
    return Report(summary, _text(cells), _table(cells), files)


def _text(cells: Mapping[str, Cell]) -> str:
    """The numbers as text, with those of the public simulation."""
    lines = [("", "arrived", "median s", "theirs s", "least scaled m", "crashes")]
    for name, cell in cells.items():
        times = median_total(cell), THEIRS.get(name, np.nan)
        median, known = ("-" if np.isnan(value) else f"{value:.1f}" for value in times)
        arrived = f"{cell['arrived']}/{len(cell['total_s'])}"
        least = f"{min(cell['least_scaled_distance_m']):.4f}"
        lines.append((name, arrived, median, known, least, str(cell["crashes"])))
    return "\n".join(format_columns(lines))


def _table(cells: Mapping[str, Cell]) -> list[dict[str, object]]:
    columns = ("seeds", "total_s", "legs_s", "least_scaled_distance_m")
    return [
        {
            "cell": name,
            "seed": seed,
            "total_s": total,
            "legs_s": " ".join(f"{leg:.1f}" for leg in legs),
            "least_scaled_distance_m": least,
            "theirs_s": THEIRS.get(name),
        }
        for name, cell in cells.items()
        for seed, total, legs, least in zip(*(cell[column] for column in columns), strict=True)
    ]


def _formations(options: DmpcSwarmOptions, cells: Mapping[str, Any]) -> Report:
    """Fig. 3a: where the drones of each formation stand."""
    config = MlrDmpcConfig()
    places = {name: formation(name, dmpc_flights.DRONES) for name in dict.fromkeys(SEQUENCE)}
    least = {n: round(float(scaled_distances(p, config).min()), 4) for n, p in places.items()}
    summary = {
        "sequence": list(SEQUENCE),
        "distance_m": config.distance_m,
        "formations": {
            name: {"drones": len(points), "least_scaled_distance_m": least[name]}
            for name, points in places.items()
        },
    }
    table = [
        {"formation": name, "drone": i}
        | dict(zip(("x_m", "y_m", "z_m"), np.round(p, 4).tolist(), strict=True))
        for name, points in places.items()
        for i, p in enumerate(points)
    ]
    text = "\n".join(
        f"{name:10}{len(points):4} drones, least scaled distance {least[name]:.3f} m"
        for name, points in places.items()
    )
    draw = partial(plot_formations, places=places, box=config.box)
    return Report(summary, text, table, {"figure_3a.png": draw})


def _formation_claims(numbers: Any, extent: Extent) -> list[Claim]:
    places = numbers["formations"]
    drones = min(entry["drones"] for entry in places.values())
    apart = [
        (f"{name}: least scaled distance of two places, m", f"at least {_APART_M:g}", _APART)
        for name in places
    ]
    return claims_of(
        [("drones in each formation", "16", exactly(16.0)), *apart],
        [drones, *(entry["least_scaled_distance_m"] for entry in places.values())],
    )


def _time_claim(name: str, cell: Cell) -> Claim:
    totals = [total for total in cell["total_s"] if total is not None]
    faster = "their formations are others; and detours, deadlocks and selection differ"
    several = len(totals) > 1
    return Claim(
        f"{name}: all four changes of formation, s",
        f"({THEIRS[name]:g})",
        median_total(cell),
        about(THEIRS[name], 0.2),
        (Reason(faster, Between(20.0)),),
        spread=(min(totals), max(totals)) if several else None,
        spread_is="least and largest",
    )


def _distance_claim(where: str, *cells: Cell) -> Claim:
    sampled = Reason(
        "distances are kept at samples, 0.1 s apart; between them a little is lost, as in the "
        "paper",
        Between(0.24, _APART_M),
    )
    return Claim(
        f"{where}: least scaled distance of two references, m",
        f"at least {_APART_M:g}",
        min(least for cell in cells for least in cell["least_scaled_distance_m"]),
        Between(_APART_M - 1e-3),
        (sampled,),
    )


def _unit_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """More compute units are faster, and the second is worth more than the third."""
    cells = numbers["cells"]
    one, two, three = (median_total(cells[name]) for name in ("1 CU", "2 CUs", "3 CUs"))
    saved = (one - two) / (two - three) if two != three else float("inf")
    paper = "the most significant improvement is from one to two"
    second = "time that the second unit saves over what the third saves"
    return [
        *(_time_claim(name, cell) for name, cell in cells.items()),
        Claim(second, paper, saved, Between(1.0)),
        _distance_claim("all", *cells.values()),
    ]


def _trigger_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """Round robin is slowest in most formations, the other two are much alike."""
    cells = numbers["cells"]
    complete = {n: [legs for legs in cells[n]["legs_s"] if len(legs) == 4] for n in cells}
    rr, dt, ht = (np.median(complete[name], axis=0) for name in ("RR", "DT", "HT"))
    faster = (
        "in the authors' public simulation DT is faster too, 34.2 s to 38.4 s; with 15 seeds here "
        "the medians are 26.3 s and 32.8 s, a ratio of 0.80"
    )
    slowest = int((rr > np.maximum(dt, ht)).sum())
    ratio = median_total(cells["DT"]) / median_total(cells["HT"])
    known = Reason(faster, Between(0.7, 0.9))
    return [
        *(_time_claim(name, cell) for name, cell in cells.items()),
        Claim("changes of formation in which RR is slowest, of 4", "3", slowest, Between(3.0, 4.0)),
        Claim(
            "time with DT over time with HT",
            "generally similar",
            ratio,
            Between(0.8, 1.25),
            (known,),
        ),
        _distance_claim("all", *cells.values()),
    ]


def _jam_claims(numbers: Any, extent: Extent) -> list[Claim]:
    """With recovery all arrive and keep their distance; without, references meet."""
    cells, jam = numbers["cells"], THEIRS["jam, paper's"]
    ours, theirs, none = (cells[f"jam, {name}"] for name in ("ours", "paper's", "none"))
    references = (
        "these are references: 0.25 m were to be kept, and tracking errors, which the paper's "
        "drones have, come on top"
    )
    forgotten = (
        "units that have forgotten all drones know them again after ten rounds here, after 65 there"
    )
    arrive = ("all exchange their positions", exactly(1.0))
    stated = (
        (
            "without recovery: least scaled distance of two references, m",
            *(f"two collide (below {CRASH_M:g})", Between(0.0, CRASH_M)),
            Reason(references, Between(CRASH_M, 0.2)),
        ),
        ("our recovery: share of runs in which all arrive", *arrive),
        ("the paper's recovery: share of runs in which all arrive", *arrive),
        (
            *("our recovery: time to the last arrival, s", f"({jam:g})", about(jam, 0.2)),
            Reason(forgotten, Between(10.0, jam)),
        ),
    )
    shares = [cell["arrived"] / len(cell["seeds"]) for cell in (ours, theirs)]
    return [
        _distance_claim("our recovery", ours),
        _distance_claim("the paper's recovery", theirs),
        *claims_of(stated, (min(none["least_scaled_distance_m"]), *shares, median_total(ours))),
    ]


def _flown(number: str, shows: str, fly: _Fly, claims: Any, note: str) -> Study:
    """A figure that is flown; its replay pages are left to the command by itself if quick."""
    return Study(
        paper=_PAPER,
        name=f"figure-{number}",
        shows=shows,
        grid=partial(_grid, fly),
        settings=_settings,
        cells_file=f"figure_{number}.json",
        report=partial(_report, fly),
        claims=claims,
        quick={"seeds": 1, "replay": False},
        note=note,
    )


_BRACKETS = (
    "The paper prints no numbers: those in brackets are of the authors' public simulation, on "
    "formations of its own."
)
_DRAWN, _SHOT = "an overview drawing: nothing is measured", "a photograph of the hardware"
STUDIES = (
    drawing(_PAPER, 1, "the swarm, its radio, and the phases of a round", _DRAWN),
    drawing(_PAPER, 2, "sixteen Crazyflies, three laptops and their radios", _SHOT),
    Study(
        paper=_PAPER,
        name="figure-3a",
        shows="the formations that are flown: plane, pyramid, cube, sphere",
        report=_formations,
        claims=_formation_claims,
    ),
    _flown(
        "3b",
        "those formations with one, two and three compute units",
        fly_sequence,
        _unit_claims,
        _BRACKETS,
    ),
    _flown("3c", "the same with each event trigger", fly_sequence, _trigger_claims, _BRACKETS),
    _flown(
        "4",
        "sixteen drones across a circle while no compute unit hears for two seconds",
        fly_circle,
        _jam_claims,
        "The time in brackets is of the authors' public simulation; the paper prints none.",
    ),
    Study(
        paper=_PAPER,
        name="study-loss",
        label="Losses",
        shows="time and distance by the share of messages that the radio loses",
        file="losses",
        grid=partial(_grid, fly_circle),
        settings=_settings,
        cells_file="losses.json",
        report=partial(_report, fly_circle),
    ),
)
"""Every numbered figure of the paper, which has no table, and the sweep of losses."""
