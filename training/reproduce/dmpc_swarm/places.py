"""Fig. 3a: the formations that the swarm flies through."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, formation, scaled_distances
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.files import write_json, write_table
from swarm_envs.training.reproduce.dmpc_swarm.cells import DRONES
from swarm_envs.training.reproduce.style import GREY, picture


def reproduce_places(out: Path) -> dict[str, Any]:
    """Draw the formations, and write `figure_3a.json`, `.csv` and `.png`.

    Args:
        out: folder, made if missing.

    Returns:
        What the JSON file holds.
    """
    config, names = MlrDmpcConfig(), list(dict.fromkeys(SEQUENCE))
    places = {name: formation(name, DRONES) for name in names}
    summary = {
        "sequence": list(SEQUENCE),
        "distance_m": config.distance_m,
        "formations": {
            name: {
                "drones": len(points),
                "least_scaled_distance_m": round(float(scaled_distances(points, config).min()), 4),
            }
            for name, points in places.items()
        },
    }
    write_table(
        out / "figure_3a.csv",
        [
            {"formation": name, "drone": i}
            | dict(zip(("x_m", "y_m", "z_m"), np.round(p, 4).tolist(), strict=True))
            for name, points in places.items()
            for i, p in enumerate(points)
        ],
    )
    with picture(out / "figure_3a.png", 12.0, 3.6, "Fig. 3a: the formations") as figure:
        for k, (name, points) in enumerate(places.items()):
            axis = figure.add_subplot(1, len(places), k + 1, projection="3d")
            axis.scatter(*points.T, s=30, c=points[:, 2], cmap="viridis", depthshade=False)
            for x, y, z in points:
                axis.plot([x, x], [y, y], [0.0, z], color=GREY, linewidth=0.5)
            low, high = config.box
            axis.set(title=name, xlabel="x (m)", ylabel="y (m)")
            axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(0.0, high[2]))
            axis.set_box_aspect((1, 1, 0.75))
    write_json(out / "figure_3a.json", summary)
    return summary


def format_places(summary: dict[str, Any]) -> str:
    """The least distances, as text."""
    return "\n".join(
        f"{name:10}{entry['drones']:4} drones, least scaled distance "
        f"{entry['least_scaled_distance_m']:.3f} m"
        for name, entry in summary["formations"].items()
    )
