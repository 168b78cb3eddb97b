"""Fig. 5 of Neural-Swarm2 and what belongs to it: heat maps and larger swarms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.interactions.field import LATERAL_REACH, VERTICAL_REACH
from swarm_envs.state import FloatArray, IntArray
from swarm_envs.training.force_model.explained import generalisation
from swarm_envs.training.reproduce.charts import label_axis
from swarm_envs.training.reproduce.claims import Between, Claim, Extent, Reason, about
from swarm_envs.training.reproduce.heat_maps import (
    MAP_CASES,
    force_map,
    force_on_ego_g,
    plot_gaps,
    plot_heat_maps,
    summarise_maps,
    superposed_force_g,
)
from swarm_envs.training.reproduce.study import Report, Study
from swarm_envs.viewing.style import GREY, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MEASURED_NEIGHBOURS = 2  # most neighbours of any flight that a model here was fitted to
_SIZES = (4, 5, 16)  # fig. 5(g, h), Fig. 9 and Fig. 1 of the paper

_SPACING_M = 0.25
"""Vertical distance in a stack: drones that swap pass each other at 0.2-0.3 m (Sec. VII-E)."""
_RING_RADIUS_M, _RING_SPACING_M, _RING_SIZE = 0.16, 0.3, 4
"""Rings of up to four drones, one above the other, each turned by half a step."""
_LOWEST_M = 0.6  # height of the lowest drone: away from the ground

_JOINT = "#0072B2"  # colour of small drones' joint force


def stack_places(drones: int) -> FloatArray:
    """Positions (N, 3) of drones one above the other, the lowest first, m."""
    position = np.zeros((drones, 3))
    position[:, 2] = _LOWEST_M + _SPACING_M * np.arange(drones)
    return position


def ring_places(drones: int) -> FloatArray:
    """Positions (N, 3) of drones on rings one above the other, the lowest first, m."""
    level, place = np.divmod(np.arange(drones), _RING_SIZE)
    angle = (place + 0.5 * (level % 2)) * 2 * np.pi / _RING_SIZE
    across = _RING_RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.column_stack([across, _LOWEST_M + _RING_SPACING_M * level])


_FORMATIONS = {"stack": stack_places, "rings": ring_places}  # how larger swarms are placed, by name


@dataclass(frozen=True)
class _Swarm:
    """Forces in one formation; drones in the order of their positions."""

    formation: str  # name of the formation
    team: str  # who flies
    position: FloatArray  # (N, 3) m
    neighbours: IntArray  # (N,) how many others stand in each drone's interaction volume
    joint_g: FloatArray  # (N,) vertical force
    superposed_g: FloatArray  # (N,) the sum of its pairs


def examine_formation(model: InteractionModel, formation: str, team: str) -> _Swarm:
    """Forces on every drone of a resting formation; the team is from the lowest up."""
    position = _FORMATIONS[formation](len(team))
    orders = [[i, *(j for j in range(len(team)) if j != i)] for i in range(len(team))]
    joint, superposed = np.zeros((2, len(team)))
    for i, order in enumerate(orders):
        arguments = model, [team[j] for j in order], position[None, order]
        joint[i] = force_on_ego_g(*arguments)[0]
        superposed[i] = superposed_force_g(*arguments)[0]
    apart = np.abs(position[:, None] - position[None])
    inside = (apart < [LATERAL_REACH, LATERAL_REACH, VERTICAL_REACH]).all(axis=-1)
    return _Swarm(formation, team, position, inside.sum(axis=1) - 1, joint, superposed)


def all_swarms(model: InteractionModel) -> list[_Swarm]:
    """Stacks and rings of small drones of every size, and of large above small ones."""
    swarms = [examine_formation(model, f, "S" * n) for f in _FORMATIONS for n in _SIZES]
    return swarms + [examine_formation(model, "stack", "S" + "L" * (n - 1)) for n in _SIZES]


def _numbers_of(s: _Swarm) -> dict[str, Any]:
    worst = int(s.joint_g.argmin())
    return {
        "formation": s.formation,
        "team_from_below": s.team,
        "drones": len(s.team),
        "most_neighbours": int(s.neighbours.max()),
        "measured_at_most": _MEASURED_NEIGHBOURS,
        "neighbours_beyond_measured": int(max(s.neighbours.max() - _MEASURED_NEIGHBOURS, 0)),
        "drones_beyond_measured": int((s.neighbours > _MEASURED_NEIGHBOURS).sum()),
        "highest_force_g": round(float(s.joint_g.max()), 3),
        "strongest_force_g": round(float(s.joint_g[worst]), 3),
        "its_sum_of_pairs_g": round(float(s.superposed_g[worst]), 3),
        "its_neighbours": int(s.neighbours[worst]),
        "forces_g": np.round(s.joint_g, 3).tolist(),
        "sums_of_pairs_g": np.round(s.superposed_g, 3).tolist(),
        "neighbours": s.neighbours.tolist(),
    }


def plot_swarms(path: Path, swarms: Sequence[_Swarm], model: InteractionModel) -> None:
    """Draw forces over height in stacks and rings, and over the number of drones."""
    drawn = [s for s in swarms if set(s.team) == {"S"}]
    headline = f"Larger swarms than were measured, model {model.name!r}"
    with picture(path, 15.0, 8.0, headline) as figure:
        sizes = list(dict.fromkeys(len(s.team) for s in drawn))
        grid = figure.add_gridspec(2, len(sizes) + 1, width_ratios=[1.0] * len(sizes) + [2.2])
        for row, formation in enumerate(_FORMATIONS):
            own = [s for s in drawn if s.formation == formation]
            values = np.concatenate([v for s in own for v in (s.joint_g, s.superposed_g)])
            margin = 0.05 * float(np.ptp(values)) + 0.2
            for column, s in enumerate(own):
                axis = figure.add_subplot(grid[row, column])
                _profile(axis, s)
                axis.set_xlim(values.min() - margin, values.max() + margin)
                if column == 0:
                    axis.set_ylabel("Height (m)")
            _growth(figure.add_subplot(grid[row, -1]), model, formation)
        figure.supxlabel(
            f"The flights have at most {_MEASURED_NEIGHBOURS} neighbours: beyond, a model "
            "extrapolates how they add up. Filled: joint force; open: sum of its pairs.",
            fontsize=9,
        )


def _profile(axis: Axes, s: _Swarm) -> None:
    height = s.position[:, 2]
    for z, joint, pairs in zip(height, s.joint_g, s.superposed_g, strict=True):
        axis.plot([joint, pairs], [z, z], color="#A8ADB3", linewidth=0.9, zorder=1)
    axis.plot(s.superposed_g, height, "o", color=GREY, markerfacecolor="white", markersize=5)
    axis.plot(s.joint_g, height, "o", color=_JOINT, markersize=5)
    axis.axvline(0.0, color=GREY, linewidth=0.8, zorder=0)
    axis.set_ylim(
        _LOWEST_M - 0.15, _LOWEST_M + (16 * _SPACING_M if s.formation == "stack" else 1.1)
    )
    neighbours = int(s.neighbours.max())
    name = "Stack" if s.formation == "stack" else "Rings"
    title = f"{name} of {len(s.team)}: {neighbours} neighbours"
    label_axis(axis, title, "Force on each drone (g)")


def _growth(axis: Axes, model: InteractionModel, formation: str) -> None:
    """Force on the lowest drone of growing formations, jointly and as a sum of pairs."""
    largest = _SIZES[-1]
    for kind, color in (("S", _JOINT), ("L", "#D55E00")):
        found = [examine_formation(model, formation, "S" + kind * n) for n in range(largest)]
        number = np.arange(largest)
        joint, pairs = [s.joint_g[0] for s in found], [s.superposed_g[0] for s in found]
        name = "small" if kind == "S" else "large"
        axis.plot(number, joint, "-o", color=color, markersize=4, label=f"{name} ones, joint")
        axis.plot(number, pairs, "--o", color=color, markersize=4, markerfacecolor="white",
                  label=f"{name} ones, sum of pairs")  # fmt: skip
    axis.axvspan(-0.4, _MEASURED_NEIGHBOURS + 0.5, color="#E8F1E4", zorder=0)
    axis.text(0.05, 0.03, "measured", transform=axis.get_xaxis_transform(), color=GREY)
    title = f"The lowest drone, small, under more and more others ({formation})"
    axis.set_xlim(-0.4, largest - 0.6)
    others = f"Other drones in its {formation}"
    label_axis(axis, title, others, "Force on the lowest drone (g)", zero=True)
    if formation == next(iter(_FORMATIONS)):
        axis.legend(fontsize=8, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 0.93))


def _report(options: Any, cells: Mapping[str, Any]) -> Report:
    """Fig. 5, its superposition gaps, and larger swarms."""
    model, truth = options.model, options.truth
    forces = load(model)
    true_forces = None if truth is None else load(truth)
    name = Path(forces.name).name
    with tqdm(total=2, unit="step", desc="Fig. 5") as bar:
        maps = [force_map(forces, case) for case in MAP_CASES]
        bar.update()
        swarms = all_swarms(forces)
        bar.update()
    pictures: dict[str, tuple[str, Callable[[Path], None]]] = {
        "heat_maps": ("figure_5.png", partial(plot_heat_maps, maps=maps, model=name)),
        "superposition_gaps": ("superposition_gaps.png", partial(plot_gaps, maps=maps, model=name)),
        "larger_swarms": ("larger_swarms.png", partial(plot_swarms, swarms=swarms, model=forces)),
    }
    summary = summarise_maps(maps, name) | {
        "larger_swarms": [_numbers_of(swarm) for swarm in swarms]
    }
    if true_forces is not None:
        summary["generalisation"] = generalisation(forces, true_forces, seed=options.seed)
    summary["files"] = {kind: file for kind, (file, _) in pictures.items()}
    return Report(summary, format_summary(summary), files=dict(pictures.values()))


def format_summary(summary: dict[str, Any]) -> str:
    """The paper's readings and the results, and the largest gaps, as text."""
    rows = [("reading of Fig. 5 (g)", "paper", "its weights", "result")]
    for r in summary["readings"]:
        values = (r["paper_g"], r["published_weights_g"], r["ours_g"])
        rows.append((r["what"], *(f"{value:.1f}" for value in values)))
    lines = format_columns(rows)
    for case in summary["cases"]:
        if case["superposition_gap"]:
            gap = case["superposition_gap"]["where_free"]
            lines.append(
                f"({case['case']}): sum of pairs minus joint force up to {gap['gap_g']:+.1f} g "
                f"at y = {gap['y_m']:.2f}, z = {gap['z_m']:.2f} m"
            )
    for s in summary["larger_swarms"]:
        small = set(s["team_from_below"]) == {"S"}
        lines.append(
            f"{s['formation']} of {s['drones']}, "
            f"{'all small' if small else 'one small below large ones'}: up to "
            f"{s['most_neighbours']} neighbours, {s['neighbours_beyond_measured']} more than "
            f"measured; forces {s['strongest_force_g']:z.1f} to {s['highest_force_g']:+z.1f} g"
        )
    for team in summary.get("generalisation", []):
        lines.append(
            f"{team['team']}: {100 * team['explained']:.1f} % of the true force explained, "
            f"{team['mean_neighbours']:.1f} neighbours on average"
        )
    return "\n".join(lines)


def _claims(numbers: Any, extent: Extent) -> list[Claim]:
    found = []
    for reading in numbers["readings"]:
        paper, authors = reading["paper_g"], reading["published_weights_g"]
        spare = Reason(
            f"the authors' own published weights say {authors:+.1f} g here; nothing is tuned to "
            "the figure",
            Between(*sorted((authors, paper))),
        )
        what = f"{reading['what']}, g"
        found.append(Claim(what, f"{paper:+g}", reading["ours_g"], about(paper, 0.25), (spare,)))
    return found


FIGURE_5 = Study(
    paper="neural-swarm2",
    name="figure-5",
    shows="heat maps of the force on a small drone, eight surroundings",
    takes=("model", "truth"),
    report=_report,
    claims=_claims,
    pictures=("figure_5.png", "superposition_gaps.png"),
)
"""One model, all of its pictures."""
