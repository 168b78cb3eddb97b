"""Record flights of an agent as a Minari dataset for offline reinforcement learning.

    pip install 'swarm-envs[minari]'
    python examples/record_minari.py --agent roundabout --drones 8 --name swap/eight-v0

prints the number of successful flights, the path of the dataset, and the call that loads it. An
episode is one flight of the team through the joint Gymnasium interface; `infos["success"]` is the
success of the flight. Minari stores datasets in `~/.minari/datasets`, or in the folder of the
environment variable MINARI_DATASETS_PATH. `dataset.recover_environment()` makes the environment, in
which the seed and the actions of an episode reproduce its observations.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from typing import Any

import gymnasium
import minari
import numpy as np
import tyro
from minari.data_collector import EpisodeBuffer
from tqdm import tqdm

import swarm_envs  # noqa: F401  (registers the environments)
from swarm_envs.agents import load
from swarm_envs.errors import check_integer, check_name

NAME = re.compile(r"([\w-]{2,}(/[\w-]+)*/)?[\w-]+-v\d+")  # ids of datasets in Minari


@dataclass(frozen=True)
class Options:
    """Options of the recording."""

    env: str = "swarm_envs/Swap-v1"
    """Gymnasium id of an environment with joint actions of a team"""
    agent: str = "roundabout"
    """name of an agent, or the folder of a trained policy"""
    drones: int = 4
    """number of drones"""
    episodes: int = 64
    """number of flights"""
    seed: int = 0
    """random seed of the first flight; further flights count up from it"""
    name: str = "swap/roundabout-v0"
    """id of the dataset: `namespace/dataset-v0` or `dataset-v0`"""

    def __post_init__(self) -> None:
        """Raise an error for invalid values."""
        for name in ("drones", "episodes"):
            check_integer(f"--{name.replace('_', '-')}", getattr(self, name), at_least=1)
        check_integer("--seed", self.seed, at_least=0)


def fly(env: Any, agent: Any, seed: int) -> EpisodeBuffer:
    """Fly one episode and return its buffer for Minari."""
    parallel = env.unwrapped.parallel
    observation, _ = env.reset(seed=seed)
    agent.reset(parallel, seed)
    steps, ended = [], False
    while not ended:
        rows = observation.reshape(1, len(parallel.possible_agents), -1)
        actions = agent.act(parallel.split(rows), parallel.view if agent.privileged else None)
        joint = np.concatenate([*actions.values()]).astype(np.float32)
        before = observation
        observation, reward, terminated, truncated, info = env.step(joint)
        steps.append((before, joint, reward, terminated, truncated))
        ended = terminated or truncated
    observations, joints, rewards, terminations, truncations = zip(*steps, strict=True)
    success = np.full(len(steps) + 1, info["episode_metrics"]["success"], dtype=bool)
    return EpisodeBuffer(
        seed=seed,
        observations=np.stack([*observations, observation]),
        actions=np.stack(joints),
        rewards=[*rewards],
        terminations=[*terminations],
        truncations=[*truncations],
        infos={"success": success},
    )


def check(options: Options) -> None:
    """Check the name and the environment before the first flight.

    Raises:
        ValueError: the name is invalid or exists, or the environment has no joint actions.
    """
    if not NAME.fullmatch(options.name):
        raise ValueError(
            f"--name is {options.name!r}, but must be letters, digits, '-' and '_' and end in a "
            "version, after a namespace of two characters or more if any, such as 'swap/mine-v0'"
        )
    if options.name in minari.list_local_datasets():
        raise ValueError(f"there is a dataset {options.name!r} already; choose another --name")
    own = [name for name in gymnasium.registry if name.startswith("swarm_envs/")]
    check_name("--env", options.env, [name for name in own if "Solo-" not in name])


def main(options: Options) -> float:
    """Record the dataset and return the fraction of flights that succeeded."""
    check(options)
    agent: Any = load(options.agent)
    requires = dict(agent.requires)
    if "controller" in requires:  # Minari saves options as JSON, which can hold a name
        requires["controller"] = options.agent
    env = gymnasium.make(options.env, num_drones=options.drones, physics="batch", **requires)
    seeds = range(options.seed, options.seed + options.episodes)
    with tqdm(seeds, unit="flight") as bar:
        flights = [fly(env, agent, seed) for seed in bar]
    about = {"algorithm_name": options.agent, "requirements": ["swarm-envs"]}
    dataset = minari.create_dataset_from_buffers(options.name, flights, env=env, **about)
    env.close()
    successes = sum(bool(flight.infos["success"][-1]) for flight in flights)
    print(f"{successes} of {options.episodes} flights succeeded; wrote {dataset.storage.data_path}")
    print(f"load it by: minari.load_dataset({options.name!r})")
    return successes / options.episodes


if __name__ == "__main__":
    try:
        main(tyro.cli(Options, description=__doc__))
    except (ImportError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
