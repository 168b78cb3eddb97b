"""The demonstration's flights: stacked swaps, each by two controllers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from swarm_envs.baselines.neural_swarm.flights import (
    PAPER_SWAP,
    RECOVERY_S,
    FlightTest,
    fly,
    progress_bar,
    swap_test,
)
from swarm_envs.control.config import ControllerConfig
from swarm_envs.interactions import InteractionModel
from swarm_envs.viewing.record import FlightRecord

SCENARIOS: Mapping[str, str] = {
    "S2S": "a small above a small",
    "L2S": "a large above a small",
    "SS2S": "two small above a small",
}
"""The teams, uppermost first, and what they are."""

HORIZON_S = PAPER_SWAP.duration_s[1] + RECOVERY_S
"""Length of a flight, s."""

CONTROLLERS = ("without", "compensated")
"""How the summary names the two sides."""

Flight = tuple[FlightRecord, dict[str, Any]]
"""What was seen of a flight, and its metrics."""


def fly_all(
    seeds: Sequence[int], belief: InteractionModel, engine: str, progress: bool
) -> dict[str, dict[str, list[Flight]]]:
    """Fly every scenario by both controllers, which differ in the believed force alone.

    Args:
        seeds: one for each swap.
        belief: what the compensating controller believes.
        engine: `bullet` or `batch`.
        progress: whether to show a progress bar on stderr.

    Returns:
        Flights by team and by controller.
    """
    controllers = (ControllerConfig(), ControllerConfig(feedforward=belief))
    tests = {team: swap_test(team, engine=engine) for team in SCENARIOS}
    total = sum(test.decisions for test in tests.values()) * len(seeds) * len(controllers)
    with progress_bar("flights", total, progress) as bar:
        return {
            team: {
                name: _fly_swaps(test, controller, seeds, bar.update)
                for name, controller in zip(CONTROLLERS, controllers, strict=True)
            }
            for team, test in tests.items()
        }


def _fly_swaps(
    test: FlightTest,
    controller: ControllerConfig,
    seeds: Sequence[int],
    tick: Callable[[int], object],
) -> list[Flight]:
    """Fly one stacked swap for each seed."""
    flights = fly(test, controller, seeds, tick)
    return [(flights.record(e), metrics) for e, metrics in enumerate(flights.metrics)]
