"""What the limit study varies, one thing at a time: each point is one set of flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from swarm_envs.baselines.neural_swarm.agent import load_belief
from swarm_envs.baselines.neural_swarm.flights import PAPER_SWAP, FlightTest, swap_test
from swarm_envs.control.config import ControllerConfig
from swarm_envs.envs.randomization import Randomization
from swarm_envs.interactions import InteractionModel, load
from swarm_envs.training.reproduce.studies.imperfect import NOTHING, Imperfection
from swarm_envs.vehicles import GRAVITY, SMALL, Team, parse_team

TRUTH = "learned"
"""The force model that blows."""
BELIEFS: Mapping[str, Callable[[], InteractionModel | None]] = {
    "none": lambda: None,
    "exact": lambda: load(TRUTH),
    "shipped": lambda: load_belief(TRUTH),
}
"""What controllers believe: nothing (the baseline), the force that blows (an oracle), or what was
learned from flights in it."""


@dataclass(frozen=True)
class Point:
    """One set of flights."""

    cell: str
    """Its name; points of one name are the same flights."""
    case: str
    """What flies, for people."""
    value: float
    """What the sweep varies, in its unit."""
    belief: str
    """One of `BELIEFS`."""
    test: FlightTest
    """Team, swaps, air."""
    imperfection: Imperfection = NOTHING
    """What is spoiled."""

    @property
    def controller(self) -> ControllerConfig:
        """Default gains, with what is believed."""
        return ControllerConfig(feedforward=BELIEFS[self.belief]())


@dataclass(frozen=True)
class Sweep:
    """One thing that is varied."""

    name: str
    """In tables and files."""
    label: str
    """Of the axis, with the unit."""
    points: Sequence[Point]
    """What is flown, one after another."""


_CASES = ("S2S", "L2S")


def _spoiled(
    name: str,
    label: str,
    values: Sequence[float],
    spoil: Callable[[float], Imperfection],
    sensed: bool = False,
) -> Sweep:
    """A sweep of one imperfection of an exact belief; what sensors spoil, the baseline suffers."""
    points = []
    for case in _CASES:
        test = swap_test(case, truth=TRUTH)
        for x in values:
            cell = f"{name} {x:g}: {case}"
            alone = cell if sensed else f"unspoiled: {case}"
            told = spoil(x) if sensed else NOTHING
            points.append(Point(f"{alone}, none", case, x, "none", test, told))
            points.append(Point(f"{cell}, exact", case, x, "exact", test, spoil(x)))
    return Sweep(name, label, points)


def _flown(name: str, label: str, cases: Mapping[str, Mapping[float, FlightTest]]) -> Sweep:
    """A sweep of what is flown, by the baseline and both beliefs."""
    points = [
        Point(f"{name} {x:g}: {case}, {belief}", case, x, belief, test)
        for case, tests in cases.items()
        for x, test in tests.items()
        for belief in BELIEFS
    ]
    return Sweep(name, label, points)


def _weaker(team: str, ratio: float) -> Team:
    """The team with its lowest drone, a small one, at another thrust-to-weight ratio."""
    lowest = replace(SMALL, max_thrust=ratio * SMALL.mass * GRAVITY)
    return (*parse_team(team)[:-1], lowest)


def _thrust(case: str) -> dict[float, FlightTest]:
    ratios = (1.2, 1.3, 1.4, 1.5, 1.7, 1.91, 2.6)
    return {r: swap_test(_weaker(case, r), truth=TRUTH) for r in ratios}


def _many(token: str) -> dict[float, FlightTest]:
    return {float(n): swap_test(token * n + "2S", truth=TRUTH) for n in (1, 2, 3, 4, 5)}


def _planes(case: str) -> dict[float, FlightTest]:
    layouts = {gap: replace(PAPER_SWAP, gap_m=(gap, gap)) for gap in (0.2, 0.3, 0.4, 0.6, 0.8, 1.0)}
    return {gap: swap_test(case, layout, TRUTH) for gap, layout in layouts.items()}


def _air(case: str) -> dict[float, FlightTest]:
    test, strengths = swap_test(case, truth=TRUTH), (0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
    return {x: replace(test, randomization=Randomization(force_scale=(x, x))) for x in strengths}


def all_sweeps() -> tuple[Sweep, ...]:
    """Every sweep of the study."""
    return (
        _spoiled(
            "scale",
            "Believed over true force",
            (0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0, 2.5),
            lambda x: Imperfection(scale=x),
        ),
        _spoiled(
            "noise",
            "Noise of the belief below 5 Hz, rms (g)",
            (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
            lambda x: Imperfection(noise_g=x),
        ),
        _spoiled(
            "delay",
            "Delay of the belief (ms)",
            (0.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0),
            lambda x: Imperfection(delay_s=1e-3 * x),
        ),
        _spoiled(
            "velocity noise",
            "White noise of velocities (cm/s)",
            (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0),
            lambda x: Imperfection(velocity_noise=1e-2 * x),
            sensed=True,
        ),
        _spoiled(
            "position noise",
            "White noise of positions (mm)",
            (0.0, 3.0, 10.0, 15.0, 20.0, 30.0),
            lambda x: Imperfection(position_noise_m=1e-3 * x),
            sensed=True,
        ),
        _flown("air", "Force that blows over believed", {case: _air(case) for case in _CASES}),
        _flown(
            "thrust",
            "Thrust over weight of the lowest drone",
            {case: _thrust(case) for case in ("L2S", "LL2S")},
        ),
        _flown(
            "neighbours",
            "Drones above the lowest",
            {f"{token} above S": _many(token) for token in "SL"},
        ),
        _flown(
            "plane distance",
            "Distance between planes (m)",
            {case: _planes(case) for case in _CASES},
        ),
    )
