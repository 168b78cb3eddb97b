"""Fig. 8, 9 and 1 of Neural-Swarm2: flights without and with compensation, as tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from swarm_envs.agents.evaluation import frozen_seeds
from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import (
    default_engine,
    describe_model,
    describe_spread,
    format_columns,
    versions,
)
from swarm_envs.envs.config import WORLDS
from swarm_envs.errors import check_name
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.state import FloatArray
from swarm_envs.tasks.ring import RingTask
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.training.collection.flight import vehicle_names
from swarm_envs.training.reproduce.paired_flight_plots import plot_rings, plot_swaps
from swarm_envs.training.reproduce.paired_flights import (
    SIDES,
    SWAPS,
    Air,
    FlightCase,
    PairedFlights,
    compare_paired,
    fly_or_read,
    judged_cm,
    ring_case,
    ring_claims,
    swap_case,
    swap_claims,
)
from swarm_envs.training.reproduce.study import Cells, Report, Study

_WORST = "worst of each flight"  # name of the row of rings that is judged
_MOST_EPISODES = 1000
_EPISODES = 40


def _airs(options: Any) -> tuple[Air, ...]:
    worlds = WORLDS if options.world is None else (options.world,)
    return tuple(Air(truth, world) for world in worlds for truth in options.truths)


def _belief(options: Any, truth: str) -> InteractionModel:
    return load_belief(truth) if options.belief is None else load(options.belief)


def _layout(options: Any) -> StackedLayout:
    radius, duration = options.radius_m, options.duration_s
    return StackedLayout(radius_m=(radius, radius), duration_s=(duration, duration))


def _check(options: Any) -> None:
    if (options.episodes or 1) > _MOST_EPISODES:
        raise ValueError(f"episodes is {options.episodes}, but must be at most {_MOST_EPISODES}")
    for case in options.cases:
        check_name("case", case, SWAPS)
    if not options.cases or len(set(options.cases)) < len(options.cases):
        raise ValueError(f"cases are {options.cases}, but must be at least one, each named once")
    if options.belief is not None and options.truth is None:
        raise ValueError(
            "a belief is learned in one environment: name its force model by --truth too"
        )
    _layout(options)


def _cases(options: Any) -> dict[Air, list[FlightCase]]:
    """The cases of the figure in each air; of 16 drones, the 5 to which the paper compares them."""
    engine = options.engine or default_engine()

    def made(air: Air) -> list[FlightCase]:
        if options.figure == 8:
            return [swap_case(name, _layout(options), air, engine) for name in options.cases]
        figures = (1, 9) if options.figure == 1 else (9,)
        return [ring_case(figure, air, engine) for figure in figures]

    return {air: made(air) for air in _airs(options)}


def _grid(options: Any) -> Cells:
    """Every case in every air, each kept in a file of its own."""
    seeds = frozen_seeds(options.seed, options.episodes or _EPISODES)
    jobs = {}
    for air, cases in _cases(options).items():
        belief = _belief(options, air.truth)
        for case in cases:
            file = f"{case.name.replace('*', 'x').replace(' ', '_')}.npz"
            path = options.out / options.chosen.file / air.folder / file
            jobs[f"{case.name}, {air.name}"] = partial(fly_or_read, path, case, belief, seeds)
    return jobs


def _report(options: Any, cells: Mapping[str, PairedFlights]) -> Report:
    cases = _cases(options)
    flown = {air: [cells[f"{c.name}, {air.name}"] for c in own] for air, own in cases.items()}
    airs = [_air(options, air, cases[air], flown[air]) for air in cases]
    first = next(iter(cases.values()))[0].test
    episodes = options.episodes or _EPISODES
    layout = _layout(options) if options.figure == 8 else first.task.layout  # type: ignore[attr-defined]
    report = {
        "figure": options.figure,
        "what": "worst height error against the reference, cm; p of Wilcoxon's signed-rank test, "
        "two-sided, pairs of flights with the same seed",
        "engine": first.engine,
        "seed": options.seed,
        "episodes": episodes,
        "seeds": frozen_seeds(options.seed, episodes),
        "layout": repr(layout),
        "versions": versions(),
        "truths": airs,
        "notes": _notes(options, first.engine, flown),
    }
    draw = plot_swaps if options.figure == 8 else plot_rings
    name = f"{options.chosen.file}.png"
    picture = partial(draw, report=report, cases=list(cases.values()), flown=list(flown.values()))
    return Report(report, format_flights(report), list(_table(report)), {name: picture})


def _air(
    options: Any, air: Air, cases: Sequence[FlightCase], flown: Sequence[PairedFlights]
) -> dict[str, Any]:
    rows = [_case_row(case, one) for case, one in zip(cases, flown, strict=True)]
    return {
        "air": air.name,
        "world": air.world,
        "truth": describe_model(air.model),
        "belief": describe_model(_belief(options, air.truth)),
        "cases": rows,
    }


def _notes(options: Any, engine: str, flown: Mapping[Air, Sequence[PairedFlights]]) -> list[str]:
    """What is otherwise than one would think."""
    notes = []
    if engine == "batch" and options.engine is None:
        notes.append("pybullet cannot be imported here, so the compiled engine flew")
    for air in flown:
        if air.model.fingerprint == _belief(options, air.truth).fingerprint:
            notes.append(f"the controller compensates by the environment's model, {air.truth!r}")
    crashed = sum(int(one["crashed"].sum()) for own in flown.values() for one in own)
    if crashed:
        notes.append(f"{crashed} flights ended early: their worst error is a lower bound")
    return notes


def _case_row(case: FlightCase, flown: PairedFlights) -> dict[str, Any]:
    """Everything that is said of a case: the judged error, every drone's, force, raw errors."""
    team = case.test.task.team
    names = vehicle_names(team)
    drones = [
        {
            "drone": name,
            **_place(case, i),
            **_compared_errors(case, flown["worst_cm"][..., i]),
            "force_rms_g": round(float(flown["force_rms_g"][i]), 3),
            "error_rms_g": round(float(flown["error_rms_g"][i]), 3),
        }
        for i, name in enumerate(names)
    ]
    return {
        "case": case.name,
        "judged": _WORST if case.judged is None else names[case.judged],
        "episodes": int(flown["worst_cm"].shape[1]),
        "paper_cm": case.paper_cm,
        **_compared_errors(case, judged_cm(flown, case.judged)),
        "drones": drones,
        "crashed": dict(zip(SIDES, flown["crashed"].sum(axis=1).tolist())),
        "least_separation_m": dict(zip(SIDES, flown["separation_m"].min(axis=1).round(4).tolist())),
        "explained": round(float(flown["explained"]), 4),
        "mean_neighbours": round(float(flown["neighbours"][0]), 2),
        "most_neighbours": int(flown["neighbours"][1]),
        "others_cm": _others(case, flown) if len(team) > 1 else None,
        "worst_height_error_cm": {
            side: np.round(flown["worst_cm"][k], 3).tolist() for k, side in enumerate(SIDES)
        },
    }


def _compared_errors(case: FlightCase, errors: FloatArray) -> dict[str, Any]:
    """Errors (2, E) compared. Flights on rings differ in their start alone: p says nothing."""
    found = compare_paired(*errors)
    if isinstance(case.test.task, RingTask):
        del found["p_value"], found["significant"]
    return found


def _place(case: FlightCase, i: int) -> dict[str, str]:
    task = case.test.task
    if not isinstance(task, RingTask):
        return {"place": "lowest" if i == len(task.team) - 1 else "upper"}
    upright = task.orbit.first[i, 2] != 0.0
    return {"place": "upright ring" if upright else "level ring"}


def _others(case: FlightCase, flown: PairedFlights) -> dict[str, float] | None:
    """Errors of the drones above the judged one: what compensating the lowest costs them."""
    if case.judged is None:
        return None
    upper = flown["worst_cm"][..., :-1]
    worst = upper.max(axis=-1)
    return {
        "without": round(float(np.median(worst[0])), 3),
        "compensated": round(float(np.median(worst[1])), 3),
        "largest_growth": round(float((upper[1] - upper[0]).max()), 3),
    }


_COLUMNS = (
    *("truth", "world", "case", "drone", "place", "judged", "episodes"),
    *(f"{side}_{w}_cm" for side in SIDES for w in ("median", "lower_quartile", "upper_quartile")),
    *("ratio", "made_worse", "p_value", "paper_without_cm", "paper_compensated_cm"),
    *("crashed_without", "crashed_compensated", "force_rms_g", "error_rms_g"),
)  # fmt: skip


def _table(report: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """One row for each drone of each case, and for what is judged."""
    for air in report["truths"]:
        for row in air["cases"]:
            drones = [d | {"judged": d["drone"] == row["judged"]} for d in row["drones"]]
            if row["judged"] == _WORST:
                own = {k: row[k] for k in (*SIDES, "ratio", "made_worse")}
                drones.append(own | {"drone": _WORST, "judged": True})
            for drone in drones:
                paper = (drone["judged"] and row["paper_cm"]) or (None, None)
                yield (
                    {name: drone.get(name) for name in _COLUMNS}
                    | {
                        f"{side}_{what}_cm": round(value, 4)
                        for side in SIDES
                        for what, value in drone[side].items()
                    }
                    | {
                        "truth": air["truth"]["name"],
                        "world": air["world"],
                        "case": row["case"],
                        "episodes": row["episodes"],
                        "paper_without_cm": paper[0],
                        "paper_compensated_cm": paper[1],
                        "crashed_without": row["crashed"]["without"],
                        "crashed_compensated": row["crashed"]["compensated"],
                    }
                )


def format_flights(report: Mapping[str, Any]) -> str:
    """A report as text: a table for each force model, and notes."""
    lines: list[str] = []
    for air in report["truths"]:
        lines += [
            f"Worst height error (cm), median (quartiles) of {report['episodes']} flights each, "
            f"{report['engine']} engine, forces: {air['air']}; predicted by "
            f"{air['belief']['name']}",
            "",
            *(_swap_table(air) if report["figure"] == 8 else _ring_tables(air)),
            "",
        ]
    return "\n".join([*lines, *(f"note: {note}" for note in report["notes"])]).rstrip()


_HEAD = ("without", "with", "ratio", "made worse")


def _compared(row: Mapping[str, Any], episodes: int) -> tuple[str, ...]:
    """The cells of `_HEAD`."""
    spreads = [describe_spread(row[side]) for side in SIDES]
    return (*spreads, f"{row['ratio']:.2f}", f"{row['made_worse']} of {episodes}")


def _paper(row: Mapping[str, Any]) -> str:
    return "{:g} -> {:g}".format(*row["paper_cm"]) if row["paper_cm"] else "-"


def _swap_table(air: Mapping[str, Any]) -> list[str]:
    rows: list[tuple[str, ...]] = [("case", *_HEAD, "p", "upper drones", "paper")]
    for row in air["cases"]:
        others = row["others_cm"]
        upper = f"{others['without']:.1f} -> {others['compensated']:.1f}"
        cells = (*_compared(row, row["episodes"]), f"{row['p_value']:.1g}", upper, _paper(row))
        rows.append((row["case"], *cells))
    return format_columns(rows)


def _ring_tables(air: Mapping[str, Any]) -> list[str]:
    lines = []
    for row in air["cases"]:
        rows: list[tuple[str, ...]] = [(row["case"], "place", *_HEAD, "force (g)", "its error (g)")]
        for drone in row["drones"]:
            force = (f"{drone['force_rms_g']:.2f}", f"{drone['error_rms_g']:.2f}")
            rows.append(
                (drone["drone"], drone["place"], *_compared(drone, row["episodes"]), *force)
            )
        rows.append((_WORST, "-", *_compared(row, row["episodes"]), "-", "-"))
        lines += format_columns(rows)
        lines.append(
            f"paper, one drone of an upright ring: {_paper(row)} cm; neighbours: "
            f"{row['mean_neighbours']:.1f} on average, {row['most_neighbours']} at most; "
            f"{100 * row['explained']:.1f} % of the force's variance predicted"
        )
    return lines


_TAKES = ("truth", "belief", "world", "episodes", "engine")


def _flown(number: int, shows: str, claims: Any, takes: tuple[str, ...] = _TAKES) -> Study:
    """The paper flies six swaps of each case, and so does the quick study."""
    return Study(
        paper="neural-swarm2",
        name=f"figure-{number}",
        shows=shows,
        takes=takes,
        check=_check,
        grid=_grid,
        report=_report,
        claims=claims,
        quick={"episodes": 6, "engine": "batch"},
    )


FIGURE_1 = _flown(
    1,
    "sixteen drones on intertwined rings, with and without compensation (b, c); (a) is a "
    "photograph",
    ring_claims,
)
"""Rings of 16."""
FIGURE_8 = _flown(
    8,
    "worst height error of stacked swaps with and without compensation",
    swap_claims,
    (*_TAKES, "cases", "radius_m", "duration_s"),
)
"""Stacked swaps."""
FIGURE_9 = _flown(
    9, "five drones on intertwined rings, and the force that is predicted there", ring_claims
)
"""Rings of 5."""
