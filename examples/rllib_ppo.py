"""Train one policy for all drones by PPO of RLlib (new API stack), on any Ray cluster.

    pip install 'swarm-envs[train]' 'ray[rllib]'
    python examples/rllib_ppo.py --out runs/rllib --steps 1000000 --runners 8
    swarm-envs evaluate --agent runs/rllib

`swarm-envs train` learns faster on one machine: it has tuned defaults, and simulates all teams in
one batch.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo.utils import BaseParallelWrapper
from tqdm import tqdm

from swarm_envs import __version__, swap_v1
from swarm_envs.agents.features import feature_sizes, features_of
from swarm_envs.agents.networks import Layers, Network
from swarm_envs.agents.policy import FILE, Policy, PolicyNote, write_policy
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.errors import check_integer, check_number
from swarm_envs.files import claimed, write_json
from swarm_envs.training.rl.validation import evaluate_policy, validation_seeds

TASK, ENVIRONMENT, SHARED = "swap_v1", "swarm-envs-swap", "all"
"""The task, its name in RLlib, and the name of the shared policy."""


@dataclass(frozen=True, kw_only=True)
class RllibConfig:
    """Train one policy for all drones by RLlib's PPO, for `swarm-envs evaluate`."""

    out: Path
    """folder for policy.safetensors and report.json"""
    drones: int = 4
    """number of small drones, in training and of the policy"""
    steps: int = 1_000_000
    """decisions of single drones, rounded up to whole batches"""
    seed: int = 0
    """random seed of weights, episodes and exploration"""
    runners: int = 0
    """number of Ray actors that sample, one processor each; 0 for this process"""
    ray: str | None = None
    """address of a cluster, or `auto`; a cluster on this machine by default"""
    layout: str = "random"
    """layout of the task"""
    interactions: str = "learned"
    """interaction force model: `none`, `wake`, `learned`, or a file"""
    horizon_s: float = 3.5
    """time limit of training episodes, s"""
    num_neighbors: int = 3
    """number of neighbors that a drone observes"""
    hidden: tuple[int, ...] = (64, 64)
    """widths of the hidden layers of actor and critic, which are separate"""
    batch: int = 4096
    """number of team decisions between two updates"""
    minibatch: int = 2048
    """number of decisions of drones in a gradient step"""
    passes: int = 5
    """number of passes over a batch"""
    learning_rate: float = 5e-4
    """learning rate of Adam"""
    evaluation_episodes: int = 256
    """number of episodes in which the policy is evaluated at the end"""

    def __post_init__(self) -> None:
        """Raise an error for invalid values."""
        for name in ("drones", "steps", "batch", "minibatch", "passes", "evaluation_episodes"):
            check_integer(f"--{name.replace('_', '-')}", getattr(self, name), at_least=1)
        for name in ("seed", "runners", "num_neighbors"):
            check_integer(f"--{name.replace('_', '-')}", getattr(self, name), at_least=0)
        for name in ("horizon_s", "learning_rate"):
            check_number(f"--{name.replace('_', '-')}", getattr(self, name), above=0.0)
        for width in self.hidden:
            check_integer("--hidden", width, at_least=1)
        if not self.hidden:
            raise ValueError("--hidden is (), but must be one or more widths")

    def note(self) -> PolicyNote:
        """Return the environment that the policy requires."""
        count = self.drones
        return PolicyNote(TASK, count, "acceleration", 10, self.num_neighbors, fewest=count)


class FeatureEnv(BaseParallelWrapper):  # PettingZoo has no types
    """A wrapper that observes the features of each drone's row, as the included policies do."""

    def __init__(self, env: SwarmParallelEnv) -> None:
        super().__init__(env)
        self._num_neighbors = env.core.config.num_neighbors

    def observation_space(self, agent: str) -> spaces.Box:
        """Return the space of the features, equal for all drones."""
        width = feature_sizes(self._num_neighbors).width
        return spaces.Box(-np.inf, np.inf, (width,), np.float32)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Float32Array], dict[str, Any]]:
        """Reset the environment."""
        rows, infos = self.env.reset(seed=seed, options=options)
        return self._features(rows), infos

    def step(self, actions: Mapping[str, Float32Array]) -> tuple[Any, ...]:
        """Step the environment."""
        rows, *rest = self.env.step(actions)
        return self._features(rows), *rest

    def _features(self, rows: Mapping[str, Float32Array]) -> dict[str, Float32Array]:
        found = features_of(np.stack(list(rows.values())), self._num_neighbors)
        return dict(zip(rows, found, strict=True))


def make_env(options: Mapping[str, Any]) -> Any:
    """Return the environment for RLlib, which calls this on every runner."""
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    return ParallelPettingZooEnv(FeatureEnv(swap_v1.parallel_env(**options)))


def algorithm_config(config: RllibConfig) -> Any:
    """Return RLlib's configuration: PPO, one module for all drones, tanh networks."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

    options = {"num_drones": config.drones, "layout": config.layout, "horizon_s": config.horizon_s}
    options |= {"interactions": config.interactions, "num_neighbors": config.num_neighbors}
    options |= {"action": "acceleration", "decision_rate": 10, "force_rate": 48, "physics": "batch"}
    return (
        PPOConfig()
        .environment(ENVIRONMENT, env_config=options)
        .env_runners(num_env_runners=config.runners)
        .learners(num_learners=0)
        .training(
            train_batch_size_per_learner=config.batch,
            minibatch_size=config.minibatch,
            num_epochs=config.passes,
            lr=config.learning_rate,
            gamma=0.98,
            lambda_=0.95,
            clip_param=0.2,
            entropy_coeff=0.003,
            use_kl_loss=False,
        )
        .multi_agent(policies={SHARED}, policy_mapping_fn=lambda agent, episode: SHARED)
        .rl_module(
            model_config=DefaultModelConfig(
                fcnet_hiddens=list(config.hidden), fcnet_activation="tanh", vf_share_layers=False
            )
        )
        .debugging(seed=config.seed)
    )


def actor(module: Any, width: int) -> Layers:
    """Return the layers of RLlib's actor, for the mean of actions only.

    Args:
        module: a module with separate tanh encoders for actor and critic, and linear heads.
        width: the width of an action; further outputs of the head are deviations.

    Raises:
        ValueError: the module has other layers.
    """
    state = {name: value.detach().cpu().numpy() for name, value in module.state_dict().items()}
    names = [n for n in state if n.startswith(("encoder.actor_encoder.", "pi."))]
    weights = [n for n in names if re.fullmatch(r".*\.net\.mlp\.\d+\.weight", n)]
    known = {n.removesuffix("weight") + part for n in weights for part in ("weight", "bias")}
    if not weights or known ^ (set(names) - {"pi.log_std_clip_param_const"}):
        raise ValueError(f"this actor is not a plain MLP: {', '.join(names)}")
    layers = [(state[n], state[n.removesuffix("weight") + "bias"]) for n in weights]
    *hidden, (head, bias) = layers
    return (*hidden, (head[:width], bias[:width]))


def train_with_rllib(config: RllibConfig) -> dict[str, Any]:
    """Train, write the policy after every batch, evaluate it at the end, and return the report.

    The last policy remains if the training is interrupted. RLlib's own checkpoints contain pickles
    and are not used, so that a run cannot be resumed.

    Raises:
        BlockingIOError: another process writes into the folder.
        ImportError: RLlib is not installed.
    """
    try:
        import ray
        from ray.tune.registry import register_env
    except ImportError as error:
        raise ImportError("RLlib is not installed; run: pip install 'ray[rllib]'") from error
    begun = time.monotonic()
    with claimed(config.out):
        ray.init(address=config.ray or "local", ignore_reinit_error=True, logging_level="WARNING")
        register_env(ENVIRONMENT, make_env)
        policy = _learn(config, algorithm_config(config).build_algo())
        options = {"num_drones": config.drones, "interactions": config.interactions}
        seeds = validation_seeds(config.evaluation_episodes)
        chosen = evaluate_policy(policy, TASK, (config.layout,), seeds, options)
        report = {**policy.provenance, "chosen": chosen}
        report["wall_s"] = round(time.monotonic() - begun, 1)
        write_json(config.out / "report.json", report)
    return report


def _learn(config: RllibConfig, algorithm: Any) -> Policy:
    steps, options = 0, {**asdict(config), "out": str(config.out), "trainer": "rllib-ppo"}
    with tqdm(total=config.steps, unit="step", unit_scale=True, desc="train") as bar:
        while steps < config.steps:
            result = algorithm.train()["env_runners"]
            steps = config.drones * int(result["num_env_steps_sampled_lifetime"])
            bar.set_postfix_str(f"return {result['episode_return_mean']:.2f}", refresh=False)
            bar.update(steps - bar.n)
            about = {"config": options, "steps": steps, "version": __version__}
            network = Network(actor(algorithm.get_module(SHARED), 3))
            policy = Policy(config.note(), network, about)
            write_policy(config.out / FILE, policy)
    algorithm.stop()
    return policy


def _main() -> None:
    import tyro

    config = tyro.cli(RllibConfig, prog="python examples/rllib_ppo.py")
    try:
        report = train_with_rllib(config)
    except (ImportError, OSError) as error:
        sys.exit(f"error: {error}")
    tqdm.write(f"{report['steps']:,} steps in {report['wall_s']:.0f} s")
    for name, rate in report["chosen"].items():
        tqdm.write(f"  {name}: {rate:.1%}")
    tqdm.write(f"evaluate it by: swarm-envs evaluate --agent {config.out} --drones {config.drones}")


if __name__ == "__main__":
    _main()
