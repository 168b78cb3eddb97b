"""Train one policy for all drones by PPO in one file, with torch and the vector interface.

pip install torch swarm-envs
python examples/ppo.py --steps 1000000

E teams of N drones give E * N rows per decision, with the features of the included policies.
"""

from __future__ import annotations

import argparse

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Normal

import swarm_envs  # noqa: F401  # registers the environments
from swarm_envs.agents.features import features_of

NEIGHBORS, ROLLOUT, PASSES, BATCH = 3, 32, 5, 2048
GAMMA, LAMBDA, CLIP, RATE = 0.98, 0.95, 0.2, 1e-3


class ActorCritic(nn.Module):
    """Networks for the mean actions and for the value of a drone."""

    def __init__(self, observed: int, actions: int) -> None:
        super().__init__()
        self.actor, self.critic = _mlp(observed, actions), _mlp(observed, 1)
        self.log_deviation = nn.Parameter(torch.full((actions,), -0.5))
        nn.init.orthogonal_(self.actor[-1].weight, 0.01)

    def policy(self, seen: Tensor) -> Normal:
        """Return the distribution of actions."""
        return Normal(self.actor(seen), self.log_deviation.exp())

    def value(self, seen: Tensor) -> Tensor:
        """Return the expected return."""
        return self.critic(seen).squeeze(-1)


def _mlp(into: int, out: int) -> nn.Sequential:
    return nn.Sequential(
        *(nn.Linear(into, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, out))
    )


class Teams:
    """E teams of N drones as E * N rows of features.

    The step after the end of an episode begins the next one, and its action is unused. The value of
    the last observation replaces the missing rewards of an episode that the time limit truncated.
    """

    def __init__(self, envs: int, drones: int, seed: int = 0) -> None:
        self.env = gymnasium.make_vec(
            "swarm_envs/Swap-v1",
            num_envs=envs,
            num_drones=drones,
            action="acceleration",
            decision_rate=10,
            horizon_s=3.5,
            force_rate=48,
            num_neighbors=NEIGHBORS,
        )
        self.drones = drones
        self.seen = self._features(self.env.reset(seed=seed)[0])
        self.used = torch.ones(len(self.seen), dtype=torch.bool)

    def _features(self, rows: np.ndarray) -> Tensor:
        flat = rows.reshape(rows.shape[0] * self.drones, -1)
        return torch.from_numpy(features_of(flat, NEIGHBORS))

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return rewards, and True for terminated and truncated episodes, of every drone."""
        given = actions.clamp(-1.0, 1.0).reshape(self.env.action_space.shape)
        rows, _, ended, cut, infos = self.env.step(given.numpy())
        self.seen = self._features(rows)
        rewards = torch.from_numpy(infos["rewards"].astype(np.float32).reshape(-1))
        ends = (torch.from_numpy(part).repeat_interleave(self.drones) for part in (ended, cut))
        return rewards, *ends


@torch.no_grad()
def collect(teams: Teams, net: ActorCritic) -> tuple[Tensor, ...]:
    """Return features, actions, log probabilities, advantages, returns and rewards by row."""
    rows = []
    for _ in range(ROLLOUT):
        policy, seen = net.policy(teams.seen), teams.seen
        actions = policy.sample()
        rewards, ended, cut = teams.step(actions)
        log_probs = policy.log_prob(actions).sum(-1)
        rows.append((seen, actions, log_probs, net.value(seen), rewards, ended, cut))
    seen, actions, log_probs, values, rewards, ended, cut = map(torch.stack, zip(*rows))
    following = torch.cat([values[1:], net.value(teams.seen)[None]])
    advantages, last = torch.zeros_like(values), torch.zeros_like(values[0])
    for t in reversed(range(ROLLOUT)):
        going = (~ended[t]).float()
        error = rewards[t] + GAMMA * going * following[t] - values[t]
        last = error + GAMMA * LAMBDA * going * (~cut[t]) * last
        advantages[t] = last
    used = torch.cat([teams.used[None], ~(ended | cut)[:-1]])  # where the action was used
    teams.used = ~(ended | cut)[-1]
    parts = (seen, actions, log_probs, advantages, advantages + values, rewards)
    return tuple(part[used] for part in parts)


def update(net: ActorCritic, adam: torch.optim.Optimizer, rollout: tuple[Tensor, ...]) -> None:
    """Optimize PPO's clipped objective in some passes over a rollout."""
    for _ in range(PASSES):
        for chosen in torch.randperm(len(rollout[0])).split(BATCH):
            seen, actions, before, gains, returns, _ = (part[chosen] for part in rollout)
            gains = (gains - gains.mean()) / (gains.std() + 1e-8)
            policy = net.policy(seen)
            ratio = (policy.log_prob(actions).sum(-1) - before).exp()
            clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
            loss = -torch.minimum(ratio * gains, clipped * gains).mean()
            loss = loss + 0.5 * (net.value(seen) - returns).square().mean()
            loss = loss - 0.003 * policy.entropy().sum(-1).mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 0.5)
            adam.step()


def main(arguments: list[str] | None = None) -> list[float]:
    """Train, and return the mean reward of a decision in every rollout."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000, help="decisions of single drones")
    parser.add_argument("--envs", type=int, default=128, help="number of teams in the batch")
    parser.add_argument("--drones", type=int, default=4)
    given = parser.parse_args(arguments)
    torch.manual_seed(0)
    teams = Teams(given.envs, given.drones)
    net = ActorCritic(teams.seen.shape[1], 3)
    adam, curve = torch.optim.Adam(net.parameters(), lr=RATE), []
    rollouts = max(1, given.steps // (ROLLOUT * given.envs * given.drones))
    for k in range(rollouts):
        adam.param_groups[0]["lr"] = RATE * max(1.0 - k / rollouts, 0.02)
        rollout = collect(teams, net)
        update(net, adam, rollout)
        curve.append(float(rollout[-1].mean()))
        print(f"{k + 1}/{rollouts}: mean reward of a decision {curve[-1]:.4f}", flush=True)
    return curve


if __name__ == "__main__":
    main()
