"""What a force model leaves over, as a random process: `swarm-envs fit --residual`.

The vertical label of drone i at time t, less the modelled force f, is taken as

    offset_i + s(|f|) x(t) + white noise,  s(|f|) / W = quiet + (wake - quiet) |f| / (|f| + half W),

W being the drone's weight and x an Ornstein-Uhlenbeck process of unit variance and one
correlation time. The offset belongs to a drone in a flight: calibration of mass and thrust. Labels
hold noise of the sensors, which no drone feels: it is white, so the autocovariance jumps by its
variance at lag zero (the *nugget*), and is kept apart by fitting the other lags.

The model is refitted for each fold of whole flights, and looked at on the flights left out.
Intervals are percentiles of a bootstrap over flights. These numbers are the defaults of
`swarm_envs.hall.Hall`; docs/hall.md says how they were made.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from swarm_envs.arguments import typed
from swarm_envs.errors import check_name
from swarm_envs.files import write_json
from swarm_envs.interactions import load
from swarm_envs.interactions.forces import all_forces
from swarm_envs.training.force_model.fit_data import data_sha256, read_data
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.labels import treat
from swarm_envs.training.force_model.residual_config import ResidualConfig
from swarm_envs.training.force_model.wake_fit import fit_wake, wake_force_g, wake_rows
from swarm_envs.training.interaction_rows.rows import (
    BoolArray,
    FloatArray,
    IntArray,
    InteractionRows,
)
from swarm_envs.training.provenance import json_ready
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, VEHICLES

__all__ = ["fit_residual"]

REPORT = "residual.json"
"""File that a fit writes."""
LAGS = 7
"""Lags of the autocovariance, in rows, zero included: 0 to 180 ms at 33 Hz."""
EDGES = (0.0, 0.01, 0.03, 0.06, 0.1, 0.16, 0.25, np.inf)
"""Edges of the bins of |f| / W."""
CALM = 0.03
"""Offsets are means over rows with less |f| / W than this: the model can err little there."""
_START = (0.03, 0.08, 0.03, 0.13)
_LOWEST = (1e-4, 1e-4, 1e-4, 1e-2)
_HIGHEST = (1.0, 2.0, 2.0, 3.0)


class Moments(NamedTuple):
    """Sums over pairs of rows of one drone: flights F, types T, bins B of |f| / W, lags L."""

    product: FloatArray
    """(F, T, B, L) products of the residuals, over the squared weight."""
    force: FloatArray
    """(F, T, B, L) |f| / W, the mean of both rows."""
    number: FloatArray
    """(F, T, B, L) pairs."""
    sideways: FloatArray
    """(F, 2) products at lag one in calm rows: vertical, and the mean of the horizontal ones."""
    offset: FloatArray
    """(D,) offset of a drone in a flight over its weight, less the mean of its type."""
    flight: IntArray
    """(D,) its flight, of F."""
    kind: IntArray
    """(D,) its type, of T."""
    interval_s: float
    """Time between rows, s."""


@dataclass(frozen=True)
class ResidualReport:
    """What was identified."""

    types: tuple[str, ...]
    """The types, in the order of the lists below."""
    residual: dict[str, list[float]]
    """The numbers, by the names of `Hall`: for each type, or one for all."""
    intervals: dict[str, list[tuple[float, float]]]
    """Their 95 % intervals."""
    white_noise_g: list[float]
    """Standard deviation of the labels' white noise by type, gram-force."""
    bins: list[dict[str, Any]]
    """By type and bin of |f|: what the fit saw."""
    config: Any
    """The options."""
    data_sha256: str
    """Digest of the data."""
    flights: int
    """Number of flights."""
    rows: int
    """Number of rows."""
    cross_validated: bool
    """Whether every flight was looked at by a model that had not seen it."""

    def lines(self) -> list[str]:
        """The report in words."""
        said = [f"{self.rows} rows of {self.flights} flights; types {', '.join(self.types)}"]
        for name, values in self.residual.items():
            pairs = zip(values, self.intervals[name], strict=True)
            told = [f"{value:.4f} ({low:.4f} to {high:.4f})" for value, (low, high) in pairs]
            said.append(f"{name.ljust(18)} {', '.join(told)}")
        noise = ", ".join(f"{value:.2f} g" for value in self.white_noise_g)
        return [*said, f"white noise of the labels: {noise}"]


@typed
def fit_residual(config: ResidualConfig) -> ResidualReport:
    """Identify what a force model leaves over, and write `residual.json` into `config.out`.

    Raises:
        FileNotFoundError: there is no data.
        ValueError: the rows cannot be used, or a type is no vehicle that ships.
    """
    rows, _ = read_data(config.data, config.logs, config.progress, offsets=False)
    for name in rows.types:
        check_name("vehicle type", name, tuple(VEHICLES))
    if len(np.unique(rows.flight)) < config.folds:
        raise ValueError(
            f"there are {len(np.unique(rows.flight))} flights, but {config.folds} folds need as "
            "many; add flights, or give --folds"
        )
    modelled = predicted_g(rows, config)
    moments = measured_moments(rows, modelled, config.logs.rate_hz)
    everyone: FloatArray = np.ones(len(moments.number))
    found, white = identified(moments, everyone)
    rng, flights = np.random.default_rng(config.seed), len(everyone)
    drawn = (rng.multinomial(flights, everyone / flights) for _ in range(config.bootstrap))
    draws = [identified(moments, times.astype(np.float64))[0] for times in drawn]
    ends = {
        name: np.quantile([draw[name] for draw in draws], (0.025, 0.975), axis=0) for name in found
    }
    report = ResidualReport(
        types=rows.types,
        residual=found,
        intervals={name: list(zip(*two.tolist(), strict=True)) for name, two in ends.items()},
        white_noise_g=(_weights_g(rows.types) * white).tolist(),
        bins=_bins(rows.types, moments),
        config=json_ready(config),
        data_sha256=data_sha256(config.data),
        flights=flights,
        rows=len(rows),
        cross_validated=config.force == "wake",
    )
    for path in (config.out / REPORT, config.json):
        if path is not None:
            write_json(path, json_ready(report))
    return report


def predicted_g(rows: InteractionRows, config: ResidualConfig) -> FloatArray:
    """(R,) modelled vertical force, drag included, gram-force."""
    if config.force != "wake":
        return _force_of_file(rows, config.force)
    rng, part = np.random.default_rng(config.seed), np.zeros(int(rows.flight.max()) + 1, np.int64)
    for scenario in np.unique(rows.scenario):
        flights = rng.permutation(np.unique(rows.flight[rows.scenario == scenario]))
        part[flights] = np.arange(len(flights)) % config.folds
    fold, found = part[rows.flight], np.zeros(len(rows))
    options = FitConfig(data=config.data, out=config.out, model="wake")
    for k in range(config.folds):
        held = fold == k
        treated = treat(dataclasses.replace(rows, validation=held), options)
        train = np.flatnonzero(~held)
        chosen = rng.choice(train, min(config.rows, len(train)), replace=False)
        wake = fit_wake(treated.target.select(np.sort(chosen)), "neighbor")
        own = rows.select(held)
        drag = treated.drag[own.ego_type, 2] * own.velocity[:, 2] / GRAM_FORCE
        found[held] = wake_force_g(wake, wake_rows(own, "neighbor")) - drag
    return found


def _force_of_file(rows: InteractionRows, name: str) -> FloatArray:
    """Vertical force (R,) of a model as it is, gram-force."""
    model, found = load(name), np.zeros(len(rows))
    place = np.array([model.types.index(kind) for kind in rows.types])
    for count in range(rows.neighbor_type.shape[1] + 1):
        own = rows.select(rows.has_neighbor.sum(axis=1) == count)
        if not len(own):
            continue
        order = np.argsort(~own.has_neighbor, axis=1, kind="stable")[:, :count]
        pair = np.take_along_axis(own.neighbor, order[..., None], axis=1)
        others = np.take_along_axis(own.neighbor_type, order, axis=1)
        position = np.concatenate([own.position[:, None], own.position[:, None] + pair[..., :3]], 1)
        velocity = np.concatenate([own.velocity[:, None], own.velocity[:, None] + pair[..., 3:]], 1)
        kinds = place[np.concatenate([own.ego_type[:, None], others], axis=1)]
        out = np.empty_like(position)
        all_forces(model.packed, kinds, position, velocity, out)
        found[rows.has_neighbor.sum(axis=1) == count] = out[:, 0, 2] / GRAM_FORCE
    return found


def measured_moments(rows: InteractionRows, modelled_g: FloatArray, rate_hz: float) -> Moments:
    """Products of residuals by flight, type, force and lag.

    Args:
        rows: of all flights; gaps are left out.
        modelled_g: (R,) what the model says.
        rate_hz: steps of the rows' clock a second.
    """
    weight = _weights_g(rows.types)[rows.ego_type]
    force = np.abs(modelled_g) / weight
    flights, flight = np.unique(rows.flight, return_inverse=True)
    who = np.stack([flight, rows.vehicle, rows.ego_type])
    drones, owner = np.unique(who, axis=1, return_inverse=True)
    owner = owner.reshape(-1)
    left = rows.force_g / weight[:, None]
    left[:, 2] -= modelled_g / weight
    offset, known = _means(left, owner, force < CALM)
    left = left - offset[owner]
    table = np.zeros((3, len(flights), len(rows.types), len(EDGES) - 1, LAGS))
    sideways = np.zeros((len(flights), 2))
    every = int(np.median(np.diff(np.unique(rows.step))))
    for lag in range(LAGS):
        first, second = _pairs(owner, rows.step, lag * every)
        product, both = left[first] * left[second], 0.5 * (force[first] + force[second])
        where: Any = (flight[first], rows.ego_type[first], np.digitize(both, EDGES) - 1, lag)
        for slot, values in enumerate((product[:, 2], both, np.ones(len(first)))):
            np.add.at(table[slot], where, values)
        if lag == 1:
            calm = both < CALM
            for k, values in enumerate((product[calm, 2], product[calm, :2].mean(axis=1))):
                sideways[:, k] = np.bincount(flight[first][calm], values, len(flights))
    home, kind = drones[0][known], drones[2][known]
    vertical = offset[known, 2]
    for index in range(len(rows.types)):
        vertical[kind == index] -= vertical[kind == index].mean()
    product, both, number = table
    return Moments(product, both, number, sideways, vertical, home, kind, every / rate_hz)


def _weights_g(types: Sequence[str]) -> FloatArray:
    return np.array([VEHICLES[name].mass * GRAVITY / GRAM_FORCE for name in types])


def _means(values: FloatArray, owner: IntArray, use: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Means (D, 3) of the rows to use of each owner, and (D,) who has any; zeros without."""
    count = np.bincount(owner, use)
    sums = [np.bincount(owner, values[:, k] * use) for k in range(3)]
    return np.stack(sums, axis=1) / np.maximum(count, 1.0)[:, None], np.asarray(count > 0)


def _pairs(owner: IntArray, step: IntArray, lag: int) -> tuple[IntArray, IntArray]:
    """Rows of one drone in one flight that lie so many steps apart."""
    code = owner.astype(np.int64) * 10**9 + step
    order = np.argsort(code, kind="stable")
    place = np.searchsorted(code[order], code + lag)
    there = place < len(code)
    there[there] = code[order[place[there]]] == code[there] + lag
    return np.flatnonzero(there), order[place[there]]


def size(force: FloatArray, quiet: FloatArray, wake: FloatArray, half: FloatArray) -> FloatArray:
    """Standard deviation of the residual at forces |f|, all over the weight; `half`: halfway."""
    return np.asarray(quiet + (wake - quiet) * force / (force + half))


def identified(moments: Moments, times: FloatArray) -> tuple[dict[str, list[float]], FloatArray]:
    """The numbers of `Hall`, and (T,) the standard deviation of the labels' white noise over W.

    Args:
        moments: of the flights.
        times: (F,) how often each flight counts.
    """
    product, force, number = (np.tensordot(times, table, 1) for table in moments[:3])
    sizes, time_s, white = _autocovariance(product, force, number, moments.interval_s)
    vertical, horizontal = times @ moments.sideways
    share, offsets = times[moments.flight], []
    for kind in range(len(product)):
        own = share * (moments.kind == kind)
        offsets.append(float(np.sqrt(own @ moments.offset**2 / max(own.sum(), 1.0))))
    found = dict(zip(("residual_quiet", "residual_wake", "residual_half"), sizes, strict=True))
    return {
        **{name: values.tolist() for name, values in found.items()},
        "offset": offsets,
        "residual_time_s": [time_s],
        "residual_sideways": [float(np.sqrt(max(horizontal, 0.0) / max(vertical, 1e-12)))],
    }, white


def _autocovariance(
    product: FloatArray, force: FloatArray, number: FloatArray, interval_s: float
) -> tuple[FloatArray, float, FloatArray]:
    """Fit tables (T, B, L): sizes (3, T), a correlation time, and (T,) roots of the nuggets."""
    types, some = len(product), np.maximum(number, 1.0)
    covariance, place = product / some, force / some
    importance = np.sqrt(number[..., 1:]) / np.maximum(covariance[..., 1:2], 1e-8)
    lag_s = interval_s * np.arange(LAGS)

    def expected(numbers: FloatArray) -> FloatArray:
        sizes = numbers[:-1].reshape(3, types, 1, 1)
        return size(place, *sizes) ** 2 * np.exp(-lag_s / numbers[-1])

    def error(numbers: FloatArray) -> FloatArray:
        return np.ravel(importance * (expected(numbers) - covariance)[..., 1:])

    start, low, high = (np.repeat(ends, [types] * 3 + [1]) for ends in (_START, _LOWEST, _HIGHEST))
    numbers = least_squares(error, start, bounds=(low, high), x_scale=start).x
    jump = (number * (covariance - expected(numbers)))[..., 0].sum(axis=1)
    white = np.sqrt(np.maximum(jump / np.maximum(number[..., 0].sum(axis=1), 1.0), 0.0))
    return numbers[:-1].reshape(3, types), float(numbers[-1]), np.asarray(white)


def _bins(types: Sequence[str], moments: Moments) -> list[dict[str, Any]]:
    """Standard deviation and autocorrelation by type and force, gram-force."""
    product, force, count = (table.sum(axis=0) for table in moments[:3])
    found = []
    for t, b in np.argwhere(count[..., 0] >= 100):
        weight = _weights_g(types)[t]
        covariance = product[t, b] / np.maximum(count[t, b], 1.0)
        found.append(
            {
                "type": types[t],
                "rows": int(count[t, b, 0]),
                "force_g": float(weight * force[t, b, 0] / count[t, b, 0]),
                "std_g": float(weight * np.sqrt(covariance[0])),
                "autocorrelation": (covariance[1:] / covariance[0]).round(3).tolist(),
            }
        )
    return found
