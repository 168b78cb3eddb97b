"""Table I: both quadrotors identified again, on simulated vehicles and a simulated load cell.

Mass, largest thrust and motor rate come from what `BatchPhysics` does; psi1 from noisy readings of
force at drawn signals and voltages, as the authors took theirs (Sec. VII-A). psi2 is then fitted to
the same readings, and held against the printed psi2: both were identified from one set of
measurements, so that each checks the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import format_columns
from swarm_envs.motors import pwm_for_force, rotor_force_g
from swarm_envs.physics import TIME_STEP as DT
from swarm_envs.physics import BatchPhysics
from swarm_envs.state import FloatArray, hover_state
from swarm_envs.training.reproduce.claims import Claim, Extent, Reason, about
from swarm_envs.training.reproduce.study import Report, Study
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, LARGE, SMALL, Vehicle
from swarm_envs.viewing.style import GREY, picture

_READINGS = 2000  # of the load cell, for each vehicle
_NOISE_G = 0.1  # standard deviation of a reading, grams of one rotor: a cell of 100 g full scale
_SIGNALS = (0.3, 0.95)  # motor signals p between which readings are drawn: those of flight
_VOLTAGES = (3.4 / 4.2, 4.0 / 4.2)  # voltages v, over 4.2 V, between which they are drawn
_TERMS = ("1", "p", "v", "p²", "pv")


class _Printed(NamedTuple):
    """A column of Table I."""

    name: str  # of the vehicle
    mass_g: float  # its weight as the table calls it, g
    largest_thrust_g: float  # four rotors together, g
    motor_rate: float  # lambda, 1/s
    psi1: tuple[float, ...]  # factors of 1, p, v, p^2, p v


PAPER: Mapping[str, _Printed] = {
    "S": _Printed("small", 34.0, 65.0, 16.0, (11.09, -39.08, -9.53, 20.57, 38.43)),
    "L": _Printed("large", 67.0, 145.0, 16.0, (44.10, -122.51, -36.18, 53.11, 107.68)),
}
"""Table I as printed, but for psi1 of the large one, printed as 44.1.0."""


def mass_and_thrust(vehicle: Vehicle) -> tuple[float, float]:
    """Mass and largest thrust, g, from the accelerations under two thrusts.

    Newton's law for a level drone gives two equations, m (a + g) = T, where T is the hover thrust
    plus a known force in the one, and the unknown largest thrust in the other.
    """
    physics = BatchPhysics((vehicle,), interactions="none")
    steps = round(1.0 / DT)  # sixteen time constants: thrust has settled

    def accelerated(command: float) -> float:
        physics.reset(hover_state(physics.team, [[0.0, 0.0, 50.0]]))
        commands = np.full((1, 1, 4), command)
        for _ in range(steps):
            before = physics.step(commands).velocity[0, 0, 2]
        return float((physics.step(commands).velocity[0, 0, 2] - before) / DT)

    known = 0.9 * vehicle.max_rotor_thrust
    mass = 4.0 * known / (accelerated(known) + GRAVITY)
    largest = mass * (accelerated(10.0 * vehicle.max_rotor_thrust) + GRAVITY)
    return 1e3 * mass, largest / GRAM_FORCE


def motor_rate(vehicle: Vehicle) -> float:
    """Rate of the first-order lag, 1/s: least squares on the thrust's way after a square step."""
    physics = BatchPhysics((vehicle,), interactions="none")
    physics.reset(hover_state(physics.team, [[0.0, 0.0, 50.0]]))
    low, high = vehicle.hover_rotor_thrust, 0.9 * vehicle.max_rotor_thrust
    commands = np.full((1, 1, 4), high)
    rest = [
        float((high - physics.step(commands).rotor_thrust[0, 0, 0]) / (high - low))
        for _ in range(30)
    ]
    time = DT * np.arange(1, 31)
    return float(-np.polyfit(time, np.log(rest), 1)[0])


def _load_cell(vehicle: Vehicle, rng: np.random.Generator) -> tuple[FloatArray, ...]:
    """Signals (K,), voltages (K,) and noisy forces of one rotor (K,), g."""
    signal = rng.uniform(*_SIGNALS, _READINGS)
    voltage = rng.uniform(*_VOLTAGES, _READINGS)
    force = rotor_force_g(vehicle, signal, voltage) + rng.normal(0.0, _NOISE_G, _READINGS)
    return signal, voltage, force


def fit_polynomial(
    target: FloatArray, x: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients of 1, x, v, x^2, x v, and their standard errors."""
    terms = np.column_stack([np.ones_like(x), x, v, x * x, x * v])
    found, *_ = np.linalg.lstsq(terms, target, rcond=None)
    left = target - terms @ found
    variance = left @ left / (len(x) - terms.shape[1])
    spread = np.sqrt(variance * np.diag(np.linalg.inv(terms.T @ terms)))
    return np.asarray(found, dtype=np.float64), np.asarray(spread, dtype=np.float64)


def _identify(vehicle: Vehicle, seed: int) -> list[dict[str, Any]]:
    """Every entry of Table I that can be measured, with the printed one."""
    printed, (mass, thrust) = PAPER[vehicle.token], mass_and_thrust(vehicle)
    signal, voltage, force = _load_cell(vehicle, np.random.default_rng(seed))
    found, error = fit_polynomial(force, signal, voltage)
    entries: list[tuple[Any, ...]] = [  # quantity, paper, ours, standard error, tolerance
        ("mass, g", printed.mass_g, mass, 0.0, 0.01),
        ("largest thrust, g", printed.largest_thrust_g, thrust, 0.0, 0.01),
        ("motor rate, 1/s", printed.motor_rate, motor_rate(vehicle), 0.0, 0.01),
    ]
    for term, paper, value, spread in zip(_TERMS, printed.psi1, found, error, strict=True):
        entries.append((f"psi1, factor of {term}", paper, value, spread, 0.05))
    hover = 1e3 * vehicle.mass / 4.0
    back, _ = fit_polynomial(signal, force, voltage)
    for volts in (3.5, 3.9):
        v = volts / 4.2
        paper = round(float(pwm_for_force(vehicle, hover, v)), 4)
        ours = float(back @ [1.0, hover, v, hover * hover, hover * v])
        what = f"psi2, motor signal of hover at {volts:g} V"
        entries.append((what, paper, ours, 0.0, 0.03, _ROUNDED, 0.08))
    return [
        {
            "vehicle": printed.name,
            "quantity": quantity,
            "paper": paper,
            "ours": round(float(ours), 4),
            "error": round(float(spread), 4),
            "tolerance": tolerance,
            "reason": known[0] if known else "",
            "explained_to": known[1] if known else 0.0,
        }
        for quantity, paper, ours, spread, tolerance, *known in entries
    ]


_ROUNDED = (
    "psi2 is printed with two digits, and was fitted by itself: it is not the inverse of psi1"
)


def _report(options: Any, cells: Mapping[str, Any]) -> Report:
    rows = [row for vehicle in (SMALL, LARGE) for row in _identify(vehicle, options.seed)]
    summary = {"seed": options.seed, "readings": _READINGS, "noise_g": _NOISE_G, "rows": rows}
    columns = ("vehicle", "quantity", "paper", "ours", "error")
    table = [{name: row[name] for name in columns} for row in rows]
    lines = [("quantity", "paper", "result", "±")]
    for row in rows:
        error = f"{row['error']:.3f}" if row["error"] else ""
        values = (f"{row['paper']:.4g}", f"{row['ours']:.4g}", error)
        lines.append((f"{row['vehicle']}: {row['quantity']}", *values))
    draw = partial(_plot, seed=options.seed)
    return Report(summary, "\n".join(format_columns(lines)), table, {"table_1.png": draw})


def _plot(path: Path, seed: int) -> None:
    """Draw the readings, the curves fitted to them, and the printed psi1, at two voltages."""
    signal = np.linspace(*_SIGNALS, 60)
    with picture(path, 9.0, 4.0, "Table I: force of one rotor by motor signal") as figure:
        axes = figure.subplots(1, 2)
        for axis, vehicle in zip(axes, (SMALL, LARGE), strict=True):
            p, v, force = _load_cell(vehicle, np.random.default_rng(seed))
            found, _ = fit_polynomial(force, p, v)
            axis.plot(p, force, ".", color="#C9CED4", markersize=2, label="readings")
            for volts, color in ((3.5, "#0072B2"), (3.9, "#D55E00")):
                level = np.full_like(signal, volts / 4.2)
                terms = (np.ones_like(signal), signal, level, signal**2, signal * level)
                axis.plot(signal, found @ np.array(terms), color=color, label=f"{volts:g} V")
                a, b, c, d, e = PAPER[vehicle.token].psi1
                paper = a + b * signal + c * level + d * signal**2 + e * signal * level
                axis.plot(signal, paper, "--", color=GREY, linewidth=1)
            kind = PAPER[vehicle.token].name
            axis.set(title=kind, xlabel="Motor signal p", ylabel="Force of one rotor (g)")
            axis.grid(True)
            axis.legend(fontsize=8, title="dashed: as printed")


def _claims(numbers: Any, extent: Extent) -> list[Claim]:
    """What was identified, with the tolerance that each entry states."""
    return [
        Claim(
            f"{entry['vehicle']}: {entry['quantity']}",
            f"{entry['paper']:g}",
            entry["ours"],
            about(entry["paper"], entry["tolerance"]),
            (Reason(entry["reason"], about(entry["paper"], entry["explained_to"])),)
            if entry["reason"]
            else (),
            spread=(entry["ours"] - entry["error"], entry["ours"] + entry["error"])
            if entry["error"]
            else None,
            spread_is="standard error",
        )
        for entry in numbers["rows"]
    ]


TABLE_1 = Study(
    paper="neural-swarm2",
    name="table-1",
    label="Table I",
    shows="mass, largest thrust, motor rate and thrust curves of both quadrotors",
    takes=(),
    report=_report,
    claims=_claims,
    note="Identified again from motion and a noisy load cell, as if nothing were known. The "
    "simulator is made of this table: agreement says that it flies what the table says; psi2, "
    "fitted to readings of psi1, is held against the printed psi2.",
)
"""Both vehicles, each entry of the table."""
