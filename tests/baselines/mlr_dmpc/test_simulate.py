"""Whole flights: they arrive, are repeatable, and bad input is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm_envs.baselines.mlr_dmpc.formations import circle_swap
from swarm_envs.baselines.mlr_dmpc.mlr_dmpc_config import MlrDmpcConfig
from swarm_envs.baselines.mlr_dmpc.radio import Jam, LossModel
from swarm_envs.baselines.mlr_dmpc.simulate import simulate
from swarm_envs.baselines.mlr_dmpc.swarm import MlrDmpcSwarm, UnitOutage

SIX, OPPOSITE = circle_swap(6, 1.2, 1.0)


@pytest.mark.parametrize(
    "trouble",
    [
        {},
        {"config": MlrDmpcConfig(trigger="HT")},
        {"config": MlrDmpcConfig(trigger="RR")},
        {"config": MlrDmpcConfig(trigger="DT")},
        {"config": MlrDmpcConfig(measure="next")},
        {"recovery": "paper"},
        {"recovery": "paper", "config": MlrDmpcConfig.published()},
        {"recovery": False},
        {"informed": False},
        {"loss": 0.1},
        {"loss": LossModel(jams=(Jam(first_round=3, last_round=12),))},
        {"outages": [UnitOutage(unit=0, first_round=5)]},
        {"outages": [UnitOutage(unit=1, first_round=5, last_round=12)]},
    ],
    ids=str,
)
def test_six_drones_change_places(trouble):
    flown = simulate(SIX, OPPOSITE, compute_units=2, seed=1, **trouble)
    assert flown.arrival_time_s is not None and flown.arrival_time_s < 25.0
    assert not flown.violations and flown.least_sampled_distance_m >= 0.25
    assert flown.least_distance_m >= 0.2
    assert flown.solver_failures == 0 and flown.least_shifted_slack_m >= -1e-6
    step = np.diff(flown.reference_positions, axis=0)
    assert np.abs(step).max() < 0.01 * 2.1, "references are continuous, at most 2 m/s"


def test_the_paper_needs_65_rounds_to_learn_sixteen_drones_and_this_one_a_round():
    points, targets = circle_swap(16, 1.5, 1.0)

    def rounds_until_planned(recovery: Any) -> int:
        swarm = MlrDmpcSwarm(points, targets, recovery=recovery, informed=False)
        for k in range(80):
            if any(unit.planned for unit in swarm.run_round().units):
                return k
        raise AssertionError("nobody ever planned")

    assert 60 <= rounds_until_planned("paper") <= 66
    assert rounds_until_planned(True) <= 3


def test_units_that_forget_everything_in_mid_flight_ask_and_go_on():
    forget = [UnitOutage(unit=unit, first_round=8, last_round=8) for unit in range(2)]
    flown = simulate(SIX, OPPOSITE, compute_units=2, outages=forget)
    again = next(r.round for r in flown.reports if r.round > 8 and any(u.planned for u in r.units))
    assert again <= 8 + 12
    assert flown.arrival_time_s is not None


def test_drones_join_and_leave():
    starts, targets = circle_swap(5, 1.0, 1.0)  # nobody rests where another waits to join
    options: dict[str, Any] = {"joins": {4: 10}, "leaves": {0: 20}, "loss": 0.05}
    flown = simulate(starts, targets, 2, duration_s=15.0, stop_on_arrival=False, **options)
    in_air = ~np.isnan(flown.reference_positions[:, :, 0])
    assert not in_air[: 10 * 20, 4].any() and in_air[-1, 4]
    assert in_air[: 20 * 20, 0].all() and not in_air[-1, 0]
    assert not flown.violations
    assert np.isfinite(flown.arrival_times_s[1:]).all()


def test_moving_targets_are_followed():
    points, _ = circle_swap(3, 0.8, 1.0)

    def targets(time: float) -> np.ndarray:
        return Rotation.from_euler("z", 0.1 * time).apply(points)

    flown = simulate(points, targets, compute_units=3, duration_s=12.0)
    late = flown.reference_positions[-1] - targets(12.0)
    assert np.linalg.norm(late, axis=1).max() < 0.35
    assert np.linalg.norm(flown.reference_positions[-1] - points, axis=1).min() > 0.5


def test_a_drone_blown_off_is_planned_for_from_where_it_is():
    swarm = MlrDmpcSwarm(SIX, OPPOSITE, compute_units=2)
    for _ in range(5):
        swarm.run_round()
    measured = swarm.reference(np.zeros(1))[:, 0, :2]
    measured[3, 0] += [0.0, 0.0, 0.7]
    swarm.run_round(measured=measured)
    assert swarm.flying[3].identity == (5, 255)
    for _ in range(6):
        swarm.run_round()
    assert swarm.flying[3].identity.compute_unit != 255, "it has top priority"


FAR = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"targets": FAR * [0.2, 1, 1]}, r"targets\[0\] and targets\[1\] are 0.200 m apart"),
        ({"loss": 1.5}, r"loss is 1.5, but must be a share in \[0, 1\]"),
        ({"duration_s": 0.0}, "duration_s is 0.0, but must be a number in"),
        ({"recovery": "paper", "joins": {1: 5}}, "only recovery=True"),
        ({"targets": lambda t: FAR * [1 - 0.5 * t, 1, 1]}, "targets at 1.6 s"),
    ],
)
def test_bad_input_is_refused_with_the_reason(changes, reason):
    good = {"starts": FAR, "targets": FAR[::-1], "compute_units": 1, "duration_s": 5.0}
    with pytest.raises(ValueError, match=reason):
        simulate(**{**good, **changes})


def test_distances_are_kept_between_samples_too():
    """Theorem T2, for drones that cross at full speed; the least distance is the polynomials'."""
    starts, targets = circle_swap(8, 1.5, 1.0)
    config = MlrDmpcConfig(turn_rad=0.0, soft_m=0.0)
    flown = simulate(starts, targets, seed=2, duration_s=8.0, config=config)
    scaled = flown.reference_positions * config.inverse_scaling
    apart = np.linalg.norm(scaled[:, :, None] - scaled[:, None], axis=-1)
    seen = float((apart + 9.0 * np.eye(8)).min())
    assert seen < 0.28, "they do meet"
    assert config.distance_m <= flown.least_distance_m <= seen
    assert flown.least_sampled_distance_m >= config.sampled_distance_m - 1e-6


def test_planes_around_the_plan_itself_bring_drones_there_sooner_and_as_far_apart():
    config = MlrDmpcConfig()
    fixed = simulate(*circle_swap(16, 1.5, 1.0), 1, config=MlrDmpcConfig(planes="fixed"))
    flown = simulate(*circle_swap(16, 1.5, 1.0), 1)
    assert fixed.arrival_time_s is not None and flown.arrival_time_s is not None
    assert flown.arrival_time_s < 0.6 * fixed.arrival_time_s
    assert flown.least_distance_m >= config.distance_m
    assert flown.least_sampled_distance_m >= config.sampled_distance_m - 1e-6
    assert flown.least_shifted_slack_m >= -1e-6 and not flown.violations


@pytest.mark.parametrize("step", [0.1, 0.05, 0.025])
def test_what_samples_keep_is_enough_for_the_fastest_crossing(step):
    """Two that cross at the largest relative speed, a quarter of whose way is between samples."""
    config = MlrDmpcConfig(collision_sampling_s=step)
    speed = 2.0 * config.speed_limit * np.sqrt(2.0 + 1.0 / 36.0)
    aside = np.sqrt(config.sampled_distance_m**2 - (speed * step / 2.0) ** 2)
    assert aside >= config.distance_m
    assert aside <= config.distance_m * (1.0 + 2.0 * step), "nor is it wasteful"


def test_a_drone_that_hears_nothing_is_reported():
    deaf = LossModel(jams=(Jam(first_round=0, last_round=500, receivers="drone 2"),))
    flown = simulate(SIX, OPPOSITE, 2, loss=deaf)
    assert flown.deaf == (2,) and np.isnan(flown.arrival_times_s[2])
    assert flown.unreachable == ((5, 2),), "it rests where drone 5 wants to go"
    assert flown.reference_times[-1] < 20.0, "nothing else would have changed"
    assert simulate(SIX, OPPOSITE, 2, loss=0.1, duration_s=20.0).deaf == ()


def test_what_messages_cannot_name_is_refused_at_once():
    def swarm(rows: int, units: int) -> MlrDmpcSwarm:
        points = np.stack(np.meshgrid(np.arange(16.0), np.arange(rows), [1.0]), -1).reshape(-1, 3)
        config = MlrDmpcConfig(box=((-1.0, -1.0, 0.3), (16.0, rows, 3.0)))
        return MlrDmpcSwarm(points, points, compute_units=units, config=config)

    with pytest.raises(ValueError, match=r"compute_units is 30, .* drones of more than 16: use"):
        swarm(16, 30)
    too_many = r"there are 512 drones, but 132 bytes .* than 4.. members: use"
    with pytest.raises(ValueError, match=too_many):
        swarm(32, 3)
    most = swarm(16, 16)
    most.run_round()  # says who is planned for
    assert len(most.run_round().accepted) == 16
