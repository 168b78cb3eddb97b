"""Settings and fixtures of all tests: one thread, no display, the same examples in every run."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ["MPLBACKEND"] = "Agg"

# The first example of a property may compile a kernel, so none has a deadline.
settings.register_profile("swarm_envs", deadline=None, derandomize=True)
settings.load_profile("swarm_envs")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured data beside the checkout; the test is skipped where there is none."""
    folder = Path(__file__).parent.parent.parent / "shared"
    if not folder.is_dir():
        pytest.skip("no measured data beside the checkout (../shared)")
    return folder


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Calls the command line, which must end with one of these codes; what it said."""

    def say(*words: object, codes: tuple[int, ...] = (2,)) -> str:
        from swarm_envs.cli import main

        assert main([*map(str, words)]) in codes
        said = capsys.readouterr()
        return said.err + said.out

    return say


@pytest.fixture(params=["batch", "bullet"])
def engine(request: pytest.FixtureRequest) -> str:
    """Name of a physics engine; without pybullet, of the compiled one alone."""
    if request.param == "bullet":
        pytest.importorskip("pybullet")
    return request.param
