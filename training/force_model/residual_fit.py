"""The residual force of a model as a random process: `swarm-envs fit --residual`.

The vertical label of drone i at time t minus the modeled force f is

    offset_i + s(|f|) x(t) + white noise,  s(|f|) / W = quiet + (wake - quiet) |f| / (|f| + half W),

where W is the drone's weight and x an Ornstein-Uhlenbeck process of unit variance and one
correlation time. If no neighbor is in the interaction volume, s / W is a constant, `alone`, with
the same correlation time. The offset, constant for a drone in a flight, is due to the calibration
of mass and thrust. The sensor noise of the labels is white: its variance is the jump of the
autocovariance at lag zero (the *nugget*), and is separated by fitting the other lags. Rows of
falling drones are excluded, as in the fit of models.

The model is cross-validated over folds of whole flights. Intervals are percentiles of a bootstrap
over flights. These numbers are the defaults of `swarm_envs.hall.Hall`; see docs/hall.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from tqdm import tqdm

from swarm_envs.errors import check_name
from swarm_envs.files import write_json
from swarm_envs.interactions.field import INTERACTION_VOLUME
from swarm_envs.state import BoolArray, FloatArray, IntArray
from swarm_envs.training.flight_logs.read import data_sha256, read_data
from swarm_envs.training.force_model.compare import default_fit, fitted_force_g, flight_folds
from swarm_envs.training.force_model.force_fit_config import FitConfig
from swarm_envs.training.force_model.labels import prepare, without_falls
from swarm_envs.training.interaction_rows.modelled import modelled_force_g
from swarm_envs.training.interaction_rows.rows import InteractionRows
from swarm_envs.training.provenance import json_ready
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, VEHICLES

REPORT = "residual.json"  # Name of the output file
FITTED = ("composed", "wake")
"""Force models that are refitted to flights other than those on which they are evaluated."""
LAGS = 7  # Number of lags of the autocovariance, in rows, with zero: 0 to 180 ms at 33 Hz
EDGES = (0.0, 0.01, 0.03, 0.06, 0.1, 0.16, 0.25, np.inf)
"""Edges of the bins of |f| / W with neighbors; rows without neighbors are in a bin before them."""
CALM = 0.03
"""Bound of |f| / W of the rows whose mean is the offset, where model errors are small."""
_START = (0.03, 0.08, 0.03, 0.13)
_LOWEST = (1e-4, 1e-4, 1e-4, 1e-2)
_HIGHEST = (1.0, 2.0, 2.0, 3.0)


class _Moments(NamedTuple):
    """Sums over pairs of rows of one drone: flights F, types T, bins B, lags L."""

    product: FloatArray  # (F, T, B, L) products of the residuals over the squared weight
    force: FloatArray  # (F, T, B, L) |f| / W, the mean of both rows
    number: FloatArray  # (F, T, B, L) numbers of pairs
    sideways: FloatArray  # (F, 2) products at lag one in calm rows: vertical, mean of horizontal
    offset: FloatArray  # (D,) offset of a drone in a flight over weight, minus its type's mean
    flight: IntArray  # (D,) its flight, of F
    kind: IntArray  # (D,) its type, of T
    interval_s: float  # Time between rows, s


@dataclass(frozen=True)
class ResidualReport:
    """The identified parameters of the residual force."""

    types: tuple[str, ...]  # The types, in the order of the lists below
    residual: dict[str, list[float]]
    """The parameters by the names of `Hall`, for each type, or one for all."""
    intervals: dict[str, list[tuple[float, float]]]  # Their 95 % intervals
    white_noise_g: list[float]  # Standard deviation of the labels' white noise by type, gram-force
    config: Any  # The options
    data_sha256: str  # Digest of the data
    flights: int  # Number of flights
    rows: int  # Number of rows
    cross_validated: bool  # True if every flight was predicted by a model fitted to others

    def lines(self) -> list[str]:
        """Return the report as lines of text."""
        lines = [f"{self.rows} rows of {self.flights} flights; types {', '.join(self.types)}"]
        for name, values in self.residual.items():
            pairs = zip(values, self.intervals[name], strict=True)
            shown = [f"{value:.4f} ({low:.4f} to {high:.4f})" for value, (low, high) in pairs]
            lines.append(f"{name.ljust(18)} {', '.join(shown)}")
        noise = ", ".join(f"{value:.2f} g" for value in self.white_noise_g)
        return [*lines, f"white noise of the labels: {noise}"]


def fit_residual(config: FitConfig) -> ResidualReport:
    """Identify the residual force of a model, and write `residual.json` to `config.out`.

    Raises:
        FileNotFoundError: there is no data.
        ValueError: the rows are invalid, or a vehicle type does not exist.
    """
    rows, _ = read_data(config.data, config.logs, config.progress)
    for name in rows.types:
        check_name("vehicle type", name, tuple(VEHICLES))
    rows = without_falls(dataclasses.replace(rows, validation=np.zeros(len(rows), dtype=np.bool_)))
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
        config=json_ready(config),
        data_sha256=data_sha256(config.data),
        flights=flights,
        rows=len(rows),
        cross_validated=config.force in FITTED,
    )
    for path in (config.out / REPORT, config.json):
        if path is not None:
            write_json(path, json_ready(report))
    return report


def predicted_g(rows: InteractionRows, config: FitConfig) -> FloatArray:
    """Return the modeled force (R, 3), including drag, gram-force."""
    if config.force not in FITTED:
        return modelled_force_g(rows, config.force)
    model: Any = config.force
    options = default_fit(model, config)
    fold, found = flight_folds(rows, config.folds, config.seed), np.zeros((len(rows), 3))
    for k in tqdm(range(config.folds), disable=not config.progress, unit="fit"):
        held = fold == k
        prepared = prepare(dataclasses.replace(rows, validation=held), options)
        drag = prepared.drag[rows.ego_type] * rows.velocity / GRAM_FORCE
        found[held] = (fitted_force_g(prepared.target, options) - drag)[held]
    return found


def measured_moments(rows: InteractionRows, modelled_g: FloatArray, rate_hz: float) -> _Moments:
    """Return products of residuals by flight, type, force and lag, without gaps between rows.

    `modelled_g` (R, 3) is the model's force, `rate_hz` the rate of the rows' steps.
    """
    weight = _weights_g(rows.types)[rows.ego_type]
    force = np.linalg.norm(modelled_g, axis=1) / weight
    inside = (np.abs(rows.neighbor[..., :3]) < INTERACTION_VOLUME).all(axis=-1)
    alone: BoolArray = np.asarray(~(inside & rows.has_neighbor).any(axis=1))
    flights, flight = np.unique(rows.flight, return_inverse=True)
    who = np.stack([flight, rows.vehicle, rows.ego_type])
    drones, owner = np.unique(who, axis=1, return_inverse=True)
    owner = owner.reshape(-1)
    left = (rows.force_g - modelled_g) / weight[:, None]
    offset, known = _means(left, owner, force < CALM)
    left = left - offset[owner]
    table = np.zeros((3, len(flights), len(rows.types), len(EDGES), LAGS))
    sideways = np.zeros((len(flights), 2))
    every = int(np.median(np.diff(np.unique(rows.step))))
    for lag in range(LAGS):
        first, second = _pairs(owner, rows.step, lag * every)
        same = alone[first] == alone[second]
        first, second = first[same], second[same]
        product, both = left[first] * left[second], 0.5 * (force[first] + force[second])
        place = np.where(alone[first], 0, np.digitize(both, EDGES))
        where: Any = (flight[first], rows.ego_type[first], place, lag)
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
    return _Moments(product, both, number, sideways, vertical, home, kind, every / rate_hz)


def _weights_g(types: Sequence[str]) -> FloatArray:
    return np.array([VEHICLES[name].mass * GRAVITY / GRAM_FORCE for name in types])


def _means(values: FloatArray, owner: IntArray, use: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return means (D, 3) over the used rows of each owner, and True (D,) for owners with any."""
    count = np.bincount(owner, use)
    sums = [np.bincount(owner, values[:, k] * use) for k in range(3)]
    return np.stack(sums, axis=1) / np.maximum(count, 1.0)[:, None], np.asarray(count > 0)


def _pairs(owner: IntArray, step: IntArray, lag: int) -> tuple[IntArray, IntArray]:
    """Return the pairs of rows of one drone in one flight that are `lag` steps apart."""
    code = owner.astype(np.int64) * 10**9 + step
    order = np.argsort(code, kind="stable")
    place = np.searchsorted(code[order], code + lag)
    there = place < len(code)
    there[there] = code[order[place[there]]] == code[there] + lag
    return np.flatnonzero(there), order[place[there]]


def size(force: FloatArray, quiet: FloatArray, wake: FloatArray, half: FloatArray) -> FloatArray:
    """Return the standard deviation of the residual at forces |f|, all over the weight."""
    return np.asarray(quiet + (wake - quiet) * force / (force + half))


def identified(moments: _Moments, times: FloatArray) -> tuple[dict[str, list[float]], FloatArray]:
    """Return parameters of `Hall`, and the standard deviations (T,) of white label noise over W.

    Each flight counts `times` (F,) times.
    """
    product, force, number = (np.tensordot(times, table, 1) for table in moments[:3])
    sizes, time_s, white = _autocovariance(product, force, number, moments.interval_s)
    vertical, horizontal = times @ moments.sideways
    share, offsets = times[moments.flight], []
    for kind in range(len(product)):
        own = share * (moments.kind == kind)
        offsets.append(float(np.sqrt(own @ moments.offset**2 / max(own.sum(), 1.0))))
    names = ("residual_quiet", "residual_wake", "residual_half", "residual_alone")
    found = dict(zip(names, sizes, strict=True))
    return {
        **{name: values.tolist() for name, values in found.items()},
        "offset": offsets,
        "residual_time_s": [time_s],
        "residual_sideways": [float(np.sqrt(max(horizontal, 0.0) / max(vertical, 1e-12)))],
    }, white


def _autocovariance(
    product: FloatArray, force: FloatArray, number: FloatArray, interval_s: float
) -> tuple[FloatArray, float, FloatArray]:
    """Fit tables (T, B, L): sizes (4, T), a correlation time, and (T,) roots of the nuggets."""
    types, some = len(product), np.maximum(number, 1.0)
    (alone, covariance), (alone_pairs, pairs) = (
        (table[:, 0], table[:, 1:]) for table in (product / some, number)
    )
    place = (force / some)[:, 1:]
    importance = np.sqrt(pairs[..., 1:]) / np.maximum(covariance[..., 1:2], 1e-8)
    lag_s = interval_s * np.arange(LAGS)

    def expected(numbers: FloatArray) -> FloatArray:
        sizes = numbers[:-1].reshape(3, types, 1, 1)
        return size(place, *sizes) ** 2 * np.exp(-lag_s / numbers[-1])

    def error(numbers: FloatArray) -> FloatArray:
        return np.ravel(importance * (expected(numbers) - covariance)[..., 1:])

    start, low, high = (np.repeat(ends, [types] * 3 + [1]) for ends in (_START, _LOWEST, _HIGHEST))
    numbers = least_squares(error, start, bounds=(low, high), x_scale=start).x
    jump = (pairs * (covariance - expected(numbers)))[..., 0].sum(axis=1)
    white = np.sqrt(np.maximum(jump / np.maximum(pairs[..., 0].sum(axis=1), 1.0), 0.0))
    kept = np.exp(-lag_s / numbers[-1])[1:]
    share = alone_pairs[:, 1:] * kept**2
    variance = (alone_pairs * alone)[:, 1:] @ kept / np.maximum(share.sum(axis=1), 1e-12)
    sizes = [*numbers[:-1].reshape(3, types), np.sqrt(np.maximum(variance, 0.0))]
    return np.array(sizes), float(numbers[-1]), np.asarray(white)
