"""The small vehicle and its controller compared with public logs of single Crazyflies.

- NanoBench (github.com/syediu/nanobench-iros2026, BSD-3): a Crazyflie 2.1, CSV files at 100 Hz.
- arplaboratory/data-driven-system-identification (MIT): a Crazyflie of 27 g, three logs at 1 kHz.

They are read from clones and not part of this project. Thrust is the acceleration along the body
axis times the mass. NanoBench states no mass, and the other logs no voltage, so psi1 gives the mass
of the first and the voltage of the second. Inertia is the torque of the rotors, by psi1 and the
arms of `SMALL`, over the angular acceleration, where the torque explains it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, filtfilt, lfilter
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from examples.papers.common import Array, Row, markdown, write_compared
from swarm_envs.agents.evaluation import bootstrap_interval
from swarm_envs.control.config import ControllerConfig, PositionGains
from swarm_envs.control.tracking import TrackingController
from swarm_envs.motors import rotor_force_g
from swarm_envs.physics import BatchPhysics
from swarm_envs.physics.rigid_body import TIME_STEP
from swarm_envs.state import Setpoint, hover_state
from swarm_envs.vehicles import GRAM_FORCE, GRAVITY, SMALL

RATES = np.arange(4.0, 41.0, 0.5)  # motor lags that are tried, 1/s
VOLTAGES = np.arange(0.7, 1.0, 0.005)  # over 4.2 V, of logs without
ARPLAB_MASS_G = 27.0
FAST_M_S = 0.2  # less motion than this says nothing of the drag
DRAG_KG_S = (0.01458, 0.01458, 0.00805)  # of a small drone in `learned`, from the swarm flights
UNEXPLAINED_G = 5.0  # more thrust than this is not the rotors' alone
CUTOFF_HZ = 15.0  # of the low-pass before the gyroscope is differentiated
EXPLAINED = 0.75  # correlation of torque and angular acceleration below which a log says nothing
POSITION_GAIN = 2.0  # 1/s, of the firmware's cascade, which flew NanoBench with its defaults
VELOCITY_GAIN = 25.0 * np.pi / 180.0 * GRAVITY  # 1/s; 25 degrees of tilt per m/s
FASTEST_M_S = 1.1  # limit of the velocity that the position loop asks for
CASCADE = ControllerConfig(PositionGains(position=1.0, velocity=VELOCITY_GAIN - 1.0, integral=0.17))
"""The velocity loop: without an error of position, both gains act on that of velocity (eq. 18)."""
QUANTITIES = ("motor_rate", "mass_g", "residual_g", "drag_x", "drag_y", "drag_z", "inertia_x",
              "inertia_y", "inertia_z", "error_m", "error_ratio")  # fmt: skip


def real_flights(
    nanobench: Path | None = None, arplab: Path | None = None, out: Path = Path("neural_swarm2")
) -> None:
    """Compare motor lag, thrust curve, drag, inertia and tracking of `SMALL` with public logs.

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
    """Return the numbers of a flight of NanoBench, None if it did not fly freely for 5 s."""
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
    if not 0.0 < mass * residual < UNEXPLAINED_G:
        return None  # touched the floor or fell
    turn = Rotation.from_quat(np.stack([log[f"q{c}"] for c in "xyzw"], axis=1)[flying])
    moving = turn.inv().apply(np.stack([log[f"v{c}"] for c in "xyz"], axis=1)[flying])
    found: dict[str, Any] = {"name": path.stem, "mass_g": mass, "residual_g": mass * residual}
    if RATES[0] < rate < RATES[-1]:  # else the flight says nothing of the lag
        found["motor_rate"] = rate
    for k, axis in enumerate("xy"):
        speed = moving[:, k]
        if speed.std() > FAST_M_S:
            found[f"drag_{axis}"] = float(-GRAVITY * (speed @ felt[:, k]) / (speed @ speed))
    if moving[:, 2].std() > FAST_M_S:
        terms = np.stack([lagged(thrust, rate, 0.01)[flying], moving[:, 2]], axis=1)
        found["drag_z"] = float(-GRAVITY * np.linalg.lstsq(terms, felt[:, 2])[0][1])
    if "figure8" in path.stem:
        target = np.stack([log[f"sp_ctrltarget_{axis}"] for axis in "xyz"], axis=1)[flying]
        flown = np.stack([log[f"p{axis}"] for axis in "xyz"], axis=1)[flying]
        simulated = fly_targets(target, log["t"][flying])
        found["error_m"] = rms_distance(flown - target)
        found["error_ratio"] = rms_distance(simulated) / found["error_m"]
    return found


def rms_distance(errors: Array) -> float:
    """Return the root mean square of the lengths of errors (K, 3), m."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def fly_targets(targets: Array, time: Array) -> Array:
    """Return the errors (T, 3), m, of `SMALL` that follows targets (K, 3) as the firmware does.

    Its cascade is given positions alone: the velocity set-point is the error times a gain.
    """
    steps = np.arange(time[0], time[-1], TIME_STEP)
    goals = np.stack([np.interp(steps, time, targets[:, k]) for k in range(3)], axis=1)
    physics = BatchPhysics((SMALL,), interactions="none")
    controller = TrackingController((SMALL,), 1, CASCADE)
    state, errors = physics.reset(hover_state((SMALL,), goals[None, :1])), np.empty_like(goals)
    for k, goal in enumerate(goals):
        velocity = np.clip(POSITION_GAIN * (goal - state.position), -FASTEST_M_S, FASTEST_M_S)
        setpoint = Setpoint.hold(state.position)._replace(velocity=velocity)
        state = physics.step(controller.commands(state, setpoint))
        errors[k] = state.position[0, 0] - goal
    return errors


def inertia(rotors: Array, turning: Array, used: Any, rate: float, dt: float) -> dict[str, float]:
    """Return the moments of inertia, 1e-6 kg m^2, of the axes on which a log says something.

    Args:
        rotors: force of each rotor (K, 4), g, before the lag of the motors.
        turning: angular velocity (K, 3), rad/s.
        used: indices of the samples in the air.
        rate: motor rate, 1/s.
        dt: time between samples, s.
    """
    smooth = butter(2, CUTOFF_HZ * 2.0 * dt)
    first, second, third, fourth = (GRAM_FORCE * lagged(rotors, rate, dt)).T
    arm = SMALL.arm / np.sqrt(2.0)
    torques = (arm * (third + fourth - first - second), arm * (second + third - first - fourth),
               SMALL.thrust_to_torque * (second + fourth - first - third))  # fmt: skip
    found = {}
    for axis, torque, speed in zip("xyz", torques, turning.T, strict=True):
        pushed = filtfilt(*smooth, torque)[used]
        gained = np.gradient(filtfilt(*smooth, speed), dt)[used]
        covariance = np.cov(pushed, gained)
        if covariance[0, 1] > EXPLAINED * np.sqrt(covariance[0, 0] * covariance[1, 1]):
            found[f"inertia_{axis}"] = 1e6 * float(covariance[0, 0] / covariance[0, 1])
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

    voltage = min(VOLTAGES, key=misfit)
    rate, mass, residual = fit_lag(thrust_at(voltage), felt, flying, dt)
    turning = np.radians(np.stack([log[f"gyro.{axis}"] for axis in "xyz"], axis=1))
    rotors = np.asarray(rotor_force_g(SMALL, signals, voltage))
    return {
        "name": path.name,
        "motor_rate": rate,
        "residual_g": mass * residual,
        **inertia(rotors, turning.astype(np.float64), flying, rate, dt),
    }


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
    drag = [(value / SMALL.mass, "1/s") for value in DRAG_KG_S]
    moments = [(1e6 * value, "1e-6 kg m^2") for value in SMALL.inertia]
    ours = {
        "motor_rate": (SMALL.motor_rate, "1/s"),
        **dict(zip(("drag_x", "drag_y", "drag_z"), drag, strict=True)),
        **dict(zip(("inertia_x", "inertia_y", "inertia_z"), moments, strict=True)),
        "error_ratio": (1.0, "simulated over flown"),
    }
    return [
        Row(f"{key.replace('_', ' ')}, {unit} (`SMALL`)", f"{value:.3g}", means[key]["median"],
            (0.7 * value, 1.4 * value), spread=tuple(means[key]["interval"]), spread_is="95 %")
        for key, (value, unit) in ours.items() if key in means
    ]  # fmt: skip
