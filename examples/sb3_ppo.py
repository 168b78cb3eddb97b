"""Train one policy for all drones by PPO of Stable-Baselines3, with a batch of teams.

pip install 'swarm-envs[train]'
python examples/sb3_ppo.py --steps 200000
"""

from __future__ import annotations

import argparse

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from swarm_envs.training import SharedPolicyVecEnv


def main(arguments: list[str] | None = None) -> float:
    """Train, and return the mean episode reward at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000, help="decisions of single drones")
    parser.add_argument("--envs", type=int, default=64, help="number of teams in the batch")
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)  # several times as fast for networks of this size
    env = VecMonitor(
        SharedPolicyVecEnv(
            "swap_v1",
            num_envs=given.envs,
            seed=0,
            num_drones=4,
            action="acceleration",
            decision_rate=10,
            horizon_s=3.5,
        )
    )
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=1024,
        n_epochs=5,
        learning_rate=1e-3,
        gamma=0.98,
        seed=0,
        device="cpu",
    )
    model.learn(given.steps)
    env.close()
    rewards = [episode["r"] for episode in model.ep_info_buffer]
    return float(sum(rewards) / len(rewards))


if __name__ == "__main__":
    print(f"mean reward of an episode: {main():.2f}")
