"""Optimize set-points of a swap in downwash, by gradient descent through the simulation.

    python examples/swap_by_gradient.py

A large drone passes above a small one, whose controller has no force model, so that it sinks. The
simulation (`swarm_envs.reference`, in torch) is differentiable in the set-points. Descent changes
bumps of the small drone's desired height; errors are distances from the straight line.
"""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from swarm_envs.reference import hovering, learned, step
from swarm_envs.reference_numbers import aerodynamics_of, bodies_of, gains_of
from swarm_envs.state import Setpoint

TEAM = "LS"
SPEED = 1.0 / 3.2  # m/s of each drone, half the path of the swap of Neural-Swarm2, Fig. 8
GAP, LOWEST = 0.25, 0.8  # m between both, and of the small drone above the ground
SECONDS, BUMPS = 2.4, 12  # the large drone is above the small one after half the time


def lines(dt: float) -> tuple[Tensor, Tensor]:
    """Return positions (steps, 2, 3), m, on straight lines that cross, and velocities (2, 3)."""
    velocity = torch.tensor([[SPEED, 0.0, 0.0], [-SPEED, 0.0, 0.0]], dtype=torch.float64)
    time = dt * torch.arange(round(SECONDS / dt), dtype=torch.float64) - SECONDS / 2
    height = torch.tensor([[0.0, 0.0, LOWEST + GAP], [0.0, 0.0, LOWEST]], dtype=torch.float64)
    return height + time[:, None, None] * velocity, velocity


def bumps(dt: float) -> Tensor:
    """Return bumps in time (3, steps, BUMPS): values, first and second derivatives."""
    time = dt * torch.arange(round(SECONDS / dt), dtype=torch.float64)
    width = SECONDS / BUMPS
    u = (time[:, None] - width * (0.5 + torch.arange(BUMPS))) / width
    value = torch.exp(-0.5 * u**2)
    return torch.stack([value, -u / width * value, (u**2 - 1.0) / width**2 * value])


def height_errors(sizes: Tensor, dt: float) -> Tensor:
    """Return height errors of the small drone (steps,), m, for sizes (BUMPS,) of bumps, m."""
    line, speed = lines(dt)
    body, gains = bodies_of(TEAM, torch), gains_of(dt=dt, xp=torch)
    air = partial(learned, air=aerodynamics_of("learned", TEAM, torch))
    up = torch.zeros(2, 3, dtype=torch.float64)
    up[1, 2] = 1.0  # only the small drone
    p, v, a = ((bumps(dt) @ sizes)[:, :, None, None] * up).unbind()
    still, none = torch.zeros(2, 3, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    state, heights = hovering(line[0], body)._replace(velocity=speed), []
    for k in range(len(line)):
        setpoint = Setpoint._make((line[k] + p[k], speed + v[k], a[k], still, none, none))
        heights.append(state.position[1, 2])
        state = step(state, setpoint, body, gains, forces=air, dt=dt)
    return torch.stack(heights) - LOWEST


def worst_cm(sizes: Tensor, dt: float) -> float:
    """Return the worst height error, cm."""
    with torch.no_grad():
        return float(100.0 * height_errors(sizes, dt).abs().max())


def main(rounds: int = 8, dt: float = 1.0 / 120.0) -> tuple[float, float]:
    """Descend in steps of dt, s; return the worst error, cm, before and after, at 240 Hz."""
    torch.set_num_threads(1)
    sizes = torch.zeros(BUMPS, dtype=torch.float64, requires_grad=True)
    descent = torch.optim.LBFGS([sizes], lr=0.5, max_iter=1)

    def loss() -> Tensor:
        descent.zero_grad()
        errors = 100.0 * height_errors(sizes, dt)
        mean = (errors**2).mean()
        mean.backward()  # type: ignore[no-untyped-call]
        print(f"worst height error {errors.abs().max().item():.2f} cm")
        return mean

    for _ in range(rounds):
        descent.step(loss)  # type: ignore[no-untyped-call]
    before, after = (worst_cm(x, 1.0 / 240.0) for x in (torch.zeros_like(sizes), sizes.detach()))
    print(f"at 240 Hz: {before:.1f} cm before, {after:.1f} cm after")
    return before, after


if __name__ == "__main__":
    main()
