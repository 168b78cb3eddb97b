"""Every function and class of the public face, with every hostile value in every parameter."""

from __future__ import annotations

import resource

import pytest

from tests.robustness import surface
from tests.robustness.hostile import hostile_values, judge

SETTINGS = surface.settings()
LIMIT_BYTES = 16 * 2**30


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """Hostile values; and no more memory than a laptop has, for numbers that would fill it."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, before[1]))
    yield hostile_values(tmp_path_factory.mktemp("hostile"))
    resource.setrlimit(resource.RLIMIT_AS, before)


def faults(call: surface.Call, values: dict[str, object], parameters=None) -> list[str]:
    """What a function does with bad arguments that it should not, one at a time."""
    found = []
    for name in parameters or call.valid:
        words = (name, name.rstrip("s"), name.replace("_", " "))
        for kind, value in values.items():
            fault = judge(lambda: call.function(**{**call.valid, name: value}), words, value)  # noqa: B023
            if fault is not None:
                found.append(f"{name}={kind}: {fault}")
    return found


def test_every_public_name_is_called_or_says_why_not():
    called = {*SETTINGS, *surface.GIVEN, *surface.OWN}
    silent = {n for n in surface.public() if not surface.RESULTS.search(n)} - called
    assert silent <= set(surface.EXEMPT), f"neither called nor exempt: {silent}"
    assert set(surface.EXEMPT) <= set(surface.public()) - called, "exempt for nothing"


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_refuse_by_name(name, values):
    assert not faults(SETTINGS[name], values)


QUICK: tuple[str, ...] = (
    "parse_team",
    "rest_to_rest",
    "error_ball",
    "max_density",
    "building_columns",
    "agents.load",
)
QUICK += (
    "env.reset options",
    "TrackingAgent",
    "SafetyFilter",
    "read_trajectory",
    "read_table",
    "read_rows",
)


@pytest.mark.parametrize("name", QUICK)
def test_functions_refuse_by_name(name, values, tmp_path):
    assert not faults(surface.calls(tmp_path)[name], values)


OTHERS = [name for name in (*surface.GIVEN, *surface.OWN) if name not in QUICK]


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_all_other_functions_refuse_by_name(name, values, tmp_path):
    assert not faults(surface.calls(tmp_path)[name], values)
