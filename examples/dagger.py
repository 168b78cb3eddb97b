"""DAgger in one file: a network imitates an agent, torch alone, on our vector interface.

pip install torch swarm-envs
python examples/dagger.py --steps 400000 --teacher roundabout

The network flies and the teacher says at every decision what it would have done (Ross et al.,
2011). Every neighbour goes through the same small network beside the drone's own numbers, and what
comes out is pooled: a deep set, which flies teams of any size.
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
        """Actions (B, width) for features (B, own + K neighbours)."""
        own = features[:, :OWN]
        around = features[:, OWN:].reshape(len(own), -1, NEIGHBOR)
        beside = own[:, None].expand(-1, around.shape[1], -1)
        codes = self.phi(torch.cat([beside, around], dim=-1)) * around[..., MASK, None]
        return self.rho(torch.cat([own, codes.amax(dim=1), codes.sum(dim=1)], dim=-1))


class Teams:
    """E teams of N drones that fly by a network or by the agent that teaches it."""

    def __init__(self, teacher: str, envs: int, drones: int, seed: int = 0) -> None:
        self.agent = load(teacher)
        if not hasattr(self.agent, "act_batch"):
            raise SystemExit(f"{teacher!r} has no act_batch and cannot teach; take 'fast-line'")
        options: dict[str, Any] = {"num_drones": drones, "force_rate": 48, "horizon_s": 6.0}
        options |= self.agent.requires
        self.neighbors = options.setdefault("num_neighbors", 7)
        one = swap_v1.parallel_env(**options)  # from which the teacher learns what rows hold
        one.reset(seed=seed)
        self.agent.reset(one, seed)
        self.env = gymnasium.make_vec("swarm_envs/Swap-v1", num_envs=envs, **options)
        self.shape = (envs, drones, -1)
        self.rows = self.env.reset(seed=seed)[0].reshape(self.shape)
        self.begins = np.zeros(envs, dtype=bool)
        self.ends: list[bool] = []
        self.rng = np.random.default_rng(seed)

    def features(self) -> Tensor:
        """(E * N, width) of what every drone observes."""
        return torch.from_numpy(features_of(self.rows, self.neighbors)).flatten(0, 1)

    def step(self, own: np.ndarray, guided: float) -> tuple[np.ndarray, np.ndarray]:
        """Fly; return the teacher's actions (E * N, width) and which of them mean anything.

        The step after an episode's end begins the next one, whatever the action is.
        """
        wanted = np.clip(self.agent.act_batch(self.rows), -1.0, 1.0)
        taught = self.rng.random((len(wanted), 1, 1)) < guided
        flown = np.where(taught, wanted, own.reshape(self.shape))
        flown[::3] += self.rng.normal(0.0, 0.1, flown[::3].shape)  # to learn to come back
        flown = np.clip(flown, -1.0, 1.0).astype(np.float32)
        rows, _, ended, cut, infos = self.env.step(flown.reshape(self.env.action_space.shape))
        self.rows, useful = rows.reshape(self.shape), ~self.begins
        self.begins = ended | cut
        if self.begins.any():
            self.ends += infos["episode_metrics"]["success"][self.begins].tolist()
        return wanted.reshape(-1, wanted.shape[-1]), np.repeat(useful, self.shape[1])


class Memory:
    """The latest decisions: what was observed, and what the teacher would have done."""

    def __init__(self) -> None:
        self.seen, self.wanted = torch.zeros(0), torch.zeros(0)

    def add(self, seen: Tensor, wanted: Tensor) -> None:
        """Remember these rows, and forget the oldest."""
        before = (self.seen, self.wanted) if len(self.seen) else (seen[:0], wanted[:0])
        self.seen = torch.cat([before[0], seen])[-MEMORY:]
        self.wanted = torch.cat([before[1], wanted])[-MEMORY:]


def learn(net: DeepSet, adam: torch.optim.Optimizer, memory: Memory) -> float:
    """Some gradient steps on what is remembered; the mean loss."""
    losses = []
    for _ in range(BATCHES):
        chosen = torch.randint(len(memory.seen), (BATCH,))
        loss = nn.functional.huber_loss(net(memory.seen[chosen]), memory.wanted[chosen], delta=0.1)
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses))


def main(arguments: list[str] | None = None) -> list[float]:
    """Train, and return the loss after every ten decisions."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400_000, help="decisions of single drones")
    parser.add_argument("--envs", type=int, default=64, help="teams that fly at once")
    parser.add_argument("--drones", type=int, default=8, help="of a team")
    parser.add_argument("--teacher", default="roundabout", help="an agent with act_batch")
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
            wanted, useful = teams.step(own, max(0.0, 1.0 - 8.0 * k / rounds))
            memory.add(seen[useful], torch.from_numpy(wanted[useful]).float())
        curve.append(learn(net, adam, memory))
        slower.step()
        recent = float(np.mean(teams.ends[-100:] or [0.0]))
        print(f"{k + 1}/{rounds}: loss {curve[-1]:.4f}, success {recent:.0%}", flush=True)
    return curve


if __name__ == "__main__":
    main()
