"""The demonstration's flights: stacked swaps, each by two controllers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tqdm import tqdm

from swarm_envs import swap_v0
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm.agent import TrackingAgent
from swarm_envs.interactions import InteractionModel
from swarm_envs.tasks.swap import StackedLayout
from swarm_envs.viewing.record import FlightRecord, Recorder

SCENARIOS: Mapping[str, str] = {
    "S2S": "a small above a small",
    "L2S": "a large above a small",
    "SS2S": "two small above a small",
}
"""The teams, uppermost first, and what they are."""

LAYOUT = StackedLayout(radius_m=(0.5, 0.5), duration_s=(4.0, 4.0))
"""The paper's slow swap: radius 0.5 m in 4 s. Plane distance and direction are drawn."""

HORIZON_S = 6.0
"""Two seconds more than the swap takes, to see the drones recover."""

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
    agents = (TrackingAgent(), TrackingAgent.compensated(belief))
    total = len(seeds) * len(agents) * len(SCENARIOS)
    with tqdm(
        total=total, desc="flights", unit="flight", mininterval=0.5, disable=not progress
    ) as bar:
        return {
            team: {
                name: fly_swaps(team, agent, seeds, engine, bar.update)
                for name, agent in zip(CONTROLLERS, agents, strict=True)
            }
            for team in SCENARIOS
        }


def fly_swaps(
    team: str,
    agent: TrackingAgent,
    seeds: Sequence[int],
    engine: str,
    tick: Callable[[], object] = lambda: None,
) -> list[Flight]:
    """Fly one stacked swap for each seed; `tick` is called after each.

    Returns:
        The record and the episode's metrics of each flight.
    """
    required: dict[str, Any] = dict(agent.requires)
    env = swap_v0.parallel_env(
        team=team,
        layout="stacked",
        physics=engine,
        stacked=LAYOUT,
        end_on_success=False,
        horizon_s=HORIZON_S,
        **required,
    )
    flights: list[Flight] = []
    try:
        for seed in seeds:
            recorder = Recorder()
            metrics = fly_episode(env, agent, seed, watch=recorder)
            flights.append((recorder.record(), metrics))
            tick()
    finally:
        env.close()
    return flights
