"""Measure time and success of the planner: a three-robot swap, and flights.

    python benchmarks/planning.py [--seeds 20] [--json FILE]
    python benchmarks/planning.py --task swap --layout random --drones 4 [--seeds 20]

Times are CPU times of one thread.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.rows import Row, sentence
from swarm_envs import make
from swarm_envs.agents import fly_episode
from swarm_envs.baselines.neural_swarm import SwarmPlan, plan_swarm
from swarm_envs.baselines.neural_swarm.agent import PlanAgent
from swarm_envs.baselines.neural_swarm.planner import PlanningProblem
from swarm_envs.baselines.neural_swarm.planner.scp import StepRecord, refine
from swarm_envs.baselines.neural_swarm.planner.trajectories import straight_lines
from swarm_envs.files import write_json
from swarm_envs.interactions import load
from swarm_envs.vehicles import parse_team

STARTS = np.array([[0.0, -1.0, 1.2], [0.0, 1.0, 1.2], [0.0, 0.0, 1.2]])
GOALS = STARTS[[1, 2, 0]]
TEAM = "SSL"


def plan_row(seed: int) -> Row:
    """Both stages of the three-robot swap in the y-z plane."""
    begin = time.thread_time()
    plan = plan_swarm(STARTS, GOALS, TEAM, "learned", seed=seed, plane="yz")
    return {"what": "three-robot swap", "seed": seed, "s": time.thread_time() - begin} | about(plan)


def about(plan: SwarmPlan) -> Row:
    """The numbers of a plan in a row."""
    return {
        "success": plan.converged,
        "status": plan.status,
        "attempts": plan.search.get("attempt", 0) + 1,
        "energy": plan.trajectories.energy,
        "force_ratio": plan.check.force_ratio,
        "programs": len(plan.history),
    }


def step_times(team: str, plane: Any, seed: int) -> list[float]:
    """CPU times of the steps of one refinement at 60 knots, ms: derivatives, program, merit."""
    count = len(parse_team(team))
    starts = np.array([[0.0, y, 1.2] for y in 0.7 * (np.arange(count) - 0.5 * (count - 1))])
    goals = np.roll(starts, 1, axis=0)
    problem = PlanningProblem(
        starts, goals, parse_team(team), load("learned"), max_duration=6.0, plane=plane
    )
    bend = 0.3 * np.random.default_rng(seed).standard_normal(starts.shape)
    bend[:, 0] *= plane == "xyz"
    times = [time.thread_time()]

    def tick(_: StepRecord) -> None:
        times.append(time.thread_time())

    refine(problem, straight_lines(problem, bend=bend), np.random.default_rng(seed), watch=tick)
    return [1e3 * step for step in np.diff(times)]


def step_row(team: str, plane: str, seeds: int) -> Row:
    """Steps of stage 2 over several refinements."""
    found = np.concatenate([step_times(team, plane, seed) for seed in range(seeds)])
    low, middle, high = np.quantile(found, (0.05, 0.5, 0.95))
    return {"what": f"step, {team}, {plane}", "ms": middle, "low": low, "high": high}


def flight_rows(task: str, layout: str, drones: int, seeds: int) -> list[Row]:
    """Flights of the planning agent."""
    agent, rows = PlanAgent(), []
    which = {"layout": layout} if task == "swap_v1" else {"labels": layout}
    env = make(task, num_drones=drones, physics="batch", **which, **agent.requires)
    for seed in tqdm(range(seeds), unit="flight"):
        metrics = fly_episode(env, agent, seed=seed)
        rows.append(
            {
                "what": f"{task}, {layout}, {drones} drones",
                "seed": seed,
                "success": bool(metrics["success"]),
                "planned": all(plan.converged for plan in agent.plans),
                "s": sum(sum(plan.seconds.values()) for plan in agent.plans),
                "least_distance_m": metrics["minimum_separation_m"],
            }
        )
    return rows


def table(rows: list[Row]) -> str:
    """The rows as text, one line each, and how many succeeded."""
    lines = [*map(sentence, rows)]
    done = [row["success"] for row in rows if "success" in row]
    spent = [row["s"] for row in rows if "s" in row]
    if done:
        lines.append(f"success {sum(done)} of {len(done)}")
        lines.append(f"time: median {np.median(spent):.2f} s, worst {max(spent):.2f} s")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=20, help="plans or flights (default 20)")
    parser.add_argument("--task", choices=("swap", "formation"), help="fly the agent instead")
    parser.add_argument("--layout", default="random", help="of the task; formation: its labels")
    parser.add_argument("--drones", type=int, default=4, help="of the task (default 4)")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    options = parser.parse_args(arguments)
    if options.seeds < 1:
        parser.error(f"--seeds is {options.seeds}, but must be at least 1")
    if options.task:
        rows = flight_rows(f"{options.task}_v1", options.layout, options.drones, options.seeds)
    else:
        plan_row(0)  # compiles
        rows = [plan_row(seed) for seed in tqdm(range(options.seeds), unit="plan")]
        rows += [step_row(team, plane, 3) for team, plane in (("SSL", "yz"), ("SSLS", "xyz"))]
    print(table(rows))
    if options.json is not None:
        write_json(options.json, rows)


if __name__ == "__main__":
    main()
