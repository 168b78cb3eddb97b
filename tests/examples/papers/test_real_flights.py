"""Public logs of Neural-Swarm2's scripts: planted flights in their formats, and planted weights."""

from __future__ import annotations

import itertools
import json
import struct

import numpy as np
import pytest
import torch

from examples.papers.neural_swarm2 import real_flights
from examples.papers.neural_swarm2.__main__ import main
from examples.papers.neural_swarm2.published_weights import FOLDERS, PublishedWeights
from swarm_envs.motors import rotor_force_g
from swarm_envs.vehicles import GRAM_FORCE, SMALL

RATE, MASS_G, DRAG = 14.0, 46.0, 0.4


def planted_thrust(signals: np.ndarray, dt: float) -> np.ndarray:
    """Thrust (K,), g, of all rotors at 3.78 V, behind a lag."""
    wanted = 4.0 * np.asarray(rotor_force_g(SMALL, signals, 0.9))
    late = wanted.copy()
    for k in range(1, len(late)):  # a signal is held until the next
        late[k] = wanted[k - 1] + np.exp(-RATE * dt) * (late[k - 1] - wanted[k - 1])
    return late


def test_what_was_planted_in_a_csv_is_found(tmp_path):
    rng, steps = np.random.default_rng(0), 1500
    signals = np.repeat(rng.uniform(0.75, 0.95, steps // 10), 10)
    speed = np.cumsum(rng.standard_normal((steps, 2)), axis=0) * 0.03
    columns = {"t": np.arange(steps) / 100.0, "pwr_pm_vbat": np.full(steps, 3.78)}
    columns |= dict.fromkeys(("pz", "qw"), np.ones(steps))
    columns |= dict.fromkeys(("vz", "qx", "qy", "qz"), np.zeros(steps))
    columns |= {f"motor_motor_m{k}": 65536.0 * signals for k in (1, 2, 3, 4)}
    columns |= {"vx": speed[:, 0], "vy": speed[:, 1]}
    columns |= {f"imu_acc_{axis}": -DRAG / 9.81 * columns[f"v{axis}"] for axis in "xy"}
    columns["imu_acc_z"] = planted_thrust(signals, 0.01) / MASS_G
    folder = tmp_path / "nanobench" / "datasets" / "dataset"
    folder.mkdir(parents=True)
    table = np.stack(list(columns.values()), axis=1)
    header = ",".join(columns)
    for name in ("B1_rep1.csv", "B1_rep2.csv"):  # the same flight twice counts once
        np.savetxt(folder / name, table, delimiter=",", header=header, comments="")
    main(["real-flights", "--nanobench", str(tmp_path / "nanobench"), "--out", str(tmp_path)])
    (flight,) = json.loads((tmp_path / "real_flights.json").read_text())["flights"]
    assert flight["motor_rate"] == pytest.approx(RATE, abs=0.5)
    assert flight["mass_g"] == pytest.approx(MASS_G, rel=0.005)
    assert [flight["drag_x"], flight["drag_y"]] == pytest.approx([DRAG, DRAG], rel=0.01)


def test_what_was_planted_in_a_log_is_found(tmp_path):
    rng, steps = np.random.default_rng(1), 6000
    signals = np.repeat(rng.uniform(0.5, 0.7, steps // 60), 60)
    pwm = [round(65536 * signal) for signal in signals]
    felt = planted_thrust(np.array(pwm) / 65536.0, 1e-3) / 27.0
    names = [*(f"{s}.{a}(f)" for s in ("acc", "gyro") for a in "xyz"),
             *(f"motor.m{k}(I)" for k in (1, 2, 3, 4))]  # fmt: skip
    head = b"\xbc" + struct.pack("<HHH", 2, 1, 0xFFFF) + b"fixedFrequency\0"
    head += struct.pack("<H", len(names)) + b"".join(n.encode() + b"\0" for n in names)
    body = b"".join(
        struct.pack("<HQ6f4I", 0xFFFF, 1000 * k, 0, 0, felt[k], 0, 0, 0, *[pwm[k]] * 4)
        for k in range(steps)
    )
    folder = tmp_path / "arplab" / "logs_crazyflie"
    folder.mkdir(parents=True)
    (folder / "log10").write_bytes(head + body + bytes(4))
    main(["real-flights", "--arplab", str(tmp_path / "arplab"), "--out", str(tmp_path)])
    (flight,) = json.loads((tmp_path / "real_flights.json").read_text())["flights"]
    assert flight["motor_rate"] == pytest.approx(RATE, abs=1.0)


def test_planted_inertia_is_found_where_the_torque_explains_the_rotation():
    rng = np.random.default_rng(2)
    rotors = np.repeat(rng.uniform(4.0, 9.0, (100, 4)), 60, axis=0)  # g
    first, second, third, fourth = (GRAM_FORCE * real_flights.lagged(rotors, RATE, 1e-3)).T
    arm, moments = SMALL.arm / np.sqrt(2.0), np.array([20.0, 25.0, 30.0])
    torques = np.stack([
        arm * (third + fourth - first - second),
        arm * (second + third - first - fourth),
        SMALL.thrust_to_torque * (second + fourth - first - third),
    ], axis=1)  # fmt: skip
    turning = np.cumsum(torques / (1e-6 * moments), axis=0) * 1e-3
    turning[:, 1] = rng.standard_normal(len(turning))  # says nothing
    used = np.arange(500, len(rotors) - 500)
    found = real_flights.inertia(rotors, turning, used, RATE, 1e-3)
    assert found == pytest.approx({"inertia_x": 20.0, "inertia_z": 30.0}, rel=0.02)


def test_a_target_at_constant_speed_is_followed_at_speed_over_gain():
    time = np.arange(0.0, 12.0, 0.01)
    targets = np.stack([0.5 * time, np.zeros_like(time), np.ones_like(time)], axis=1)
    errors = real_flights.fly_targets(targets, time)
    assert errors[-1] == pytest.approx([-0.5 / real_flights.POSITION_GAIN, 0.0, 0.0], abs=0.01)


def test_no_logs_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["real-flights", "--out", str(tmp_path)])
    assert "give --nanobench or --arplab" in capsys.readouterr().err


def test_published_weights_are_equation_10(tmp_path):
    torch.manual_seed(0)
    folder = tmp_path / FOLDERS[0]
    folder.mkdir(parents=True)
    widths = {"phi_G": (4, 25, 40, 40, 20), "rho_S": (20, 40, 40, 40, 1)}
    widths |= {"phi_S": (6, 25, 40, 40, 20), "phi_L": (6, 25, 40, 40, 20)}
    widths |= {"rho_L": widths["rho_S"]}
    nets = {}
    for name, own in widths.items():
        layers = [torch.nn.Linear(a, b) for a, b in itertools.pairwise(own)]
        state = {
            f"fc{k}.{p}": getattr(x, p) for k, x in enumerate(layers, 1) for p in ("weight", "bias")
        }
        torch.save(state, folder / f"{name}.pth")
        relus = [torch.nn.ReLU() for _ in layers[1:]]
        parts = [m for pair in zip(layers, relus) for m in pair] + layers[-1:]
        nets[name] = torch.nn.Sequential(*parts).double()
    rng = np.random.default_rng(0)
    position, velocity = rng.standard_normal((2, 5, 3, 3))
    found = PublishedWeights(tmp_path).forces(position, velocity, "SLS")
    x = torch.tensor(np.concatenate([position, velocity], axis=-1))
    code = nets["phi_G"](-x[:, 1, 2:]) + nets["phi_S"](x[:, 0] - x[:, 1])
    expected = nets["rho_L"](code + nets["phi_S"](x[:, 2] - x[:, 1]))[:, 0].detach().numpy()
    assert found[:, 1, 2] == pytest.approx(GRAM_FORCE * expected, rel=1e-5)
    assert np.all(found[..., :2] == 0.0)
    with pytest.raises(FileNotFoundError, match="clone https"):
        PublishedWeights(tmp_path / "nothing")
