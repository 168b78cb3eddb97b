"""Train a shared actor and a centralized critic by MAPPO of TorchRL.

pip install 'swarm-envs[train]' torchrl
python examples/torchrl_mappo.py --steps 20000
"""

from __future__ import annotations

import argparse

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from swarm_envs import swap_v1

GROUP = "drone"
OBSERVATION, ACTION, VALUE = (GROUP, "observation"), (GROUP, "action"), (GROUP, "state_value")


def network(env: PettingZooWrapper, outputs: int, centralized: bool) -> MultiAgentMLP:
    """Return an MLP for every drone, with shared weights."""
    drones, width = env.observation_spec[OBSERVATION].shape
    return MultiAgentMLP(
        width,
        outputs,
        n_agents=drones,
        centralized=centralized,
        share_params=True,
        depth=2,
        num_cells=64,
        activation_class=torch.nn.Tanh,
    )


def actor_of(env: PettingZooWrapper) -> ProbabilisticActor:
    """Return the actor: means and deviations of actions from each drone's own observation."""
    width = env.full_action_spec[ACTION].shape[-1]
    net = torch.nn.Sequential(network(env, 2 * width, False), NormalParamExtractor())
    parameters = [(GROUP, "loc"), (GROUP, "scale")]
    return ProbabilisticActor(
        TensorDictModule(net, in_keys=[OBSERVATION], out_keys=parameters),
        in_keys=parameters,
        out_keys=[ACTION],
        spec=env.full_action_spec[ACTION],
        distribution_class=TanhNormal,
        return_log_prob=True,
        log_prob_key=(GROUP, "sample_log_prob"),
    )


def loss_of(env: PettingZooWrapper, actor: ProbabilisticActor) -> ClipPPOLoss:
    """Return PPO's loss, with the keys of a team."""
    critic = TensorDictModule(network(env, 1, True), in_keys=[OBSERVATION], out_keys=[VALUE])
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=1e-3)
    loss.set_keys(
        reward=(GROUP, "reward"),
        action=ACTION,
        value=VALUE,
        sample_log_prob=(GROUP, "sample_log_prob"),
        done=(GROUP, "done"),
        terminated=(GROUP, "terminated"),
    )
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.98, lmbda=0.95)
    return loss


def main(arguments: list[str] | None = None) -> list[float]:
    """Train, and return the mean reward of a decision in every batch."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000, help="number of team decisions")
    parser.add_argument(
        "--batch", type=int, default=1_000, help="team decisions between two updates"
    )
    given = parser.parse_args(arguments)
    torch.manual_seed(0)
    env = PettingZooWrapper(
        swap_v1.parallel_env(
            num_drones=4,
            action="acceleration",
            decision_rate=10,
            horizon_s=3.5,
            physics="batch",
        ),
        seed=0,
    )
    actor = actor_of(env)
    loss = loss_of(env, actor)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    replay = ReplayBuffer(
        storage=LazyTensorStorage(given.batch),
        sampler=SamplerWithoutReplacement(),
        batch_size=max(1, given.batch // 4),
    )
    rewards = []
    for data in Collector(env, actor, frames_per_batch=given.batch, total_frames=given.steps):
        with torch.no_grad():
            loss.value_estimator(
                data,
                params=loss.critic_network_params,
                target_params=loss.target_critic_network_params,
            )
        replay.extend(data.reshape(-1))
        for _ in range(5):
            for part in replay:
                terms = loss(part)
                total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                optimiser.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
        rewards.append(float(data["next", GROUP, "reward"].mean()))
    env.close()
    return rewards


if __name__ == "__main__":
    for number, reward in enumerate(main()):
        print(f"batch {number}: mean reward of a decision {reward:.4f}")
