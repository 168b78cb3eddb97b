"""Functions of the public face, with every hostile value in every parameter."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from tests.robustness import surface
from tests.robustness.hostile import hostile_values, judge

LIMIT_BYTES = 8 * 2**30


@pytest.fixture
def values(tmp_path_factory):
    """Hostile values; and little more memory than is used, for numbers that would fill it.

    Files are made anew for each test: a function that writes takes some of them.
    """
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, before[1]))
    yield hostile_values(tmp_path_factory.mktemp("hostile"))
    resource.setrlimit(resource.RLIMIT_AS, before)


def faults(call: surface.Call, values: dict[str, object]) -> list[str]:
    """What a function does with bad arguments that it should not, one at a time."""
    found = []
    for name in call.valid:
        words = (name, name.rstrip("s"), name.replace("_", " "))
        for kind, value in values.items():
            fault = judge(lambda: call.function(**{**call.valid, name: value}), words, value)  # noqa: B023
            if fault is not None:
                found.append(f"{name}={kind}: {fault}")
    return found


QUICK = {
    "parse_team",
    "rest_to_rest",
    "error_ball",
    "max_density",
    "building_columns",
    "agents.load",
}
QUICK |= {"env.reset options", "TrackingAgent", "SafetyFilter"}
QUICK |= {"read_trajectory", "read_table", "read_rows", "read_pieces"}
QUICK |= {"ramped_line", "team_string", "task_family", "evaluate", "flight_along", "settled"}
NAMES = [
    pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in surface.calls(Path())
]


def test_every_listed_function_is_called_or_says_why_not(tmp_path):
    called = {name.rpartition(".")[2] for name in surface.calls(tmp_path)}
    excepted = {name for names in surface.NOT_CALLED.values() for name in names}
    assert called.isdisjoint(excepted) and excepted <= surface.listed_functions()
    assert surface.listed_functions() <= called | excepted


@pytest.mark.parametrize("name", NAMES)
def test_functions_refuse_by_name(name, values, tmp_path):
    assert not faults(surface.calls(tmp_path)[name], values)
