"""Fit a model of downwash to flights, by the gradient through the simulation.

    python examples/fit_by_gradient.py

Two flights of a large drone above a small one are recorded as by motion capture, positions with
noise of 1 mm; the true wake is stronger and wider than that of `wake`. No force is measured:
strength and width are those with which `swarm_envs.reference`, in torch, reproduces the recorded
flights.
"""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from swarm_envs.reference import hovering, step, wake
from swarm_envs.reference_numbers import aerodynamics_of, bodies_of, gains_of
from swarm_envs.state import Setpoint

TEAM = "LS"
TRUTH = (1.3, 1.15)  # strength and width of the large drone's wake, over those of `wake`
NOISE_M = 1e-3
ASIDE_M = (0.0, 0.09)  # distance of the small drone from the line of the large one, by flight


def simulated(factors: Tensor, seconds: float, dt: float) -> Tensor:
    """Return positions (steps, 2, 2, 3), m, of both flights for factors (2,) of the wake."""
    body, gains, air = (
        bodies_of(TEAM, torch),
        gains_of(dt=dt, xp=torch),
        aerodynamics_of("wake", TEAM, torch),
    )
    changed = {"strength": factors[0] * air["strength"], "width": factors[1] * air["width"]}
    forces = partial(wake, air=air | changed)
    start = torch.tensor(
        [[[-0.3, 0.0, 1.3], [0.0, aside, 1.0]] for aside in ASIDE_M], dtype=torch.float64
    )
    speed = torch.zeros_like(start)
    speed[:, 0, 0] = 0.6 / seconds
    state = hovering(start, body)._replace(velocity=speed)
    still, none, positions = 0.0 * start, 0.0 * start[..., 0], []
    for k in range(round(seconds / dt)):
        positions.append(state.position)
        setpoint = Setpoint._make((start + dt * k * speed, speed, still, still, none, none))
        state = step(state, setpoint, body, gains, forces=forces, dt=dt)
    return torch.stack(positions)


def misfit(factors: Tensor, recorded: Tensor, seconds: float, dt: float) -> Tensor:
    """Return the mean square difference from the recorded positions, mm^2."""
    return 1e6 * ((simulated(factors, seconds, dt) - recorded) ** 2).mean()


def main(rounds: int = 6, seconds: float = 1.0, dt: float = 1.0 / 100.0) -> Tensor:
    """Fit in steps of dt, s, and return the factors (2,)."""
    torch.set_num_threads(1)
    with torch.no_grad():
        recorded = simulated(torch.tensor(TRUTH, dtype=torch.float64), seconds, dt)
    noise = torch.randn(recorded.shape, generator=torch.Generator().manual_seed(0))
    recorded = recorded + NOISE_M * noise
    factors = torch.ones(2, dtype=torch.float64, requires_grad=True)
    descent = torch.optim.LBFGS([factors], max_iter=rounds, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        descent.zero_grad()
        found = misfit(factors, recorded, seconds, dt)
        found.backward()  # type: ignore[no-untyped-call]
        strength, width = factors.detach().tolist()
        off = found.item() ** 0.5
        print(f"strength {strength:.3f}, width {width:.3f}: error {off:.2f} mm")
        return found

    descent.step(loss)  # type: ignore[no-untyped-call]
    print(f"true strength {TRUTH[0]}, true width {TRUTH[1]}")
    return factors.detach()


if __name__ == "__main__":
    main()
