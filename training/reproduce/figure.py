"""Figure 5 and what belongs to it: pictures and numbers of one model in one folder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from swarm_envs.arguments import typed
from swarm_envs.files import write_json
from swarm_envs.interactions import load
from swarm_envs.training.force_model.explained import generalisation
from swarm_envs.training.reproduce.bin_plots import plot_calibration, plot_curves
from swarm_envs.training.reproduce.bins import compare, predict_bins, read_bins
from swarm_envs.training.reproduce.heatmaps import plot_gaps, plot_heat_maps
from swarm_envs.training.reproduce.larger import all_swarms, plot_swarms, summarise_swarms
from swarm_envs.training.reproduce.maps import all_maps, summarise

_FILES = {
    "heat_maps": "figure_5.png",
    "superposition_gaps": "superposition_gaps.png",
    "larger_swarms": "larger_swarms.png",
    "calibration": "calibration.png",
    "curves": "force_curves.png",
}
"""Pictures; the last two only with measured bins."""


@typed
def reproduce_figure(
    out: Path,
    model: str | Path = "learned",
    bins: Path | None = None,
    truth: str | Path | None = None,
    seed: int = 0,
    step_m: float = 0.01,
    progress: bool = True,
) -> dict[str, Any]:
    """Draw Fig. 5, its superposition gaps, larger swarms, and the calibration if bins are given.

    Args:
        out: folder for `figure_5.json` and the pictures.
        model: name of a model that ships, or path of a weights file.
        bins: table of measured bins; None leaves the calibration out.
        truth: the force that blew where the model was learned, in simulation: how much of it the
            model explains is asked on swarms of 2 to 16 drones; None leaves that out.
        seed: of those swarms.
        step_m: grid of the heat maps.
        progress: show a progress bar.

    Returns:
        What `figure_5.json` holds.

    Raises:
        FileNotFoundError: there is no such weights file or table.
        ValueError: the model or the table cannot be used.
    """
    forces = load(model)
    table = None if bins is None else read_bins(bins)
    blowing = None if truth is None else load(truth)
    name = Path(forces.name).name
    files = dict(_FILES if table else list(_FILES.items())[:3])
    with tqdm(total=3 + len(files), disable=not progress, unit="step", desc="Fig. 5") as bar:
        maps = all_maps(forces, step_m)
        bar.update()
        swarms = all_swarms(forces)
        bar.update()
        predicted = predict_bins(forces, table) if table else []
        bar.update()
        pictures: dict[str, Callable[[Path], None]] = {
            "heat_maps": lambda path: plot_heat_maps(path, maps, name),
            "superposition_gaps": lambda path: plot_gaps(path, maps, name),
            "larger_swarms": lambda path: plot_swarms(path, swarms, forces),
            "calibration": lambda path: plot_calibration(path, predicted, name),
            "curves": lambda path: plot_curves(path, predicted, name),
        }
        for kind, file in files.items():
            pictures[kind](out / file)
            bar.update()
    summary = summarise(maps, name) | {"larger_swarms": summarise_swarms(swarms)}
    if table:
        summary["calibration"] = {
            "errors": compare(predicted),
            "bins": [dataclasses.asdict(b) for b in predicted],
        }
    if blowing is not None:
        explained = generalisation(forces, blowing, seed=seed)
        summary["generalisation"] = [team._asdict() for team in explained]
    summary["files"] = files
    write_json(out / "figure_5.json", summary)
    return summary


def format_summary(summary: dict[str, Any]) -> str:
    """The paper's readings beside ours, and the largest gaps, as text."""
    lines = [f"{'reading of Fig. 5 (g)':44}{'paper':>7}{'its weights':>13}{'ours':>8}"]
    for r in summary["readings"]:
        lines.append(
            f"{r['what']:44}{r['paper_g']:7.1f}{r['published_weights_g']:13.1f}{r['ours_g']:8.1f}"
        )
    for case in summary["cases"]:
        if case["superposition_gap"]:
            gap = case["superposition_gap"]["where_free"]
            lines.append(
                f"({case['case']}): sum of pairs minus joint force up to {gap['gap_g']:+.1f} g "
                f"at y = {gap['y_m']:.2f}, z = {gap['z_m']:.2f} m"
            )
    for s in summary["larger_swarms"]:
        lines.append(
            f"{s['formation']} of {s['drones']}, {_team(s['team_from_below'])}: up to "
            f"{s['most_neighbours']} neighbours, {s['neighbours_beyond_measured']} more than "
            f"measured; forces {s['strongest_force_g']:z.1f} to {s['highest_force_g']:+z.1f} g"
        )
    for team in summary.get("generalisation", []):
        lines.append(
            f"{team['team']}: {100 * team['explained']:.1f} % of the true force explained, "
            f"{team['mean_neighbours']:.1f} neighbours on average"
        )
    if "calibration" in summary:
        whole = summary["calibration"]["errors"]["all"]
        lines.append(
            f"measured bins: off by {whole['root_mean_square_error_g']:.2f} g root mean square "
            f"over {whole['bins']} bins"
        )
    return "\n".join(lines)


def _team(from_below: str) -> str:
    return "all small" if set(from_below) == {"S"} else "one small below large ones"
