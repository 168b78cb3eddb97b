"""Adaptive control: against plain Python, in flight, and what it bears before it is unstable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.neural_swarm.flights import FlightTest, run_flights, swap_test
from swarm_envs.control.config import (
    ControllerConfig,
    Indi,
    MomentumObserver,
    NeuralFly,
    butterworth,
)
from swarm_envs.control.tracking import TrackingController
from swarm_envs.envs.randomization import Randomization
from swarm_envs.interactions import load
from swarm_envs.physics import BatchPhysics
from swarm_envs.state import Setpoint, hover_state
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.vehicles import GRAM_FORCE, parse_team
from tests.helpers.linear_loop import Loop, height_margin

KINDS = (MomentumObserver(), Indi(), NeuralFly())
NAMES = ("momentum observer", "INDI", "Neural-Fly")
SHORT = StackedLayout(radius_m=(0.5, 0.5), duration_s=(2.0, 2.0))
each = pytest.mark.parametrize("adaptation", KINDS, ids=NAMES)


def observed(adaptation, push_g: float, seconds: float) -> float:
    """Vertical force, g, that is estimated in hover under a push."""
    team = parse_team("S")
    controller = TrackingController(team, config=ControllerConfig(adaptation=adaptation))
    physics = BatchPhysics(team, interactions="none")
    state = physics.reset(hover_state(team, [[0.0, 0.0, 1.0]]))
    target = Setpoint.hold(state.position.copy())
    push = np.array([[[0.0, 0.0, push_g * GRAM_FORCE]]])
    for _ in range(round(240 * seconds)):
        state = physics.step(controller.commands(state, target), push)
    return float(controller._loop.world.drones["adaptive_force"][0, 0, 2] / GRAM_FORCE)


@each
def test_a_push_is_estimated_and_nothing_where_there_is_none(adaptation):
    assert observed(adaptation, -5.0, 2.0) == pytest.approx(-5.0, rel=0.02)
    assert observed(adaptation, 0.0, 1.0) == pytest.approx(0.0, abs=1e-6)


def test_the_momentum_observer_has_its_bandwidth():
    """The estimate of a push that begins follows 1 - exp(-2 pi 3 Hz t)."""
    for steps in (5, 10, 40):
        share = 1.0 - np.exp(-2.0 * np.pi * 3.0 * (steps - 1) / 240.0)
        found = observed(MomentumObserver(3.0), -4.0, steps / 240.0)
        assert found == pytest.approx(-4.0 * share, rel=1e-6)


def test_the_butterworth_filter_is_down_3_db_at_its_cut_off():
    a, b, c, d = butterworth(4.0, 1 / 2400)
    transition, turn = np.array([[a, b], [c, d]]), np.exp(2j * np.pi * 4.0 / 2400)
    given = (np.eye(2) - transition)[:, 0]
    gain = np.linalg.solve(turn * np.eye(2) - transition, given)[0]
    assert abs(gain) == pytest.approx(np.sqrt(0.5), rel=1e-4)


def worst_cm(test: FlightTest, feedforward, adaptation) -> float:
    """Median of the lowest drone's worst height error."""
    controller = ControllerConfig(feedforward=feedforward, adaptation=adaptation)
    found = run_flights(test, controller, range(4))
    assert not found.crashed.any()
    return 100.0 * float(np.median(found.worst_height_error[:, -1]))


@each
def test_belief_and_adaptation_together_beat_either(adaptation):
    """Also with masses that are wrong by up to 9 %, which neither knows."""
    for factors, share in (((1.0, 1.0), 0.68), ((0.94, 1.06), 0.35)):
        wrong = Randomization(mass=factors)
        test = replace(swap_test("L2S", SHORT, "wake"), randomization=wrong)
        belief = load("learned")
        alone = worst_cm(test, belief, None), worst_cm(test, None, adaptation)
        assert worst_cm(test, belief, adaptation) < share * min(alone)


@pytest.mark.parametrize(
    ("adaptation", "gain"),
    [(None, 4.0), (MomentumObserver(), 2.36), (Indi(), 2.38), (NeuralFly(), 2.19)],
    ids=["none", *NAMES],
)
def test_the_gain_margin_is_as_documented(adaptation, gain):
    """With a state that is 10 ms late; docs/adaptation.md. The true loop agrees."""
    config = ControllerConfig(adaptation=adaptation)
    assert Loop(config, 0.97 * gain, 0.01).radius() < 1.0 < Loop(config, 1.03 * gain, 0.01).radius()
    calm, shaken = (Loop(config, share * gain, 0.01).peak(480) for share in (0.9, 1.1))
    assert calm[360:].max() < 0.5 * calm[:120].max()
    assert shaken[360:].max() > 2.0 * shaken[:120].max()


def test_height_alone_is_as_its_transfer_function():
    """At 20 Hz the height limits: the whole loop's margin is that of L(s), but for its sampling."""
    fast = MomentumObserver(20.0)
    whole = Loop(ControllerConfig(adaptation=fast), delay_s=0.01).gain_margin()
    assert height_margin(fast, 0.01) == pytest.approx(whole, rel=0.2)
    assert height_margin(MomentumObserver(3.0), 0.01) > 4.0
    assert height_margin(fast, 0.02) < 1.0 < height_margin(fast, 0.0)


def test_the_bandwidth_ends_where_20_ms_of_delay_make_it_unstable():
    assert Loop(ControllerConfig(adaptation=MomentumObserver(3.0)), 1.0, 0.02).radius() < 1.0
    assert Loop(ControllerConfig(adaptation=MomentumObserver(20.0)), 1.0, 0.02).radius() > 1.0
    for kind, name in ((MomentumObserver, "bandwidth_hz"), (Indi, "cutoff_hz")):
        said = rf"{name} is 21\.0, but must be a number in \(0, 20\]"
        with pytest.raises(ValueError, match=said):
            kind(21.0)
