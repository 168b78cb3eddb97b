"""Who tumbles stops at that physics step, at any decision rate and on both engines."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from swarm_envs import swap_v1
from swarm_envs.physics.rigid_body import TUMBLING_RATE
from swarm_envs.vehicles import SMALL

HOVER = [2 * SMALL.hover_rotor_thrust / SMALL.max_rotor_thrust - 1] * 4
ROTORS = dict(zip(("drone_0", "drone_1", "drone_2"), ([1, 1, -1, -1], HOVER, HOVER), strict=True))
"""The first drone rolls over, the others hover."""
START = [[0, 0, 2], [-1, 1, 2], [1, 1, 2]]
FIELDS = ("position", "quaternion", "velocity", "angular_velocity", "rotor_thrust")


def flown(
    engine: str, rate: int, rule: str, **options: Any
) -> tuple[list[float], npt.NDArray[np.void]]:
    """Fly a second: the first drone's angular speed after each decision, rad/s; and the records."""
    env = swap_v1.parallel_env(
        num_drones=3,
        physics=engine,
        action="rotors",
        decision_rate=rate,
        horizon_s=1.0,
        on_contact=rule,
        **options,
    )
    env.reset(seed=1, options={"start": START})
    speeds = []
    while env.agents:
        env.step({name: np.array(ROTORS[name], np.float32) for name in env.agents})
        speeds.append(float(np.linalg.norm(env.core.world.drones["angular_velocity"][0, 0])))
    records = env.core.world.drones[0].copy()
    env.close()
    return speeds, records


@pytest.mark.parametrize("rule", ["end_team", "end_pair", "bounce"])
@pytest.mark.parametrize("rate", [1, 24])
def test_who_tumbles_stops_at_that_physics_step(engine, rate, rule):
    """Against the flight that is judged at every physics step: there the episode ended so."""
    speeds, expected = flown(engine, 240, rule)
    first = next(k for k, speed in enumerate(speeds) if speed > TUMBLING_RATE)
    growth = speeds[first] - speeds[first - 1]
    seldom, records = flown(engine, rate, rule)
    assert len(seldom) < len(speeds)
    assert TUMBLING_RATE < max(seldom) <= TUMBLING_RATE + growth
    assert records["tumbling"].tolist() == [1.0, 0.0, 0.0]
    assert records["steps"].tolist() == expected["steps"].tolist()
    assert records["steps"][0] == first + 1
    assert (records["steps"][1] == first + 1) == (rule == "end_team")
    for name in FIELDS:
        np.testing.assert_allclose(records[name], expected[name], rtol=0.0, atol=1e-9)


def test_the_hall_s_estimate_stops_with_the_drone():
    """Its errors are those of the step at which the drone stopped, as judged at every step."""
    _, expected = flown("batch", 240, "end_team", world="hall")
    _, records = flown("batch", 1, "end_team", world="hall")
    assert records["steps"].tolist() == expected["steps"].tolist()
    for name in (*FIELDS, "position_error", "velocity_error"):
        np.testing.assert_allclose(records[name], expected[name], rtol=0.0, atol=1e-9)
