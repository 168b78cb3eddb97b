"""BenchMARL trains on a task: one iteration of MAPPO with a critic that sees the team's state."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from swarm_envs import swap_v1

pytest.importorskip("benchmarl", reason="run by `make test-compat`")

from benchmarl.algorithms import MappoConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.envs import PettingZooWrapper

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]


class SwapClass(PettingZooClass):  # type: ignore[misc]  # BenchMARL is not there for mypy
    """Our task, made by us; whatever else BenchMARL asks of a PettingZoo task is the same."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Any:
        return lambda: PettingZooWrapper(
            env=swap_v1.parallel_env(physics="batch", **self.config),
            return_state=True,
            use_mask=True,
            done_on_any=False,
            seed=seed,
            device=device,
        )

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def has_state(self) -> bool:
        return True

    def has_render(self, env: Any) -> bool:
        return False

    def max_steps(self, env: Any) -> int:
        return 48


@pytest.mark.parametrize("on_contact", ["end_team", "end_pair"])
def test_one_iteration(tmp_path, on_contact):
    """With `end_pair` random drones fall one after another, and are masked."""
    config = ExperimentConfig.get_from_yaml()
    config.max_n_iters, config.max_n_frames, config.save_folder = 1, None, str(tmp_path)
    config.on_policy_collected_frames_per_batch = 96
    config.on_policy_n_envs_per_worker, config.on_policy_n_minibatch_iters = 2, 2
    config.on_policy_minibatch_size, config.evaluation_interval = 48, 96
    config.evaluation_episodes, config.loggers, config.render = 2, ["csv"], False
    options = {"num_drones": 3, "horizon_s": 1.0, "action": "rotors", "on_contact": on_contact}
    experiment = Experiment(
        task=SwapClass("swap_v1", options),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    before = [p.detach().clone() for p in experiment.policy.parameters()]
    experiment.run()
    assert experiment.n_iters_performed == 1 and experiment.total_frames == 96
    after = list(experiment.policy.parameters())
    assert any(not old.equal(new) for old, new in zip(before, after, strict=True))
    assert all(p.isfinite().all() for p in after)
    (file,) = tmp_path.rglob("*.json")
    (scores,) = json.loads(file.read_text())["pettingzoo"]["swap_v1"]["mappo"].values()
    assert np.isfinite(scores["step_1"]["return"]).all()
