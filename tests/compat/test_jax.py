"""The equations in JAX, and in crazyflow, where these are installed."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import reference
from swarm_envs.reference_numbers import aerodynamics_of, bodies_of, gains_of
from swarm_envs.state import FloatArray, Setpoint
from tests.helpers.sources import ROOT

TEAM = "LSS"
MODELS = {"wake": reference.wake, "learned": reference.learned, "deep-set": reference.deep_set}
START = np.array([[0.0, 0.0, 1.4], [0.05, 0.02, 1.0], [-0.1, 0.1, 0.4]])


@pytest.fixture
def jax():
    """JAX in float64, which is put back."""
    module = pytest.importorskip("jax", reason="run by `make test-compat`")
    module.config.update("jax_enable_x64", True)
    yield module
    module.config.update("jax_enable_x64", False)


def flown(xp: Any, model: str, start: FloatArray, steps: int) -> Any:
    """The state (flights, 3, ...) after a hover over the starts, computed by a library."""
    body, gains = bodies_of(TEAM, xp), gains_of(xp=xp)
    air = partial(MODELS[model], air=aerodynamics_of(model, TEAM, xp))
    setpoint = Setpoint(*(xp.asarray(value) for value in Setpoint.hold(start)))
    state = reference.hovering(xp.asarray(start), body)
    if xp is np:
        for _ in range(steps):
            state = reference.step(state, setpoint, body, gains, air, air)
        return state
    import jax

    def step(state: Any, _: None) -> tuple[Any, None]:
        return reference.step(state, setpoint, body, gains, air, air), None

    return jax.jit(lambda state: jax.lax.scan(step, state, None, length=steps)[0])(state)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("model", MODELS)
def test_compiled_flights_are_those_of_numpy(model: str, jax: Any) -> None:
    start = START + np.random.default_rng(0).normal(0.0, 0.02, (16, 3, 3))
    found, expected = (flown(xp, model, start, 240) for xp in (jax.numpy, np))
    for name, mine, theirs in zip(found._fields, found, expected, strict=True):
        assert mine.dtype == np.float64
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-9, err_msg=name)
    assert np.abs(expected.position - start).max() > 1e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_vmap_and_gradients(jax: Any) -> None:
    """Flights one by one under vmap are those of the batch; the gradient is that of differences."""
    xp, start = jax.numpy, START + np.random.default_rng(1).normal(0.0, 0.02, (4, 3, 3))
    air = aerodynamics_of("learned", TEAM, xp)
    forces = partial(reference.learned, velocity=xp.zeros((3, 3)), air=air)
    batch = reference.learned(xp.asarray(start), xp.zeros_like(start), air)
    np.testing.assert_allclose(jax.vmap(forces)(xp.asarray(start)), batch, rtol=0, atol=1e-12)

    def lift(position: Any) -> Any:
        return xp.sum(forces(position)[..., 2] ** 2)

    place, way = xp.asarray(start[0]), np.random.default_rng(2).normal(size=(3, 3))
    slope = float(xp.sum(jax.grad(lift)(place) * way))
    difference = float(lift(place + 1e-6 * way) - lift(place - 1e-6 * way)) / 2e-6
    assert slope == pytest.approx(difference, rel=1e-5)


@pytest.mark.slow
def test_a_small_drone_sinks_in_crazyflow_as_it_does_here(tmp_path: Path) -> None:
    """In a process of its own: crazyflow has to be imported before SciPy, and writes a log."""
    if importlib.util.find_spec("crazyflow") is None:
        pytest.skip("run by `make test-compat`")
    example = [sys.executable, "-W", "ignore", str(ROOT / "examples" / "crazyflow_downwash.py")]
    done = subprocess.run(example, cwd=tmp_path, capture_output=True, text=True, check=True)
    there, here = map(float, re.findall(r"([\d.]+) cm", done.stdout))
    assert here > 10.0
    assert there == pytest.approx(here, rel=0.05)
