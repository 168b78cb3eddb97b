"""The small vehicle compared with public logs of single Crazyflies.

- NanoBench (github.com/syediu/nanobench-iros2026, BSD-3): a Crazyflie 2.1, CSV files at 100 Hz.
- arplaboratory/data-driven-system-identification (MIT): a Crazyflie of 27 g, three logs at 1 kHz.

They are read from clones and not part of this project. Thrust is the acceleration along the body
axis times the mass. NanoBench states no mass, and the other logs no voltage, so psi1 gives the mass
of the first and the voltage of the second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from examples.papers.common import Array, Row, markdown, write_compared
from swarm_envs.agents.evaluation import bootstrap_interval
from swarm_envs.motors import rotor_force_g
from swarm_envs.vehicles import GRAVITY, SMALL

RATES = np.arange(4.0, 41.0, 0.5)  # motor lags that are tried, 1/s
VOLTAGES = np.arange(0.7, 1.0, 0.005)  # over 4.2 V, of logs without
ARPLAB_MASS_G = 27.0
FAST_M_S = 0.2  # less motion than this says nothing of the drag
DRAG_KG_S = 0.01458  # to the side, of a small drone in `learned`, from the swarm flights
QUANTITIES = ("motor_rate", "mass_g", "residual_g", "drag_x", "drag_y")


def real_flights(
    nanobench: Path | None = None, arplab: Path | None = None, out: Path = Path("neural_swarm2")
) -> None:
    """Hold motor lag, thrust curve and drag of `SMALL` against public logs.

    Writes `real_flights.json` (`flights`: the numbers of each; `means` with 95 % intervals).

    Args:
        nanobench: clone of NanoBench.
        arplab: clone of arplaboratory/data-driven-system-identification.
        out: folder, made if missing.
    """
    if nanobench is None and arplab is None:
        raise ValueError("no logs were named; give --nanobench or --arplab, a clone each")
    paths = sorted((nanobench / "datasets" / "dataset").glob("*.csv")) if nanobench else []
    once = {sha256(path.read_bytes()).digest(): path for path in reversed(paths)}  # some are twice
    found = [examine_csv(path) for path in tqdm(list(once.values())[::-1], "NanoBench")]
    logs = sorted((arplab / "logs_crazyflie").glob("log*")) if arplab else []
    found += [examine_log(path) for path in tqdm(logs, "arplaboratory")]
    flights = [flight for flight in found if flight is not None]
    means = {key: mean(key, flights) for key in QUANTITIES if any(key in f for f in flights)}
    print(markdown([{k: f.get(k) for k in ("name", *QUANTITIES)} for f in flights],
                   ("name", *QUANTITIES)))  # fmt: skip
    numbers = {"flights": flights, "means": means}
    write_compared(out / "real_flights.json", numbers, compare(means))


def examine_csv(path: Path) -> dict[str, Any] | None:
    """Return the numbers of a flight of NanoBench, None where it is less than 5 s in the air."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        log = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
    flying = np.flatnonzero(log["pz"] > 0.3)[100:-100]  # without take-off and landing
    if len(flying) < 500 or log["motor_motor_m1"][flying].min() < 1e4:
        return None  # hardly flown, or carried
    signals = np.stack([log[f"motor_motor_m{k}"] for k in (1, 2, 3, 4)], axis=1) / 65536.0
    thrust = rotor_force_g(SMALL, signals, log["pwr_pm_vbat"][:, None] / 4.2).sum(axis=1)
    felt = np.stack([log[f"imu_acc_{axis}"] for axis in "xyz"], axis=1)[flying]
    rate, mass, residual = fit_lag(thrust, felt[:, 2], flying, 0.01)
    turn = Rotation.from_quat(np.stack([log[f"q{c}"] for c in "xyzw"], axis=1)[flying])
    moving = turn.inv().apply(np.stack([log[f"v{c}"] for c in "xyz"], axis=1)[flying])
    found = {"name": path.stem, "mass_g": mass, "residual_g": mass * residual}
    if RATES[0] < rate < RATES[-1]:  # else the flight says nothing of the lag
        found["motor_rate"] = rate
    for k, axis in enumerate("xy"):
        speed = moving[:, k]
        if speed.std() > FAST_M_S:
            found[f"drag_{axis}"] = float(-GRAVITY * (speed @ felt[:, k]) / (speed @ speed))
    return found


def fit_lag(thrust: Array, felt: Array, used: Any, dt: float) -> tuple[float, float, float]:
    """Return the motor rate, 1/s, and mass, g, that explain what is felt, g, and what is left."""
    tried = []
    for rate in RATES:
        late = lagged(thrust, rate, dt)[used]
        share = float(late @ felt / (late @ late))
        tried.append((float(np.std(felt - share * late)), float(rate), 1.0 / share))
    left, rate, mass = min(tried)
    return rate, mass, left


def lagged(values: Array, rate: float, dt: float) -> Array:
    """Return values (K, ...) behind a first-order lag, 1/s; each is held until the next."""
    keep = np.exp(-rate * dt)
    held = np.concatenate([values[:1], values[:-1]])
    found, _ = lfilter([1.0 - keep], [1.0, -keep], held, axis=0, zi=keep * held[:1])
    return np.asarray(found)


def read_fixed_frequency(path: Path) -> Any:
    """Return the records of a log of the firmware's second format that has one event."""
    raw = path.read_bytes()
    start = raw.index(b"\0", 7) + 3
    count = int.from_bytes(raw[start - 2 : start], "little")
    names = raw[start:].split(b"\0", count)[:count]
    fields = [(name[:-3].decode(), f"<{chr(name[-2])}") for name in names]
    record = np.dtype([("event", "<u2"), ("time", "<u8"), *fields])
    begin = start + sum(len(name) + 1 for name in names)
    return np.frombuffer(raw, record, (len(raw) - begin) // record.itemsize, begin)


def examine_log(path: Path) -> dict[str, Any]:
    """Return the numbers of a flight of the arplaboratory; the voltage is the one that fits."""
    log = read_fixed_frequency(path)
    signals = np.stack([log[f"motor.m{k}"] for k in (1, 2, 3, 4)], axis=1) / 65536.0
    flying = np.flatnonzero(signals.mean(axis=1) > 0.3)[500:-500]
    felt, dt = log["acc.z"][flying].astype(np.float64), 1e-3

    def thrust_at(voltage: float) -> Array:
        return np.asarray(rotor_force_g(SMALL, signals, voltage)).sum(axis=1)

    def misfit(voltage: float) -> float:
        late = lagged(thrust_at(voltage), SMALL.motor_rate, dt)
        return abs(float(late[flying].mean()) - ARPLAB_MASS_G * float(felt.mean()))

    thrust = thrust_at(min(VOLTAGES, key=misfit))
    rate, mass, residual = fit_lag(thrust, felt, flying, dt)
    return {"name": path.name, "motor_rate": rate, "residual_g": mass * residual}


def mean(key: str, flights: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the median of a number over flights, with its 95 % interval."""
    values = np.array([flight[key] for flight in flights if key in flight])
    interval = bootstrap_interval(values, np.median)
    return {
        "median": float(np.median(values)),
        "interval": [round(end, 4) for end in interval],
        "flights": len(values),
    }


def compare(means: Mapping[str, Mapping[str, Any]]) -> list[Row]:
    """Return what was found beside what `SMALL` has."""
    drag = DRAG_KG_S / SMALL.mass
    ours = {"motor_rate": (SMALL.motor_rate, "1/s"), "drag_x": (drag, "1/s"),
            "drag_y": (drag, "1/s"),
}  # fmt: skip
    return [
        Row(f"{key.replace('_', ' ')}, {unit} (`SMALL`)", f"{value:.3g}", means[key]["median"],
            (0.7 * value, 1.4 * value), spread=tuple(means[key]["interval"]), spread_is="95 %")
        for key, (value, unit) in ours.items() if key in means
    ]  # fmt: skip
