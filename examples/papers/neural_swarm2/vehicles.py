"""Table I: identification of both quadrotors, on simulated vehicles and a simulated load cell.

Mass, largest thrust and motor rate come from the motion of `BatchPhysics`; psi1 comes from noisy
readings of the force at random signals and voltages, as the authors measured theirs (Sec. VII-A).
psi2 is then fitted to the same readings and compared with the printed psi2: the authors identified
both from one set of measurements.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from examples.papers.common import Row, within, write_compared
from swarm_envs.motors import pwm_for_force, rotor_force_g
from swarm_envs.physics import TIME_STEP, BatchPhysics
from swarm_envs.state import FloatArray, hover_state
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, LARGE, SMALL, Vehicle
from swarm_envs.viewing.style import GREY, picture

READINGS = 2000  # of the load cell, for each vehicle
NOISE_G = 0.1  # standard deviation of a reading, grams of one rotor: a cell of 100 g full scale
SIGNALS = (0.3, 0.95)  # range of the motor signal p: that of flight
VOLTAGES = (3.4 / 4.2, 4.0 / 4.2)  # range of the voltage v, over 4.2 V
TERMS = ("1", "p", "v", "p²", "pv")
ROUNDED = "psi2 is printed with two digits, and was fitted by itself: it is not the inverse of psi1"


class Printed(NamedTuple):
    """A column of Table I."""

    name: str
    mass_g: float  # the table calls it weight
    largest_thrust_g: float  # four rotors together
    motor_rate: float  # lambda, 1/s
    psi1: tuple[float, ...]  # factors of 1, p, v, p^2 and pv


PAPER: Mapping[str, Printed] = {
    "S": Printed("small", 34.0, 65.0, 16.0, (11.09, -39.08, -9.53, 20.57, 38.43)),
    "L": Printed("large", 67.0, 145.0, 16.0, (44.10, -122.51, -36.18, 53.11, 107.68)),
}
"""Table I as printed, except for the first factor of the large vehicle, printed as 44.1.0."""


def table_1(out: Path = Path("neural_swarm2"), seed: int = 0) -> None:
    """Identify mass, largest thrust, motor rate and thrust curves of both quadrotors (Table I).

    Writes `table_1.json` (`rows`: every entry of the table with ours and its standard error) and
    `table_1.png` (readings and curves). The simulator is made of this table: all but
    psi2, which the paper fitted by itself, agrees because it was put in.

    Args:
        out: folder, made if missing.
        seed: of the load cell's readings.
    """
    rows = [row for vehicle in tqdm((SMALL, LARGE), "Table I") for row in identify(vehicle, seed)]
    numbers = {"seed": seed, "readings": READINGS, "noise_g": NOISE_G, "rows": rows}
    write_compared(out / "table_1.json", numbers, [compared(row) for row in rows])
    plot_readings(out / "table_1.png", seed)


def compared(row: Mapping[str, Any]) -> Row:
    """Return an entry beside the paper's, with the tolerance that it states."""
    error = row["error"]
    return Row(
        f"{row['vehicle']}: {row['quantity']}",
        f"{row['paper']:g}",
        row["ours"],
        within(row["paper"], row["tolerance"]),
        row["reason"],
        within(row["paper"], row["explained_to"]),
        (row["ours"] - error, row["ours"] + error) if error else None,
        "standard error",
        given=not row["quantity"].startswith("psi2"),
    )


def identify(vehicle: Vehicle, seed: int) -> list[dict[str, Any]]:
    """Return every entry of Table I that can be measured, with the printed one."""
    printed, (mass, thrust) = PAPER[vehicle.token], mass_and_thrust(vehicle)
    signal, voltage, force = load_cell(vehicle, np.random.default_rng(seed))
    found, error = fit_polynomial(force, signal, voltage)
    entries: list[tuple[Any, ...]] = [
        # quantity, the paper's value, ours, standard error, tolerance
        ("mass, g", printed.mass_g, mass, 0.0, 0.01),
        ("largest thrust, g", printed.largest_thrust_g, thrust, 0.0, 0.01),
        ("motor rate, 1/s", printed.motor_rate, motor_rate(vehicle), 0.0, 0.01),
    ]
    for term, paper, value, spread in zip(TERMS, printed.psi1, found, error, strict=True):
        entries.append((f"psi1, factor of {term}", paper, value, spread, 0.05))
    for volts, paper, ours in hover_signals(vehicle, signal, voltage, force):
        what = f"psi2, motor signal of hover at {volts:g} V"
        entries.append((what, paper, ours, 0.0, 0.03, ROUNDED, 0.08))
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


def hover_signals(
    vehicle: Vehicle, signal: FloatArray, voltage: FloatArray, force: FloatArray
) -> Iterator[tuple[float, float, float]]:
    """Yield a voltage, V, and the motor signal of hover there: by the printed psi2, and by ours."""
    hover = 1e3 * vehicle.mass / 4.0
    psi2, _ = fit_polynomial(signal, force, voltage)
    for volts in (3.5, 3.9):
        v = volts / 4.2
        printed = round(float(pwm_for_force(vehicle, hover, v)), 4)
        yield volts, printed, float(psi2 @ [1.0, hover, v, hover * hover, hover * v])


def mass_and_thrust(vehicle: Vehicle) -> tuple[float, float]:
    """Return mass and largest thrust, g, from the accelerations under two thrusts.

    Newton's law for a level drone gives two equations, m (a + g) = T: in one, T is a known force;
    in the other, it is the unknown largest thrust.
    """
    physics = BatchPhysics((vehicle,), interactions="none")
    steps = round(1.0 / TIME_STEP)  # sixteen time constants: the thrust has settled

    def acceleration(command: float) -> float:
        physics.reset(hover_state(physics.team, [[0.0, 0.0, 50.0]]))
        commands = np.full((1, 1, 4), command)
        for _ in range(steps):
            before = physics.step(commands).velocity[0, 0, 2]
        return float((physics.step(commands).velocity[0, 0, 2] - before) / TIME_STEP)

    known = 0.9 * vehicle.max_rotor_thrust
    mass = 4.0 * known / (acceleration(known) + GRAVITY)
    largest = mass * (acceleration(10.0 * vehicle.max_rotor_thrust) + GRAVITY)
    return 1e3 * mass, largest / GRAM_FORCE


def motor_rate(vehicle: Vehicle) -> float:
    """Return the rate of the motors' lag, 1/s: least squares on the thrust after a step."""
    physics = BatchPhysics((vehicle,), interactions="none")
    physics.reset(hover_state(physics.team, [[0.0, 0.0, 50.0]]))
    low, high = vehicle.hover_rotor_thrust, 0.9 * vehicle.max_rotor_thrust
    commands = np.full((1, 1, 4), high)
    rest = [
        float((high - physics.step(commands).rotor_thrust[0, 0, 0]) / (high - low))
        for _ in range(30)
    ]
    time = TIME_STEP * np.arange(1, 31)
    return float(-np.polyfit(time, np.log(rest), 1)[0])


def load_cell(vehicle: Vehicle, rng: np.random.Generator) -> tuple[FloatArray, ...]:
    """Return signals (K,), voltages (K,) and noisy forces of one rotor (K,), g."""
    signal = rng.uniform(*SIGNALS, READINGS)
    voltage = rng.uniform(*VOLTAGES, READINGS)
    force = rotor_force_g(vehicle, signal, voltage) + rng.normal(0.0, NOISE_G, READINGS)
    return signal, voltage, force


def fit_polynomial(
    target: FloatArray, x: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of 1, x, v, x^2 and xv, and their standard errors."""
    terms = np.column_stack([np.ones_like(x), x, v, x * x, x * v])
    found, *_ = np.linalg.lstsq(terms, target, rcond=None)
    left = target - terms @ found
    variance = left @ left / (len(x) - terms.shape[1])
    spread = np.sqrt(variance * np.diag(np.linalg.inv(terms.T @ terms)))
    return np.asarray(found, dtype=np.float64), np.asarray(spread, dtype=np.float64)


def plot_readings(path: Path, seed: int) -> None:
    """Draw the readings, the curves fitted to them, and the printed psi1, at two voltages."""
    signal = np.linspace(*SIGNALS, 60)
    with picture(path, 9.0, 4.0, "Table I: force of one rotor by motor signal") as figure:
        axes = figure.subplots(1, 2)
        for axis, vehicle in zip(axes, (SMALL, LARGE), strict=True):
            printed = PAPER[vehicle.token]
            p, v, force = load_cell(vehicle, np.random.default_rng(seed))
            found, _ = fit_polynomial(force, p, v)
            axis.plot(p, force, ".", color="#C9CED4", markersize=2, label="readings")
            for volts, color in ((3.5, "#0072B2"), (3.9, "#D55E00")):
                level = np.full_like(signal, volts / 4.2)
                terms = np.array([np.ones_like(signal), signal, level, signal**2, signal * level])
                axis.plot(signal, found @ terms, color=color, label=f"{volts:g} V")
                axis.plot(signal, np.array(printed.psi1) @ terms, "--", color=GREY, linewidth=1)
            axis.set(title=printed.name, xlabel="Motor signal p", ylabel="Force of one rotor (g)")
            axis.grid(True)
            axis.legend(fontsize=8, title="dashed: as printed")
