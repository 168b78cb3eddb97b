"""What came of an episode, in words: collisions, near misses, outcome, metrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.agents import load, record_episode
from swarm_envs.vehicles import parse_team
from swarm_envs.viewing.record import About, Recording
from swarm_envs.viewing.summary import events, metric_rows, near_misses, outcome, team_label


def still(steps: int, drones: int = 2) -> Recording:
    """Small drones that hang half a metre apart for `steps` samples."""
    place = np.tile([0.0, 0.0, 1.0], (steps, drones, 1))
    place[..., 0] += 0.5 * np.arange(drones)
    off = np.zeros((steps, drones), dtype=bool)
    nobody = np.full((steps, drones), -1)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (steps, drones, 1))
    return Recording(
        team=parse_team("S" * drones),
        time=np.arange(steps) / 48,
        position=place,
        quaternion=level,
        reference=place,
        force=0.0 * place,
        velocity=0.0 * place,
        rotor_thrust=0.0 * level,
        goal=place,
        setpoint=place,
        contact_drone=nobody,
        contact_floor=off,
        contact_wall=off,
        contact_obstacle=nobody,
        tumbling=off,
        reward=0.0 * level[..., 0],
        reward_terms={},
        about=About("swap_v0", "me", 1, "batch", 48, ((-2, -2, 0), (2, 2, 2.5)), (), {}),
    )


def test_events_are_named_once_when_they_begin():
    quiet = still(6, drones=3)
    contact_drone, floor = quiet.contact_drone.copy(), quiet.contact_floor.copy()
    obstacle = quiet.contact_obstacle.copy()
    contact_drone[2:4, 0], contact_drone[2:4, 1] = 1, 0
    floor[3:, 2] = True
    obstacle[5, 1] = 0
    bumped = replace(
        quiet, contact_drone=contact_drone, contact_floor=floor, contact_obstacle=obstacle
    )
    assert events(quiet) == []
    found = events(bumped)
    assert [(e.frame, e.kind, e.drones) for e in found] == [
        (2, "drone", (0, 1)),
        (3, "floor", (2,)),
        (5, "obstacle", (1,)),
    ]
    assert found[0].position.tolist() == [0.25, 0.0, 1.0]
    assert found[0].text == "0.04 s: drone_0 and drone_1 collide"


@pytest.mark.parametrize(
    ("success", "contact", "said"),
    [
        (True, False, "Success, after 0.10 s."),
        (False, True, "Ended in flight, at 0.10 s: drone_1 hits the floor."),
        (False, False, "No success: the clock ran out after 0.10 s."),
    ],
)
def test_the_outcome_in_a_sentence(success, contact, said):
    quiet = still(6)
    floor = quiet.contact_floor.copy()
    floor[-1, 1] = contact
    about = replace(quiet.about, metrics={"success": success})
    assert outcome(replace(quiet, contact_floor=floor, about=about)) == said


def test_metrics_have_labels_and_units():
    metrics = {"success": True, "worst_force_g": 12.3456, "near_misses": 2, "energy_j": None}
    rows = metric_rows(metrics | {"by_drone_m": [1.0]})
    assert rows == [
        ("Success", "yes"),
        ("Worst force", "12.35 g"),
        ("Near misses", "2"),
        ("Energy", "\N{EN DASH}"),
    ]


def test_long_teams_are_counted():
    assert team_label(parse_team("LS")) == "LS"
    assert team_label(parse_team("S*" * 10 + "SSSSLL")) == "10 S* + 4 S + 2 L"


def passing(closest: float, contact: bool = False) -> Recording:
    """Three drones; the first two pass each other at a distance, m, in sample 2 of 6."""
    flown = still(6, drones=3)
    place = flown.position.copy()
    place[:, 1, 0] = closest + 0.06 * np.array([2, 1, 0, 1, 2, 3])
    touched = flown.contact_drone.copy()
    if contact:
        touched[3, 0], touched[3, 1] = 1, 0
    return replace(flown, position=place, contact_drone=touched)


def test_near_misses_are_marked_where_drones_are_closest():
    """Small ones touch at 0.12 m; up to 0.18 m apart they had a near miss."""
    (event,) = near_misses(passing(0.13))
    assert (event.frame, event.kind, event.drones) == (2, "near miss", (0, 1))
    assert event.position.tolist() == pytest.approx([0.065, 0.0, 1.0])
    assert event.text == "0.04 s: drone_0 and drone_1 come within 0.13 m"
    assert near_misses(passing(0.181)) == []
    assert near_misses(passing(0.119)) == []  # that is a collision
    assert near_misses(passing(0.13, contact=True)) == []  # it became one
    twice = np.concatenate([passing(0.13).position, passing(0.15).position])
    again = still(12, drones=3)
    assert [e.frame for e in near_misses(replace(again, position=twice))] == [2, 8]


def test_near_misses_agree_with_the_metric():
    """Where every physics step is a decision, both see the same."""
    agent = load("tracking")
    seen = 0
    requires = dict(agent.requires) | {"decision_rate": 240}
    env = swap_v0.parallel_env(num_drones=6, physics="batch", horizon_s=2.0, **requires)
    agent.requires = requires
    for seed in range(6):
        flown = record_episode(env, agent, seed)
        drones = {i for event in near_misses(flown) for i in event.drones}
        assert (
            len(drones - {*np.flatnonzero(flown.contact_drone[-1] >= 0)})
            == (flown.about.metrics["near_misses"])
        )
        seen += len(drones)
    assert seen > 0
