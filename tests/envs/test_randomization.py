"""Randomised episodes: what is drawn acts, stays in its range, and is off by default."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v0
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.randomization import Randomization
from swarm_envs.motors import BatteryModel
from swarm_envs.state import SwarmState
from swarm_envs.tasks.swap import SwapTask
from swarm_envs.vehicles import GRAVITY, SMALL, parse_team

MANY = 400


def core(ranges: Randomization | None, num_envs: int = MANY, **options: object) -> SwarmCore:
    config = EnvConfig(physics="batch", randomization=ranges, **options)  # type: ignore[arg-type]
    made = SwarmCore(SwapTask(parse_team("SL"), "stacked"), config, num_envs)
    made.reset(list(range(num_envs)))
    return made


@pytest.mark.parametrize(
    ("option", "field"),
    [("mass", "mass"), ("motor_rate", "motor_rate"), ("thrust", "max_rotor_thrust")],
)
def test_factors_fill_their_range_and_nothing_else_moves(option, field):
    ranges = Randomization(**{option: (0.8, 1.3)})  # type: ignore[arg-type]  # by name
    made, usual = core(ranges), core(None)
    factor = getattr(made.physics.parameters, field) / getattr(usual.physics.parameters, field)
    assert 0.8 <= factor.min() < 0.81 and 1.29 < factor.max() <= 1.3
    assert abs(np.corrcoef(factor.T)[0, 1]) < 0.2  # drones differ within an environment
    for name, mine, theirs in zip(
        made.physics.parameters._fields, made.physics.parameters, usual.physics.parameters
    ):
        assert name == field or np.array_equal(mine, theirs)
    assert np.array_equal(made.world.drones["nominal_mass"], usual.physics.parameters.mass)
    assert np.array_equal(made.world.drones["start"], usual.world.drones["start"])


def test_inertia_keeps_its_shape():
    made = core(Randomization(inertia=(0.5, 2.0)))
    factor = made.physics.parameters.inertia[:, 0] / np.array(SMALL.inertia)
    assert np.ptp(factor, axis=1).max() < 1e-12 < np.ptp(factor, axis=0).max()


def test_every_episode_is_drawn_anew_and_a_seed_repeats_it():
    made = core(Randomization(mass=(0.9, 1.1)), 2)
    first = made.physics.parameters.mass.copy()
    made.reset()
    assert not (made.physics.parameters.mass == first).any()
    made.reset(mask=np.array([True, False]), seeds=[0, None])
    assert np.array_equal(made.physics.parameters.mass[0], first[0])


def pushed(engine: str, ranges: Randomization, yaw: float, steps: int) -> SwarmState:
    """The state of a lone drone that began level, after rotor commands about its nominal hover."""
    options: dict[str, Any] = {"interactions": "none", "action": "rotors"}
    env = swap_v0.parallel_env(num_drones=1, physics=engine, randomization=ranges, **options)
    env.reset(seed=0, options={"start": [[0.0, 0.0, 1.5]]})
    level = 2 * SMALL.hover_rotor_thrust / SMALL.max_rotor_thrust - 1
    for _ in range(steps):
        env.step({"drone_0": level + yaw * np.array([-1.0, 1.0, -1.0, 1.0])})
    state = env.view.state.copy()
    env.close()
    return state


def test_a_heavier_drone_sags_on_both_engines(engine):
    """Open loop at the nominal hover thrust, it falls with g (1 - m / m')."""
    state = pushed(engine, Randomization(mass=(1.1, 1.1)), yaw=0.0, steps=12)
    assert state.velocity[0, 2] == pytest.approx(GRAVITY * (1 / 1.1 - 1) * 0.25, rel=1e-6)


def test_a_smaller_inertia_turns_faster_on_both_engines(engine):
    """The yaw rate after a yaw torque is inversely proportional to the moment of inertia."""
    ranges = (Randomization(inertia=(factor, factor)) for factor in (1.0, 0.5))
    slow, fast = (pushed(engine, each, 0.02, 1).angular_velocity[0, 2] for each in ranges)
    assert fast == pytest.approx(2 * slow, rel=1e-9)


def test_scaled_forces_scale():
    made, usual = core(Randomization(force_scale=(0.5, 2.0))), core(None)
    scale = made.world.environments["force_scale"]
    assert 0.5 <= scale.min() < 0.52 and 1.95 < scale.max() <= 2.0
    for one in (made, usual):
        one.physics.step(one.physics.state.rotor_thrust)
    expected = usual.physics.force * scale[:, None, None]
    np.testing.assert_allclose(made.physics.force, expected, atol=1e-15)


def test_gusts_push_all_drones_alike_with_the_spread_asked_for():
    ranges = Randomization(gust_acceleration=0.8, gust_time_s=0.2)
    made = core(ranges, interactions="none")
    samples = []
    for _ in range(40):
        made.physics.fly(5, made.running)
        samples.append(made.world.environments["gust"].copy())
    spread = np.array(samples[20:]).std()
    assert spread == pytest.approx(0.8, rel=0.05)
    lag = np.mean(samples[-1] * samples[-6]) / spread**2  # 25 physics steps apart
    assert lag == pytest.approx(np.exp(-25 / 240 / 0.2), abs=0.1)


def test_without_a_controller_a_gust_accelerates_every_type_by_itself():
    ranges = Randomization(gust_acceleration=2.0, gust_time_s=100.0)
    made = core(ranges, 1, interactions="none", action="rotors")
    still = core(None, 1, interactions="none", action="rotors")
    for one in (made, still):
        one.physics.fly(24, one.running)
    gained = made.physics.state.velocity - still.physics.state.velocity
    np.testing.assert_allclose(gained[0, 0], gained[0, 1], rtol=1e-9)
    assert np.linalg.norm(gained) > 1e-3


def test_noise_is_seen_but_not_flown():
    ranges = Randomization(position_noise_m=0.02, velocity_noise=0.1, body_rate_noise=0.3)
    made, usual = core(ranges), core(None)
    for _ in range(5):
        rows = made.step(np.zeros((MANY, 2, 3))).observations
        clean = usual.step(np.zeros((MANY, 2, 3))).observations
    assert np.array_equal(made.physics.state.position, usual.physics.state.position)
    error = rows - clean
    assert error[..., 0:3].std() == pytest.approx(0.02, rel=0.05)
    assert error[..., 3:6].std() * 2.0 == pytest.approx(0.1, rel=0.05)
    assert error[..., 15:18].std() * 10.0 == pytest.approx(0.3, rel=0.05)
    assert np.array_equal(rows[..., 6:15], clean[..., 6:15])  # attitude: no noise asked for
    assert np.array_equal(made.team_state(), usual.team_state())


def test_noisy_attitudes_turn_by_the_angle_asked_for():
    made, usual = core(Randomization(attitude_noise_rad=0.05)), core(None)
    a = made.rows[..., 6:15].reshape(-1, 3, 3).astype(np.float64)
    b = usual.rows[..., 6:15].reshape(-1, 3, 3).astype(np.float64)
    turn = a @ b.transpose(0, 2, 1)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(0.05 * np.sqrt(3), rel=0.05)


def test_batteries_start_where_they_are_drawn_and_limit_from_the_first_step():
    ranges = Randomization(battery=(0.05, 0.1))
    made = core(ranges, battery=BatteryModel())
    charge = made.physics.state.battery
    assert 0.05 <= charge.min() < charge.max() <= 0.1
    assert (made.world.drones["rotor_limit"] < made.physics.parameters.max_rotor_thrust).all()


def test_what_could_not_fly_is_refused():
    weak = Randomization(thrust=(0.5, 1.0), mass=(1.0, 1.2))
    with pytest.raises(ValueError, match=r"can leave 'S' with a thrust-to-weight ratio of 0.8\d"):
        swap_v0.parallel_env(num_drones=2, physics="batch", randomization=weak)
    with pytest.raises(ValueError, match="these batteries never empty; give battery="):
        swap_v0.parallel_env(physics="batch", randomization=Randomization(battery=(0.5, 1.0)))
