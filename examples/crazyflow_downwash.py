"""Add the downwash of swarm-envs to crazyflow, as a function of its step pipeline.

    pip install crazyflow
    python examples/crazyflow_downwash.py

crazyflow 0.4 (https://github.com/utiasDSL/crazyflow) simulates swarms in JAX, without forces
between drones. Two drones are released 0.3 m above each other, level and with thrust equal to
weight; the forces are those of a large drone above a small one. Vehicles of crazyflow are equal, so
forces are scaled by its mass over that of swarm-envs: accelerations are equal. The script prints by
how much the small drone sinks, the difference of two flights with and without the forces, which
excludes the start of the rotors.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.sim import Sim
from crazyflow.sim.pipeline import insert_fn_before

from swarm_envs import reference
from swarm_envs.reference_numbers import aerodynamics_of, bodies_of

TEAM = "LS"
START = np.array([[0.0, 0.0, 1.5], [0.05, 0.0, 1.2]])  # m
SECONDS, RATE = 0.3, 500


def with_downwash(sim: Any, team: str) -> None:
    """Add the interaction forces of a team to every world of a simulator."""
    body, air = bodies_of(team, jnp), aerodynamics_of("learned", team, jnp)
    air["drag"] = 0.0  # crazyflow has its own

    def downwash(data: Any) -> Any:
        force = reference.learned(data.states.pos, data.states.vel, air)
        force = force * (data.params.mass / body.mass[:, None])
        return data.replace(states=data.states.replace(force=force))

    insert_fn_before(sim.step_pipeline, "integration", downwash)
    sim.build_step_fn()


def heights_in_crazyflow(downwash: bool, worlds: int) -> np.ndarray[Any, Any]:
    """Return the heights (worlds, 2), m, at the end of a flight in crazyflow."""
    sim = Sim(
        n_worlds=worlds,
        n_drones=2,
        drone="cf2x_L250",
        control="attitude",
        integrator="symplectic_euler",
        freq=RATE,
    )
    if downwash:
        with_downwash(sim, TEAM)
    sim.reset()
    start = jnp.broadcast_to(jnp.asarray(START), (worlds, 2, 3)).astype(jnp.float32)
    sim.data = sim.data.replace(states=sim.data.states.replace(pos=start))
    weight = 9.81 * jnp.reshape(sim.data.params.mass, (-1,))[0]
    sim.attitude_control(jnp.zeros((worlds, 2, 4)).at[..., 3].set(weight))
    sim.step(round(SECONDS * RATE))
    return np.asarray(jax.block_until_ready(sim.data.states.pos[..., 2]))


def heights_in_reference(downwash: bool) -> np.ndarray[Any, Any]:
    """Return the heights (2,), m, at the end of the same flight by `swarm_envs.reference`."""
    body, forces = bodies_of(TEAM), reference.still_air
    if downwash:
        forces = partial(reference.learned, air=aerodynamics_of("learned", TEAM))
    state = reference.hovering(START, body)
    for _ in range(round(SECONDS * RATE)):
        force = forces(state.position, state.velocity)
        state = reference.moved(state, state.rotor_thrust, force, 0.0 * force, body, 1.0 / RATE)
    return np.asarray(state.position[:, 2])


def main(worlds: int = 1) -> tuple[float, float]:
    """Return by how much the small drone sinks in crazyflow and in the reference, m."""
    crazyflow = heights_in_crazyflow(False, worlds) - heights_in_crazyflow(True, worlds)
    ours = heights_in_reference(False) - heights_in_reference(True)
    sunk = float(crazyflow[0, 1]), float(ours[1])
    print(f"in {SECONDS} s the small drone sinks {100 * sunk[0]:.1f} cm in crazyflow", end=", ")
    print(f"{100 * sunk[1]:.1f} cm by swarm_envs.reference")
    return sunk


if __name__ == "__main__":
    main()
