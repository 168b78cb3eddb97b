"""Linear analysis of the tracking loop in hover: how much more thrust, or delay, it bears.

`python -m tests.helpers.linear_loop` prints the tables of docs/adaptation.md. One step of 1/240 s
of controller, lag and body is linearised by central differences of the compiled loop itself, with
a state that is known late; the loop is stable where all eigenvalues lie inside of the unit circle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from swarm_envs.control.config import ControllerConfig, Indi, MomentumObserver, NeuralFly
from swarm_envs.control.tracking import TrackingController
from swarm_envs.physics import BatchPhysics
from swarm_envs.state import FloatArray, Setpoint, SwarmState, hover_state
from swarm_envs.tables import Records
from swarm_envs.vehicles import GRAVITY, SMALL, Vehicle

STEP = 1.0 / 240.0  # length of a step, s
BODY = ("position", "quaternion", "velocity", "angular_velocity", "rotor_thrust")
"""State of the body and its rotors; all but the last is known to the controller, late."""
MEMORY = (
    *("velocity_integral", "rate_integral", "desired_thrust", "thrust_rate", "rate_error"),
    *("rate_error_rate", "desired_attitude", "desired_rate"),
)
"""Fields of the controller's memory."""
RESIDUAL = ("commands", "nominal_thrust", "last_thrust_axis", "last_velocity")
"""Further fields of its memory, if it adapts."""
FILTER = ("filtered_residual", "filtered_residual_rate")  # the second-order low-pass
ESTIMATE = {
    type(None): (),
    MomentumObserver: (*RESIDUAL, "filtered_residual"),
    Indi: (*RESIDUAL, *FILTER),
    NeuralFly: (*RESIDUAL, *FILTER, "adaptive_coefficients"),
}
"""Fields of the memory of an adaptation, beside the covariance, which is at rest."""
SETTLING = 480  # steps in hover after which filters and covariances are taken to rest


@dataclass(frozen=True)
class Loop:
    """A drone in hover whose rotors give another thrust than the controller thinks."""

    config: ControllerConfig  # the controller
    gain: float = 1.0  # true thrust and torque over those that the controller reckons with
    delay_s: float = 0.0  # how late the state is known, s
    vehicle: Vehicle = SMALL  # the drone

    def transition(self) -> FloatArray:
        """(n, n) Jacobian of one step at rest."""
        still = self._tools(1)
        rest = self._flown(still, SETTLING)[0]
        n, small = len(rest), 1e-6
        tools = self._tools(2 * n)
        for name in ("started", "adaptive_covariance"):
            tools[1]._loop.world.drones[name] = still[1]._loop.world.drones[name]
        moved = np.concatenate([rest + small * np.eye(n), rest - small * np.eye(n)])
        after = self._step(tools, moved)
        return np.asarray((after[:n] - after[n:]).T / (2.0 * small))

    def radius(self) -> float:
        """Largest |eigenvalue| of a step: above 1 the loop is unstable."""
        return float(np.abs(np.linalg.eigvals(self.transition())).max())

    def gain_margin(self, most: float = 10.0) -> float:
        """Largest gain that is stable, to 1 %; 0 if gain 1 is not; `most` if that still is."""
        if replace(self, gain=1.0).radius() >= 1.0:
            return 0.0
        stable, unstable = 1.0, most
        if replace(self, gain=most).radius() < 1.0:
            return most
        while unstable > 1.01 * stable:
            middle = float(np.sqrt(stable * unstable))
            if replace(self, gain=middle).radius() < 1.0:
                stable = middle
            else:
                unstable = middle
        return stable

    def peak(self, steps: int) -> FloatArray:
        """(steps,) m/s: speed after a push of 1 mm/s along (1, 1, 1), in the true loop."""
        tools = self._tools(1)
        state = self._flown(tools, SETTLING)
        state[:, 7:10] += 1e-3 / np.sqrt(3.0)
        speed = np.zeros(steps)
        for k in range(steps):
            state = self._step(tools, state)
            speed[k] = np.linalg.norm(state[0, 7:10])
        return speed

    @property
    def _memory(self) -> tuple[str, ...]:
        return (*MEMORY, *ESTIMATE[type(self.config.adaptation)])

    @property
    def _late(self) -> int:
        """The number of states before the present one that are needed."""
        return int(np.ceil(self.delay_s / STEP - 1e-9))

    def _tools(self, count: int) -> tuple[BatchPhysics, TrackingController]:
        team = (self.vehicle,)
        physics = BatchPhysics(team, count, interactions="none")
        physics.world.drones["mass"] /= self.gain
        physics.world.drones["inertia"] /= self.gain
        physics.reset(hover_state(team, np.tile([0.0, 0.0, 1.0], (count, 1, 1))))
        return physics, TrackingController(team, count, self.config)

    def _flown(self, tools: tuple[BatchPhysics, TrackingController], steps: int) -> FloatArray:
        """(E, n) the state after so many steps at rest."""
        physics, _ = tools
        body = _read(physics.world.drones, BODY)
        late = np.tile(body[:, :13], (1, self._late))
        memory = _read(tools[1]._loop.world.drones, self._memory)
        state = np.concatenate([body, late, memory], axis=1)
        for _ in range(steps):
            state = self._step(tools, state)
        return state

    def _step(
        self, tools: tuple[BatchPhysics, TrackingController], state: FloatArray
    ) -> FloatArray:
        """(E, n) the state one step later."""
        physics, controller = tools
        body, loop = physics.world.drones, controller._loop.world.drones
        history, memory = np.split(state[:, 13:], [4 + 13 * self._late], axis=1)
        _write(body, BODY, np.concatenate([state[:, :13], history[:, :4]], axis=1))
        _write(loop, self._memory, memory)
        ages = np.concatenate([state[:, :13], history[:, 4:]], axis=1)
        target = Setpoint.hold(np.tile([0.0, 0.0, 1.0], (len(state), 1, 1)))
        commands = controller.commands(self._known(physics.state, ages), target)
        # Gravity acts on the nominal mass: then the drone hovers at the nominal thrust.
        lift = (self.vehicle.mass / self.gain - self.vehicle.mass) * GRAVITY
        physics.step(commands, np.tile([0.0, 0.0, lift], (len(state), 1, 1)))
        late = ages[:, : 13 * self._late]
        return np.concatenate([_read(body, BODY), late, _read(loop, self._memory)], axis=1)

    def _known(self, state: SwarmState, ages: FloatArray) -> SwarmState:
        """Return the state that the controller knows, between the last two of (E, 13 (L + 1))."""
        rows = ages.reshape(len(ages), 1, -1, 13)
        share = self._late - self.delay_s / STEP
        row = (1.0 - share) * rows[:, :, -1] + share * rows[:, :, max(self._late - 1, 0)]
        attitude = row[..., 3:7] / np.linalg.norm(row[..., 3:7], axis=-1, keepdims=True)
        return state._replace(
            position=row[..., :3],
            quaternion=attitude,
            velocity=row[..., 7:10],
            angular_velocity=row[..., 10:13],
        )


def _read(drones: Records, names: tuple[str, ...]) -> FloatArray:
    """(E, n) these fields of the only drone of each environment."""
    fields = [np.asarray(drones[name][:, 0], np.float64) for name in names]
    return np.concatenate([field.reshape(len(drones), -1) for field in fields], axis=1)


def _write(drones: Records, names: tuple[str, ...], values: FloatArray) -> None:
    """Write what `_read` reads."""
    begin = 0
    for name in names:
        shape = drones[name][:, 0].shape
        end = begin + int(np.prod(shape[1:]))
        drones[name][:, 0] = values[:, begin:end].reshape(shape)
        begin = end


def height_margin(adaptation: MomentumObserver | Indi, delay_s: float) -> float:
    """Gain margin of the height alone, from L(s) of docs/adaptation.md.

    Half a step is added to the delay, for commands that are held over a step.
    """
    c, motor_rate = ControllerConfig(), SMALL.motor_rate
    s = 2j * np.pi * np.geomspace(1.0, 60.0, 200_001)
    kp, kv, ki = c.gains.position, c.gains.velocity, c.gains.integral
    loop = (kp + kv + ki) + (kp * (kv + ki) + kv * ki) / s + kp * kv * ki / s**2
    lead = 2.0 * np.pi * c.thrust_rate_cutoff_hz
    rotors = (1.0 + s / motor_rate * lead / (s + lead)) * motor_rate / (s + motor_rate)
    if isinstance(adaptation, Indi):
        pole = 2.0 * np.pi * adaptation.cutoff_hz
        estimator = pole**2 / (s**2 + np.sqrt(2.0) * pole * s + pole**2)
    else:
        pole = 2.0 * np.pi * adaptation.bandwidth_hz
        estimator = pole / (s + pole)
    late = np.exp(-(delay_s + 0.5 * STEP) * s)
    gain = rotors * (loop + s * estimator) * late / (s * (1.0 - estimator * rotors))
    crossed = (np.diff(np.sign(gain.imag)) != 0) & (gain.real[1:] < 0)
    return float(1.0 / np.abs(gain[1:][crossed]).max())


ROWS = (
    ("none", None),
    *((f"momentum observer, {f} Hz", MomentumObserver(f)) for f in (1.0, 3.0, 5.0, 10.0, 20.0)),
    *((f"INDI, {f} Hz", Indi(f)) for f in (2.0, 4.0, 6.0, 10.0, 20.0)),
    *((f"Neural-Fly, {q} m/s^2", NeuralFly(force_drift=q)) for q in (1.0, 2.0, 4.0)),
)
"""Adaptations of the table, with their names."""
DELAYS_S = (0.0, 0.01, 0.02)  # its delays, s


def main() -> None:
    """Print the gain margins of the small drone."""
    delays = " | ".join(f"{1000 * d:.0f} ms" for d in DELAYS_S)
    print("| adaptation |", delays, "| height alone, by L(s), 10 ms |")
    print("|" + "---|" * (2 + len(DELAYS_S)))
    for name, adaptation in ROWS:
        config = ControllerConfig(adaptation=adaptation)
        margins = [Loop(config, delay_s=d).gain_margin() for d in DELAYS_S]
        height = ""
        if isinstance(adaptation, MomentumObserver | Indi):
            height = f"{height_margin(adaptation, 0.01):.2f}"
        print(f"| {name} |", " | ".join(f"{m:.2f}" for m in margins), f"| {height} |", flush=True)


if __name__ == "__main__":
    main()
