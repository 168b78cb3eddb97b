"""Random flights to compare controllers in."""

from __future__ import annotations

import numpy as np

from swarm_envs.state import FloatArray, Setpoint, SwarmState, hover_state
from swarm_envs.vehicles import Team


class RandomFlight:
    """Smooth random states and set-points with noise on top, for two environments of a team."""

    def __init__(self, team: Team, seed: int, wildness: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.wildness = wildness
        self.shape = (2, len(team))
        self.state = hover_state(team, self.rng.normal(size=(*self.shape, 3)))
        self.setpoint = Setpoint.hold(self.state.position.copy())
        self.walk = np.zeros((*self.shape, 3))

    def advance(self) -> tuple[SwarmState, Setpoint, FloatArray]:
        """State, set-point and believed force (2, N, 3), N, one step later."""
        rng, shape, wild = self.rng, self.shape, self.wildness
        self.walk += 0.05 * (wild * rng.normal(size=self.walk.shape) - self.walk)
        s, sp = self.state, self.setpoint
        s.velocity[...] = self.walk + 0.03 * rng.normal(size=self.walk.shape)
        s.position[...] += s.velocity / 240
        s.angular_velocity[...] = 2 * wild * rng.normal(size=self.walk.shape)
        step = np.concatenate([s.angular_velocity / 480, np.ones((*shape, 1))], axis=-1)
        s.quaternion[...] = _multiply(step, s.quaternion)
        s.quaternion[...] /= np.linalg.norm(s.quaternion, axis=-1, keepdims=True)
        s.quaternion[...] *= rng.choice([-1.0, 1.0], size=(*shape, 1))
        sp.velocity[...] = 0.1 * wild * rng.normal(size=self.walk.shape)
        sp.acceleration[...] = wild * rng.normal(size=self.walk.shape)
        sp.yaw_rate[...] = wild * rng.normal(size=shape)
        sp.yaw[...] += sp.yaw_rate / 240 + (rng.uniform(size=shape) < 0.01) * rng.normal(size=shape)
        return s, sp, 0.03 * wild * rng.normal(size=self.walk.shape)


def _multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    va, wa, vb, wb = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = wa * vb + wb * va + np.cross(va, vb)
    scalar = wa * wb - np.sum(va * vb, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)
