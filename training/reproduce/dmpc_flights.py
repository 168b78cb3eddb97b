"""Flights of DMPC-Swarm's experiments, swarms of references through targets, and their pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swarm_envs.baselines.mlr_dmpc.formations import SEQUENCE, circle_swap, formation
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm
from swarm_envs.state import FloatArray
from swarm_envs.training.reproduce.charts import label_axis
from swarm_envs.training.reproduce.study import Cell
from swarm_envs.vehicles import SMALL
from swarm_envs.viewing.record import About, Recording
from swarm_envs.viewing.style import GREY, picture

DRONES = 16  # As in the paper
CRASH_M = 0.12  # Scaled distance at which the paper counts a crash, m
_SEQUENCE_LIMIT_S, _CIRCLE_LIMIT_S = 120.0, 60.0  # when a flight is given up
_RADIUS_M, _HEIGHT_M = 1.5, 1.0  # of the circle
_SAMPLES = 10  # instants kept of each round
_PUBLISHED = MlrDmpcConfig(planes="fixed")


@dataclass(frozen=True)
class ReferenceFlight:
    """What the references of N drones did. T samples, a fiftieth of a second apart."""

    time: FloatArray  # (T,) s
    position: FloatArray  # (T, N, 3) m
    target: FloatArray  # (T, N, 3) m
    arrivals_s: tuple[float, ...]  # When all had arrived at each formation that they reached
    wanted: int  # Formations to reach
    scaled_distance: FloatArray  # (T,) least scaled distance of any two references, m

    @property
    def total_s(self) -> float | None:
        """When the last formation was reached, s; None if it was not."""
        return self.arrivals_s[-1] if len(self.arrivals_s) == self.wanted else None

    @property
    def legs_s(self) -> list[float]:
        """Time for each formation reached, s."""
        return [float(leg) for leg in np.diff([0.0, *self.arrivals_s])]


def fly_sequence(**options: Any) -> ReferenceFlight:
    """Plane, pyramid, cube, sphere and plane (Fig. 3a) by 16 drones; options of `MlrDmpcSwarm`."""
    places = [formation(name, DRONES) for name in SEQUENCE]
    return fly_references(places[0], places[1:], _SEQUENCE_LIMIT_S, _PUBLISHED, **options)


def fly_circle(**options: Any) -> ReferenceFlight:
    """Each of 16 drones to the opposite side of a circle; options of `MlrDmpcSwarm`."""
    starts, targets = circle_swap(DRONES, _RADIUS_M, _HEIGHT_M)
    return fly_references(starts, [targets], _CIRCLE_LIMIT_S, _PUBLISHED, **options)


def fly_references(
    starts: FloatArray,
    formations: Sequence[FloatArray],
    limit_s: float,
    config: MlrDmpcConfig,
    **options: Any,
) -> ReferenceFlight:
    """Fly from one formation (N, 3), m, to the next, begun in the round after that was reached.

    The flight is given up after `limit_s`; options are those of `MlrDmpcSwarm`.
    """
    swarm = MlrDmpcSwarm(starts, formations[0], config=config, **options)
    since = np.arange(_SAMPLES, dtype=np.float64) * (config.round_s / _SAMPLES)
    positions, targets = list[FloatArray](), list[FloatArray]()
    arrivals: list[float] = []
    for k in range(round(limit_s / config.round_s)):
        target = formations[len(arrivals)]
        flown = swarm.reference(since)[:, :, 0].transpose(1, 0, 2)
        positions.append(flown)
        targets.append(np.broadcast_to(target, flown.shape))
        away = np.linalg.norm(flown - target, axis=-1).max(axis=-1)
        near = np.flatnonzero(away <= config.arrival_m)
        if len(near):
            arrivals.append(k * config.round_s + float(since[near[0]]))
            if len(arrivals) == len(formations):
                break
        swarm.run_round(targets=formations[len(arrivals)])  # the round after it was reached
    position = np.concatenate(positions)
    time = np.arange(len(position), dtype=np.float64) * (config.round_s / _SAMPLES)
    first, second = np.triu_indices(position.shape[1], 1)
    apart = (position[:, first] - position[:, second]) * config.inverse_scaling
    closest = np.asarray(np.linalg.norm(apart, axis=-1).min(axis=-1))
    reached, wanted = tuple(arrivals), len(formations)
    return ReferenceFlight(time, position, np.concatenate(targets), reached, wanted, closest)


def recording_of(flight: ReferenceFlight, about: str, seed: int) -> Recording:
    """References as if they had been flown without error, level and in still air, for a replay."""
    shape, step = flight.position.shape, float(flight.time[1] - flight.time[0])
    nobody = np.full(shape[:2], -1, dtype=np.int64)
    never = np.zeros(shape[:2], dtype=bool)
    return Recording(
        team=(SMALL,) * shape[1],
        time=flight.time,
        position=flight.position,
        quaternion=np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*shape[:2], 4)).copy(),
        reference=flight.target,
        force=np.zeros(shape),
        velocity=np.gradient(flight.position, step, axis=0),
        rotor_thrust=np.zeros((*shape[:2], 4)),
        goal=flight.target,
        setpoint=flight.position,
        contact_drone=nobody,
        contact_floor=never,
        contact_wall=never,
        contact_obstacle=nobody,
        tumbling=never,
        reward=np.full(shape[:2], np.nan),
        reward_terms={},
        about=About(
            task=f"mlr-dmpc, {about}",
            agent="references",
            seed=seed,
            physics="no",
            decision_rate=round(1.0 / step),
            arena=MlrDmpcConfig().box,
            solids=(),
            metrics={},
        ),
    )


LOSSES = (0.0, 1e-4, 0.01, 0.1, 0.2, 0.3, 0.4, 0.5)  # Shares of messages lost in the sweep
MODES: Mapping[str, Any] = {"ours": True, "paper's": "paper", "none": False}  # How loss is met
THEIRS: Mapping[str, float] = {
    "1 CU": 69.8,
    "2 CUs": 44.4,
    "3 CUs": 38.4,
    "RR": 55.4,
    "DT": 34.2,
    "HT": 38.4,
    "jam, paper's": 31.2,
}
"""Time to the last arrival of the authors' public simulation, s, on shapes of its own; the paper
prints no numbers. In the jam it took 29.6 to 32.8 s, and without recovery it failed."""
JAM_S = 2.0  # For so long compute units hear nothing in Fig. 4.
_COLORS = ("#0072B2", "#D55E00", "#009E73")


def median_total(cell: Cell) -> float:
    """Median of the times to the last arrival, s; NaN unless at least half arrived."""
    totals = sorted(float("inf") if t is None else float(t) for t in cell["total_s"])
    middle = totals[(len(totals) - 1) // 2]
    return float("nan") if middle == float("inf") else middle


def plot_formations(path: Path, places: Mapping[str, Any], box: Any) -> None:
    """Where the drones of each formation stand, in the box that they fly in."""
    with picture(path, 12.0, 3.6, "Fig. 3a: the formations") as figure:
        for k, (name, points) in enumerate(places.items()):
            axis: Any = figure.add_subplot(1, len(places), k + 1, projection="3d")
            axis.scatter(*points.T, s=30, c=points[:, 2], cmap="viridis", depthshade=False)
            for x, y, z in points:
                axis.plot([x, x], [y, y], [0.0, z], color=GREY, linewidth=0.5)
            low, high = box
            axis.set(title=name, xlabel="x (m)", ylabel="y (m)")
            axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(0.0, high[2]))
            axis.set_box_aspect((1, 1, 0.75))


def plot_sequence(
    path: Path, figure: str, flights: Mapping[str, ReferenceFlight], cells: Mapping[str, Cell]
) -> None:
    """Mean distance to the targets over time, and the times to the last arrival."""
    by = "compute units" if figure == "3b" else "triggers"
    headline = f"Fig. {figure}: sixteen drones through five formations, by {by}"
    with picture(path, 11.0, 4.2, headline) as canvas:
        left, right = canvas.subplots(1, 2, width_ratios=(2.2, 1.0))
        for (name, flight), color in zip(flights.items(), _COLORS, strict=False):
            away = np.linalg.norm(flight.position - flight.target, axis=-1).mean(axis=-1)
            left.plot(flight.time, away, color=color, label=name)
            for arrival in flight.arrivals_s:
                left.axvline(arrival, color=color, linewidth=0.7, linestyle=":")
        distance = "Mean distance to the targets (m)"
        label_axis(left, "Dotted: all have arrived", "Time (s)", distance, legend=10)
        place = np.arange(len(cells))
        ours = np.nan_to_num([median_total(cell) for cell in cells.values()])
        right.bar(place - 0.2, ours, 0.4, color=list(_COLORS[: len(cells)]), label="swarm-envs")
        known = [THEIRS.get(name, 0.0) for name in cells]
        right.bar(place + 0.2, known, 0.4, color="#C9CED4", label="public simulation")
        right.set_xticks(place, list(cells))
        label_axis(right, grid="y", legend=8, ylabel="Time to the last arrival (s)")


def plot_jam(path: Path, flights: Mapping[str, ReferenceFlight]) -> None:
    """The paths seen from above, and the least distance of any two references."""
    headline = "Fig. 4: no compute unit hears anything for two seconds"
    with picture(path, 12.0, 4.2, headline) as figure:
        axes = figure.subplots(1, len(flights) + 1, width_ratios=(*[1.0] * len(flights), 1.5))
        for axis, (name, flight) in zip(axes, flights.items(), strict=False):
            axis.plot(flight.position[..., 0], flight.position[..., 1], linewidth=0.8)
            axis.plot(*flight.target[0, :, :2].T, "s", markersize=4, color=GREY)
            axis.set_aspect("equal")
            ended = "not all arrive" if flight.total_s is None else f"{flight.total_s:.1f} s"
            outcome = "crash" if flight.scaled_distance.min() < CRASH_M else ended
            axis.set(title=f"{name.split(', ')[1]}: {outcome}", xlabel="x (m)")
        last = axes[-1]
        for (name, flight), color in zip(flights.items(), _COLORS, strict=False):
            last.plot(flight.time, flight.scaled_distance, color=color, label=name.split(", ")[1])
        last.axvspan(0.0, JAM_S, color="#F1E3D3", label="jammed")
        last.axhline(MlrDmpcConfig().distance_m, color=GREY, linestyle="--", linewidth=0.9)
        last.axhline(CRASH_M, color="#B00020", linestyle="--", linewidth=0.9)
        last.set(xlabel="Time (s)", ylabel="Least scaled distance (m)", ylim=(0.0, 0.5))
        last.legend(fontsize=8, title="recovery")
        last.grid(True)


def plot_losses(path: Path, cells: Mapping[str, Cell]) -> None:
    """Time to the last arrival and least distance over the share of messages lost."""
    with picture(path, 10.0, 4.2, "What the radio loses, and how it is met") as figure:
        left, right = figure.subplots(1, 2)
        place = np.arange(len(LOSSES))
        for mode, color in zip(MODES, _COLORS, strict=True):
            row = [cells[f"{100 * loss:g} %, {mode}"] for loss in LOSSES]
            least = [min(cell["least_scaled_distance_m"]) for cell in row]
            left.plot(place, [median_total(cell) for cell in row], "o-", color=color, label=mode)
            right.plot(place, least, "o-", color=color, label=mode)
        left.set(ylabel="Median time to the last arrival (s)", ylim=(0.0, None))
        left.set_title("No point: half or more of the runs do not arrive")
        right.set(ylabel="Least scaled distance of any run (m)", ylim=(0.0, None))
        right.axhline(CRASH_M, color="#B00020", linestyle="--", linewidth=0.9, label="crash")
        for axis in (left, right):
            axis.set_xticks(place, [f"{100 * loss:g}" for loss in LOSSES])
            axis.set_xlabel("Messages lost (%)")
            axis.legend(fontsize=8, title="recovery")
            axis.grid(True)
