"""Simulations with wrong, late or noisy force predictions, or with noisy sensors.

The tracking loop of the environment has the exact state and evaluates its force model without
delay. Here `TrackingController`, which is equal to it, commands the rotors at 240 Hz from outside
of the environment, so that its measurements and predictions can be degraded.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from swarm_envs.baselines.neural_swarm.flights import FlightTest
from swarm_envs.control.config import ControllerConfig
from swarm_envs.control.tracking import TrackingController
from swarm_envs.envs.core import SwarmCore
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.physics.rigid_body import PHYSICS_RATE
from swarm_envs.state import BoolArray, FloatArray, Setpoint, SwarmState
from swarm_envs.tasks.motion import reference_of
from swarm_envs.vehicles import GRAM_FORCE

NOISE_HZ = 5.0
"""Noise of the predicted force lies below this frequency, Hz, as errors of a model in flight do."""


@dataclass(frozen=True)
class Imperfection:
    """Errors of a controller's prediction and sensors; by default none."""

    scale: float = 1.0
    """Factor of the predicted force."""
    noise_g: float = 0.0
    """Root mean square of noise below 5 Hz on its vertical part, gram-force, each drone's own."""
    delay_s: float = 0.0
    """Delay of the predicted force, s; rounded to steps of 1/240 s."""
    position_noise_m: float = 0.0
    """Standard deviation of measured positions, each component, white from step to step, m."""
    velocity_noise: float = 0.0
    """Standard deviation of measured velocities, the same, m/s."""


NOTHING = Imperfection()


class Worst(NamedTuple):
    """Results of E flights."""

    height_error: FloatArray  # (E, N) largest vertical distance to the reference, m
    crashed: BoolArray  # (E,) ended by a collision or a tumble


def fly_imperfectly(
    test: FlightTest,
    controller: ControllerConfig,
    seeds: Sequence[int],
    imperfection: Imperfection = NOTHING,
) -> Worst:
    """Fly one episode for each seed; seeds draw swaps as `run_flights` does, and the noise."""
    core = test.core(len(seeds), action="rotors", decision_rate=PHYSICS_RATE)
    try:
        core.reset(list(seeds))
        loop = TrackingController(test.task.team, len(seeds), replace(controller, feedforward=None))
        most = core.world.drones["nominal_max_rotor_thrust"][..., None]
        straight = np.zeros((core.num_envs, core.num_drones))
        rng = np.random.default_rng(list(seeds))
        model = None if controller.feedforward is None else load(controller.feedforward)
        predict = _prediction(core, model, imperfection, rng)
        while core.running.any():
            state = _measure(core.physics.state, imperfection, rng)
            setpoint = Setpoint(*reference_of(core.world.drones), straight, straight)
            commands = loop.commands(state, setpoint, predict(state))
            core.step(2.0 * commands / most - 1.0)
        drones = core.world.drones
        crashed = np.asarray((drones["crashed"] > 0.0).any(axis=1))
        return Worst(drones["worst_height_error"].copy(), crashed)
    finally:
        core.close()


def _measure(state: SwarmState, imperfection: Imperfection, rng: np.random.Generator) -> SwarmState:
    """Return the state with the noise of its sensors."""
    noise = imperfection.position_noise_m, imperfection.velocity_noise
    if noise == (0.0, 0.0):
        return state
    shape = state.position.shape
    return state._replace(
        position=state.position + noise[0] * rng.standard_normal(shape),
        velocity=state.velocity + noise[1] * rng.standard_normal(shape),
    )


def _prediction(
    core: SwarmCore,
    model: InteractionModel | None,
    imperfection: Imperfection,
    rng: np.random.Generator,
) -> Callable[[SwarmState], FloatArray | None]:
    """Return a function that gives, step by step, the force (E, N, 3) that is fed forward, N."""
    shape = (core.num_envs, core.num_drones)
    steps = round(float(core.settings["horizon_s"][0]) * PHYSICS_RATE) + 1
    size = imperfection.noise_g * GRAM_FORCE
    noise = size * slow_noise(rng, (*shape, steps)) if size > 0.0 else None
    delay = round(imperfection.delay_s * PHYSICS_RATE)
    late, step = deque([np.zeros((*shape, 3))] * delay), itertools.count()

    def force(state: SwarmState) -> FloatArray | None:
        if model is None:
            return None
        found = imperfection.scale * model.forces(state.position, state.velocity, core.task.team)
        if noise is not None:
            found[..., 2] += noise[..., next(step)]
        late.append(found)
        return late.popleft()

    return force


def slow_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Draw Gaussian noise (..., T) below 5 Hz, sampled at 240 Hz along the last axis, of rms 1."""
    steps = shape[-1]
    frequency = np.fft.rfftfreq(steps, 1.0 / PHYSICS_RATE)
    spectrum = np.fft.rfft(rng.standard_normal(shape))
    spectrum[..., (frequency > NOISE_HZ) | (frequency == 0.0)] = 0.0
    noise = np.fft.irfft(spectrum, steps)
    size: FloatArray = np.sqrt((noise**2).mean(axis=-1, keepdims=True))
    return noise / size
