"""Train a network by DAgger in one file, with torch and the vector interface.

pip install torch swarm-envs
python examples/dagger.py --steps 400000 --teacher roundabout

The network acts, and a scripted agent, the teacher, labels every decision with its action (Ross et
al., 2011). One small network encodes each neighbor together with the drone's own features, and the
codes are pooled: a deep set, which controls teams of any size.
"""

from __future__ import annotations

import argparse
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn

from swarm_envs import swap_v1
from swarm_envs.agents import load
from swarm_envs.agents.features import MASK, feature_sizes, features_of

DECISIONS, BATCHES, BATCH, MEMORY, RATE = 10, 12, 1024, 200_000, 2e-3
OWN, NEIGHBOR = feature_sizes(0).own, feature_sizes(0).neighbor


class DeepSet(nn.Module):
    """A map from the features of a drone to its action."""

    def __init__(self, actions: int) -> None:
        super().__init__()
        seen = OWN + NEIGHBOR
        self.phi = nn.Sequential(nn.Linear(seen, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU())
        self.rho = nn.Sequential(
            *(nn.Linear(OWN + 128, 128), nn.ReLU()),
            *(nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, actions)),
        )

    def forward(self, features: Tensor) -> Tensor:
        """Return actions (B, width) for features (B, own + K neighbors)."""
        own = features[:, :OWN]
        around = features[:, OWN:].reshape(len(own), -1, NEIGHBOR)
        beside = own[:, None].expand(-1, around.shape[1], -1)
        codes = self.phi(torch.cat([beside, around], dim=-1)) * around[..., MASK, None]
        return self.rho(torch.cat([own, codes.amax(dim=1), codes.sum(dim=1)], dim=-1))


class Teams:
    """E teams of N drones that a network or its teacher controls."""

    def __init__(self, teacher: str, envs: int, drones: int, seed: int = 0) -> None:
        self.agent = load(teacher)
        if not hasattr(self.agent, "act_batch"):
            raise SystemExit(f"the teacher {teacher!r} has no act_batch; choose 'fast-line'")
        options: dict[str, Any] = {"num_drones": drones, "force_rate": 48, "horizon_s": 6.0}
        options |= self.agent.requires
        self.neighbors = options.setdefault("num_neighbors", 7)
        one = swap_v1.parallel_env(**options)  # tells the teacher the layout of the rows
        one.reset(seed=seed)
        self.agent.reset(one, seed)
        self.env = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=envs, **options)
        self.shape = (envs, drones, -1)
        self.rows = self.env.reset(seed=seed)[0].reshape(self.shape)
        self.begins = np.zeros(envs, dtype=bool)
        self.ends: list[bool] = []
        self.rng = np.random.default_rng(seed)

    def features(self) -> Tensor:
        """Return the features (E * N, width) of all drones."""
        return torch.from_numpy(features_of(self.rows, self.neighbors)).flatten(0, 1)

    def step(self, own: np.ndarray, guided: float) -> tuple[np.ndarray, np.ndarray]:
        """Step; return the teacher's actions (E * N, width) and which of them are valid.

        The step after the end of an episode begins the next one and ignores actions.
        """
        labels = np.clip(self.agent.act_batch(self.rows), -1.0, 1.0)
        guided_teams = self.rng.random((len(labels), 1, 1)) < guided
        actions = np.where(guided_teams, labels, own.reshape(self.shape))
        actions[::3] += self.rng.normal(0.0, 0.1, actions[::3].shape)  # for states off the path
        actions = np.clip(actions, -1.0, 1.0).astype(np.float32)
        rows, _, ended, cut, infos = self.env.step(actions.reshape(self.env.action_space.shape))
        self.rows, useful = rows.reshape(self.shape), ~self.begins
        self.begins = ended | cut
        if self.begins.any():
            self.ends += infos["episode_metrics"]["success"][self.begins].tolist()
        return labels.reshape(-1, labels.shape[-1]), np.repeat(useful, self.shape[1])


class Memory:
    """The latest decisions: features, and actions of the teacher."""

    def __init__(self) -> None:
        self.seen, self.labels = torch.zeros(0), torch.zeros(0)

    def add(self, seen: Tensor, labels: Tensor) -> None:
        """Add rows, and drop the oldest."""
        before = (self.seen, self.labels) if len(self.seen) else (seen[:0], labels[:0])
        self.seen = torch.cat([before[0], seen])[-MEMORY:]
        self.labels = torch.cat([before[1], labels])[-MEMORY:]


def learn(net: DeepSet, adam: torch.optim.Optimizer, memory: Memory) -> float:
    """Take some gradient steps, and return the mean loss."""
    losses = []
    for _ in range(BATCHES):
        chosen = torch.randint(len(memory.seen), (BATCH,))
        loss = nn.functional.huber_loss(net(memory.seen[chosen]), memory.labels[chosen], delta=0.1)
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses))


def main(arguments: list[str] | None = None) -> list[float]:
    """Train, and return the loss after every ten decisions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400_000, help="decisions of single drones")
    parser.add_argument("--envs", type=int, default=64, help="number of teams in the batch")
    parser.add_argument("--drones", type=int, default=8, help="number of drones of a team")
    parser.add_argument("--teacher", default="roundabout", help="name of an agent with act_batch")
    given = parser.parse_args(arguments)
    torch.manual_seed(0)
    torch.set_num_threads(1)
    teams, memory, curve = Teams(given.teacher, given.envs, given.drones), Memory(), []
    net = DeepSet(3)
    rounds = max(1, given.steps // (DECISIONS * given.envs * given.drones))
    adam = torch.optim.Adam(net.parameters(), lr=RATE)
    slower = torch.optim.lr_scheduler.CosineAnnealingLR(adam, rounds, 0.02 * RATE)
    for k in range(rounds):
        for _ in range(DECISIONS):
            seen = teams.features()
            with torch.no_grad():
                own = net(seen).numpy()
            labels, useful = teams.step(own, max(0.0, 1.0 - 8.0 * k / rounds))
            memory.add(seen[useful], torch.from_numpy(labels[useful]).float())
        curve.append(learn(net, adam, memory))
        slower.step()
        recent = float(np.mean(teams.ends[-100:] or [0.0]))
        print(f"{k + 1}/{rounds}: loss {curve[-1]:.4f}, success {recent:.0%}", flush=True)
    return curve


if __name__ == "__main__":
    main()
