"""Flight tests: they fly what the agent flies in the environment; what they record and refuse."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from swarm_envs import swap_v1
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm import TrackingAgent, flights, load_belief
from swarm_envs.baselines.neural_swarm.flights import FlightTest, run_flights, swap_test
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import load
from swarm_envs.tasks.ring import RingTask, ring_team
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.vehicles import SMALL
from swarm_envs.viewing.record import Recorder

SHORT = StackedLayout(radius_m=(0.3, 0.3), duration_s=(1.5, 1.5))
SEEDS = (3, 1, 2)


@pytest.mark.parametrize("compensated", [False, True])
def test_it_flies_what_the_agent_flies_in_the_environment(compensated):
    agent = TrackingAgent.compensated() if compensated else TrackingAgent()
    controller = agent.requires["controller"]
    found = run_flights(swap_test("SL2S", SHORT), controller, SEEDS)
    env = swap_v1.parallel_env(
        team="SL2S", layout="stacked", stacked=SHORT, physics="batch", horizon_s=3.5,
        end_on_success=False, **agent.requires,
    )  # fmt: skip
    for e, seed in enumerate(SEEDS):
        recorder = Recorder()
        metrics = fly_episode(env, agent, seed, watch=recorder)
        record, mine = recorder.record(), found.record(e)
        for name in ("time", "position", "quaternion", "reference", "force"):
            np.testing.assert_allclose(getattr(mine, name), getattr(record, name), atol=1e-12)
        assert found.metrics[e] == {k: v for k, v in metrics.items() if k != "mean_return"}
        worst = np.abs(record.position - record.reference)[..., 2].max(axis=0)
        np.testing.assert_allclose(found.worst_height_error[e], worst, atol=1e-12)


def test_how_many_fly_at_once_changes_nothing(monkeypatch):
    together = run_flights(swap_test("L2S", SHORT), ControllerConfig(), SEEDS)
    monkeypatch.setattr(flights, "AT_ONCE", 2)
    ticks: list[int] = []
    apart = run_flights(swap_test("L2S", SHORT), ControllerConfig(), SEEDS, ticks.append)
    for name in ("position", "force", "worst_height_error", "samples", "crashed"):
        assert (getattr(together, name) == getattr(apart, name)).all(), name
    assert sum(ticks) == 3 * swap_test("L2S", SHORT).decisions == 3 * 3.5 * 48


def test_what_is_believed_is_recorded_beside_what_blows():
    wake = load("wake")
    oracle = run_flights(swap_test("L2S", SHORT, "wake"), ControllerConfig(feedforward=wake), SEEDS)
    assert np.abs(oracle.force[..., 2]).max() > 0.03
    assert (oracle.feedforward_force == oracle.force).all()
    baseline = run_flights(swap_test("L2S", SHORT, "wake"), ControllerConfig(), SEEDS)
    assert (baseline.feedforward_force == 0.0).all()
    assert oracle.worst_height_error.max() < 0.2 * baseline.worst_height_error.max()


def test_a_flight_that_crashes_keeps_its_last_state():
    weak = dataclasses.replace(SMALL, max_thrust=0.94 * SMALL.mass * 9.80665)
    test = dataclasses.replace(swap_test((SMALL, weak), SHORT), horizon_s=20.0)
    found = run_flights(test, ControllerConfig(), [0])
    assert found.crashed.all()
    end = int(found.samples[0])
    assert end < len(found.time) == 20 * 48 + 1
    assert (found.position[0, end:] == found.position[0, end - 1]).all()
    assert len(found.record(0).time) == end


def test_rings_count_errors_after_their_start():
    task = RingTask(ring_team(5), scored_s=1.0)
    found = run_flights(FlightTest(task), ControllerConfig(), [0])
    height = np.abs(found.position - found.reference)[0, :, :, 2]
    late = found.time >= task.success.settle_s
    np.testing.assert_allclose(found.worst_height_error[0], height[late].max(axis=0), atol=1e-12)


def test_nothing_to_fly_is_refused():
    with pytest.raises(ValueError, match="no seed was given"):
        run_flights(swap_test("L2S"), ControllerConfig(), [])


def test_a_belief_is_chosen_by_its_environment():
    assert load_belief() is load_belief("learned")
    assert "learned" in str(load_belief().notes["data"])
    assert "wake" in str(load_belief("wake").notes["data"])
    with pytest.raises(ValueError, match=r"no belief ships.*'none'.*swarm_envs.training.belief"):
        load_belief("none")
