"""Both engines fly what `swarm_envs.reference` says, to 1e-9, over whole flights."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest

from swarm_envs import reference
from swarm_envs.control.config import MID, STIFF, ControllerConfig
from swarm_envs.interactions import load
from swarm_envs.physics import TIME_STEP, BatchPhysics, BulletPhysics, bullet_available
from swarm_envs.physics.step import RATES, ROTORS, SETPOINTS
from swarm_envs.reference import (
    State,
    clearances,
    held,
    inverse,
    moved,
    moved_on,
    rotate,
    turned,
    turned_exactly,
    wall_gaps,
)
from swarm_envs.reference_numbers import aerodynamics_of, bodies_of, gains_of
from swarm_envs.state import FloatArray, Setpoint, hover_state
from swarm_envs.vehicles import parse_team
from tests.helpers.frozen import pairwise_model

ENGINES = (BatchPhysics, BulletPhysics) if bullet_available() else (BatchPhysics,)
SECONDS = 1.5
MODELS: dict[str, Any] = {
    "none": None,
    "wake": reference.wake,
    "learned": reference.learned,
    "deep-set": reference.deep_set,
}
LEVELS = {"setpoints": SETPOINTS, "rates": RATES, "rotors": ROTORS}
STEPS = {SETPOINTS: 5, RATES: 5, ROTORS: 1}
"""Steps of a decision: who commands rotors by hand has to do it at every one."""


class Flight(NamedTuple):
    """Two flights of a team at once, one of them low, and how they are flown."""

    model: str
    level: int
    team: str
    config: ControllerConfig
    twisted: bool = False


def flights() -> Iterator[Any]:
    """24 flights of every force and level, and of every vehicle; 6 more where air turns bodies."""
    teams = ("SLS*", "LLSS", "LS", "LS*S")
    for number, model in enumerate(MODELS):
        believed = load(model) if number % 2 else None
        for at, (name, level) in enumerate(LEVELS.items()):
            late = level == SETPOINTS and model == "none"
            config = ControllerConfig(MID if late else STIFF, believed, lag_compensation=not late)
            flight = Flight(model, level, teams[(number + at) % 4], config)
            marks = () if level == SETPOINTS or model == "learned" else (pytest.mark.slow,)
            yield pytest.param(flight, id=f"{model}, {name}", marks=marks)
        if model != "none":
            config = ControllerConfig(feedforward=load("wake"))
            flight = Flight(model, SETPOINTS, "SLS", config, True)
            marks = () if model == "learned" else (pytest.mark.slow,)
            yield pytest.param(flight, id=f"{model}, torque", marks=marks)


def starts(team: str) -> FloatArray:
    """(2, N, 3) stacks, 0.35 m between drones that are a little beside each other, m."""
    places = np.arange(len(parse_team(team)))
    beside = np.stack([0.05 * np.sin(3.0 * places), 0.05 * np.cos(5.0 * places), 0.35 * places], 1)
    return np.array([beside + np.array([0.0, 0.0, 0.3]), 1.3 * beside + np.array([0.4, -0.3, 2.0])])


def path(start: FloatArray, t: float) -> Setpoint:
    """Set-points on sines about the starts, and their derivatives, at a time, s."""
    number = np.arange(start.size).reshape(start.shape)
    size = np.array([0.1, 0.1, 0.03]) * (1.0 - np.exp(-t))  # begins at rest
    f, phase = 2.0 + 0.5 * np.sin(number), 1.7 * number
    angle = f * t + phase
    p = start + size * (np.sin(angle) - np.sin(phase))
    v, a, j = size * f * np.cos(angle), -size * f**2 * np.sin(angle), -size * f**3 * np.cos(angle)
    yaw = 0.3 * np.sin(angle[..., 0])
    return Setpoint(p, v, a, j, yaw, 0.3 * f[..., 0] * np.cos(angle[..., 0]))


class ByReference:
    """Flies by the reference; what it commands can be given to an engine."""

    def __init__(self, flight: Flight) -> None:
        self.flight, self.start, self.steps = flight, starts(flight.team), STEPS[flight.level]
        self.body = bodies_of(flight.team)
        self.forces = forces_of(flight.model, flight.team)
        believed = load(flight.config.feedforward or "none")
        self.predicted = forces_of(believed.name, flight.team)
        self.state = reference.hovering(self.start, self.body)
        self.outer = self.state  # the memory of the loop that commands, where that is outside
        self.gains = gains_of(flight.config)
        self.outer_gains = gains_of(flight.config, self.steps / 240)

    def decide(self, t: float) -> dict[str, FloatArray]:
        """Fly to the next decision; fields of drones that an engine's are set to before."""
        setpoint, level = path(self.start, t), self.flight.level
        if level == SETPOINTS:
            for _ in range(self.steps):
                believed = self.predicted(self.state.position, self.state.velocity)
                memory, asked = reference.followed(
                    self.state, setpoint, believed, self.body, self.gains
                )
                memory, command = held(memory, asked, self.body, self.gains)
                self.move(memory, command)
                setpoint = moved_on(setpoint)
            first = path(self.start, t)
            return {f"setpoint_{name}": value for name, value in first._asdict().items()}
        dt = self.steps / 240
        self.outer = State(*self.state[:5], *self.outer[5:])
        believed = self.predicted(self.state.position, self.state.velocity)
        self.outer, (thrust, w_r, w_r_rate) = reference.followed(
            self.outer, setpoint, believed, self.body, self.outer_gains, dt
        )
        if level == RATES:
            self.outer = self.outer._replace(started=np.ones_like(thrust))
            for _ in range(self.steps):
                memory, command = held(self.state, (thrust, w_r, 0.0 * w_r), self.body, self.gains)
                self.move(memory, command)
            return {"ctbr": np.concatenate([thrust[..., None], w_r], axis=-1)}
        asked = (thrust, w_r, w_r_rate)
        self.outer, command = held(self.outer, asked, self.body, self.outer_gains, dt)
        self.move(self.state, command)
        return {"commands": command}

    def move(self, memory: State, command: FloatArray) -> None:
        """One step of rotors and bodies in the air."""
        force, torque = self.forces(self.state.position, self.state.velocity), np.zeros(3)
        if self.flight.twisted:
            torque = reference.aerodynamic_torque(self.forces, self.state, self.body)
        self.force = force
        self.state = moved(memory, command, force, torque, self.body)


def forces_of(model: str, team: str) -> Any:
    if MODELS[model] is None:
        return reference.still_air
    return partial(MODELS[model], air=aerodynamics_of(model, team))


def same_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Differences of quaternions, whose sign says nothing."""
    return np.asarray(np.minimum(abs(a - b).max(-1), abs(a + b).max(-1)))


@pytest.mark.parametrize("flight", list(flights()))
def test_engines_fly_the_equations(flight: Flight) -> None:
    plain = ByReference(flight)
    options: dict[str, Any] = {"level": flight.level, "controller": flight.config}
    options["interaction_torque"] = flight.twisted
    engines = [engine(flight.team, 2, flight.model, **options) for engine in ENGINES]
    for engine in engines:
        engine.reset(hover_state(parse_team(flight.team), plain.start))
    everywhere, felt = np.ones(2, np.bool_), 0.0
    for decision in range(round(SECONDS * 240 / plain.steps)):
        given = plain.decide(decision * plain.steps / 240)
        felt = max(felt, float(abs(plain.force[..., 2]).max()))
        for engine in engines:
            for field, value in given.items():
                engine.world.drones[field] = value
            engine.fly(plain.steps, everywhere)
            assert not engine.contact.any()
            for field in ("position", "velocity", "angular_velocity", "rotor_thrust"):
                off = abs(getattr(engine.state, field) - getattr(plain.state, field)).max()
                assert off < 1e-9, (engine.name, field)
            assert same_rotation(engine.state.quaternion, plain.state.quaternion).max() < 1e-9
            assert abs(engine.force - plain.force).max() < 1e-9
    for engine in engines:
        engine.close()
    assert felt > 0.03 or flight.model == "none"


def test_contacts_are_distances() -> None:
    """The compiled engine's contacts at random places, some of which overlap."""
    team, low, high = "SLS*", np.array([-0.2, -0.2, 0.0]), np.array([0.2, 0.2, 1.0])
    physics, body = BatchPhysics(team, 200, "none", arena=[low, high]), bodies_of(team)
    rng = np.random.default_rng(0)
    position = rng.uniform([-0.2, -0.2, 0.1], [0.2, 0.2, 0.5], (200, 3, 3))
    physics.reset(hover_state(parse_team(team), position))
    physics.step(physics.state.rotor_thrust)
    found, p = physics.contacts, physics.state.position
    clearance = clearances(p, body) + 1e9 * np.eye(3)
    gaps = wall_gaps(p, body, low, high)
    np.testing.assert_allclose(found.clearance, clearance.min(axis=-1), rtol=1e-12)
    np.testing.assert_array_equal(found.drone >= 0, clearance.min(axis=-1) < 1.0)
    np.testing.assert_array_equal(found.floor, gaps[..., 2] < 0.0)
    walls = np.delete(gaps, 2, axis=-1).min(axis=-1) < 0.0
    np.testing.assert_array_equal(found.wall, walls)
    assert 0 < (found.drone >= 0).sum() < 600
    assert 0 < walls.sum() < 600


@pytest.mark.parametrize(("rate", "gained", "kept"), [(16.0, 1.12, 5e-5), (50.0, 4.4, 5e-3)])
def test_a_free_spin_keeps_its_momentum_and_energy_in_the_exact_turn_alone(
    rate: float, gained: float, kept: float
) -> None:
    """A small drone about (1, 1, 1), rad/s, for a second; the numbers of docs/limits.md."""
    inertia, start = bodies_of("S").inertia, np.full((1, 3), rate / np.sqrt(3.0))
    energies = {}
    for turn in (turned, turned_exactly):
        q, w = np.array([[0.0, 0.0, 0.0, 1.0]]), start
        for _ in range(240):
            q, w = turn(q, w, np.zeros((1, 3)), inertia, TIME_STEP)
        body_rate = rotate(inverse(q), w)
        energies[turn.__name__] = float((inertia * body_rate**2).sum() / (inertia * start**2).sum())
    momentum = rotate(q, inertia * body_rate)
    np.testing.assert_allclose(momentum, inertia * start, rtol=0, atol=1e-12 * rate * inertia.max())
    assert energies["turned"] == pytest.approx(gained, rel=0.01)
    assert energies["turned_exactly"] == pytest.approx(1.0, abs=kept)


def test_the_exact_turn_is_of_second_order_that_of_engines_of_first() -> None:
    inertia, q0, w0 = bodies_of("S").inertia, np.array([[0.0, 0.0, 0.0, 1.0]]), [[3.0, -2.0, 5.0]]

    def flown(turn: Any, steps: int) -> FloatArray:
        q, w = q0, np.array(w0)
        for _ in range(steps):
            q, w = turn(q, w, np.array([[2e-5, -1e-5, 3e-5]]), inertia, 0.5 / steps)
        return np.asarray(rotate(inverse(q), w))

    truth = flown(turned_exactly, 2_000)
    for turn, order in ((turned, 1), (turned_exactly, 2)):
        coarse, fine = (np.abs(flown(turn, n) - truth).max() for n in (80, 320))
        assert np.log(coarse / fine) / np.log(4.0) == pytest.approx(order, abs=0.15)


def test_a_sum_of_pairs_has_no_equations():
    with pytest.raises(ValueError, match=r"has no equations in swarm_envs\.reference"):
        aerodynamics_of(pairwise_model(), "LS")
