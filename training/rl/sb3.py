"""Training with an unmodified algorithm of Stable-Baselines3: all drones share one policy.

`SharedPolicyVecEnv` makes every drone of every environment a sub-environment. One callback applies
two schedules that PPO needs to learn to pass close to other drones; another evaluates the policy
and saves the best. Logger, checkpoints and resuming are those of Stable-Baselines3.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import VecMonitor
from torch import nn
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents.networks import Network
from swarm_envs.envs.setting import parse_values
from swarm_envs.files import claimed, write_json
from swarm_envs.tasks.learning import RATES
from swarm_envs.training.provenance import check_same
from swarm_envs.training.rl.advice import advice
from swarm_envs.training.rl.encoders import SetExtractor, linear_layers
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.runs import REPORT, Evaluation, Setting, make_setting, result_options
from swarm_envs.training.shared_policy import SharedPolicyVecEnv
from swarm_envs.user_files import load_from_file

SECOND_STAGE = 0.75
"""Fraction of the steps at which the second stage of PPO, with more exploration, begins."""
LEAST_DEVIATION = 0.3  # Least standard deviation of actions at the start of the second stage
CLOSER = 0.37  # Fraction of the steps at which the cost of proximity is reduced
PROXIMITY = (4.0, 2.0)
"""Cost of proximity to other drones before and after. If it is too high for too long, drones learn
to hover next to their goals."""
RUN, CHECKPOINTS = "run.json", "checkpoints"  # Options and models of an incomplete run
_RECENT = 256  # Episodes of the success rate in the progress bar
_IN_PYTHON = (
    "train it in Python with swarm_envs.training.SharedPolicyVecEnv, and fly it with "
    "swarm_envs.agents.from_model (docs/how-to/network.md)"
)

OFF_POLICY: dict[str, Any] = {
    "learning_rate": 1e-3,
    "buffer_size": 300_000,
    "learning_starts": 8192,
    "batch_size": 1024,
    "gamma": 0.9,
    "tau": 0.02,
    "train_freq": 8,
    "gradient_steps": 64,
}
"""Defaults of `sac` and `td3`. With a discount factor of 0.98, SAC learns much less."""
DEFAULTS: dict[str, dict[str, Any]] = {
    "ppo": {
        "n_steps": 32,
        "batch_size": 2048,
        "n_epochs": 5,
        "gamma": 0.98,
        "ent_coef": 0.003,
    },
    "sac": {**OFF_POLICY, "ent_coef": "auto_0.02"},
    "td3": OFF_POLICY,
}
"""Default arguments by algorithm; others have the defaults of Stable-Baselines3."""
CLASSES = {name: f"stable_baselines3.{name.upper()}" for name in DEFAULTS}


def train_sb3(config: RlConfig, task: str) -> dict[str, Any]:
    """Train a policy, and write and return the report; see `runs.train_policy`."""
    torch.set_num_threads(1)  # more threads are slower for small matrices
    setting = make_setting(config, task)
    algorithm, arguments = algorithm_of(config.algo), arguments_of(setting)
    with claimed(config.out):
        begun = time.process_time(), time.monotonic()
        env = VecMonitor(  # logs mean reward and length of episodes
            SharedPolicyVecEnv(
                setting.blueprints,
                config.environments // len(setting.blueprints),
                config.seed,
                features=True,
            )
        )
        model, evaluation = _begin(algorithm, arguments, env, setting)
        model.set_logger(_logger(config.out, model.num_timesteps))
        _announce_rounding(model, config.steps)
        with tqdm(total=config.steps, unit="step", disable=not config.progress) as bar:
            evaluations = EvaluationCallback(evaluation)
            callbacks: list[BaseCallback] = [ProgressCallback(bar), evaluations]
            folder, every = config.out / CHECKPOINTS, -(-config.steps // config.evaluations)
            callbacks.append(CheckpointCallback(max(every // env.num_envs, 1), str(folder)))
            if isinstance(model, OnPolicyAlgorithm):
                callbacks.append(ScheduleCallback(setting))
            remaining = config.steps - model.num_timesteps
            try:
                model.learn(max(remaining, 0), callbacks, reset_num_timesteps=False)
                evaluations.evaluate(model)
            finally:
                model.logger.close()
                env.close()
        model.save(config.out / CHECKPOINTS / f"rl_model_{model.num_timesteps}_steps")  # to extend
        report = {
            "config": result_options(config, task),
            "steps": model.num_timesteps,
            "chosen": evaluation.best,
            "last": evaluation.results[-1],
            "next": advice(setting.config, task, evaluation.results),
            "cpu_s": round(time.process_time() - begun[0], 1),  # since the run resumed, if it did
            "wall_s": round(time.monotonic() - begun[1], 1),
            "version": __version__,
        }
        write_json(config.out / REPORT, report)
    return report


def _announce_rounding(model: BaseAlgorithm, steps: int) -> None:
    """Write by how much the training is longer, since an algorithm like PPO ends with a rollout."""
    if not isinstance(model, OnPolicyAlgorithm):
        return
    over = -(steps - model.num_timesteps) % (model.n_steps * model.n_envs)
    if over and model.num_timesteps < steps:
        tqdm.write(
            f"{steps:,} steps are rounded up to {steps + over:,}, whole rollouts of "
            f"{model.n_steps} steps of {model.n_envs} drones"
        )


def _logger(folder: Path, steps: int) -> Logger:
    """Return the logger of a run, whose files do not replace those before it resumed at `steps`."""
    outputs = ["csv", *["tensorboard"] * bool(importlib.util.find_spec("tensorboard"))]
    suffix = f"_from_{steps}" if steps else ""
    return Logger(str(folder), [make_output_format(name, str(folder), suffix) for name in outputs])


def algorithm_of(name: str) -> type[BaseAlgorithm]:
    """Return the class of an algorithm: `ppo`, `sac`, `td3`, an import path or `file.py:Class`.

    Raises:
        ValueError: there is no such class, or it is no algorithm of Stable-Baselines3.
    """
    module, _, part = CLASSES.get(name, name).rpartition(".")
    valid = (
        f"{', '.join(CLASSES)}, dagger, an import path such as sb3_contrib.TQC, or file.py:Class"
    )
    try:
        in_file = ".py:" in name
        found = load_from_file(name) if in_file else getattr(importlib.import_module(module), part)
    except (ImportError, AttributeError, ValueError, FileNotFoundError) as error:
        raise ValueError(f"--algo is {name!r}, but must be one of {valid} ({error})") from error
    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise ValueError(f"--algo is {name!r}, which is no algorithm; it must be one of {valid}")
    return found


def arguments_of(setting: Setting) -> dict[str, Any]:
    """Return the arguments of the algorithm's class: the defaults, then those of `--set`.

    Raises:
        ValueError: an entry of `--set` is not NAME=VALUE.
    """
    config = setting.config
    policy: dict[str, Any] = {"net_arch": [*config.hidden], "activation_fn": nn.Tanh}
    arguments = dict(DEFAULTS.get(config.algo, {}))
    if config.algo == "ppo":
        arguments["learning_rate"] = falling_rate
        policy |= {"log_std_init": -0.5, "optimizer_kwargs": {"eps": 1e-5}}
    if config.encoder == "deep-set":
        policy["features_extractor_class"] = SetExtractor
        policy["features_extractor_kwargs"] = {
            "sizes": setting.sizes,
            "widths": config.set_hidden,
            "activation": "tanh",
        }
        policy["share_features_extractor"] = False
    arguments |= parse_values("--set", config.set, "n_steps=64")
    return {"policy_kwargs": policy, "seed": config.seed, "device": "cpu", **arguments}


def falling_rate(remaining: float) -> float:
    """Return PPO's learning rate, which decreases from 1e-3, and in the second stage from 7e-4."""
    done = 1.0 - remaining
    if done < SECOND_STAGE:
        return 1e-3 * max(1.0 - done / SECOND_STAGE, 0.02)
    return 7e-4 * max(remaining / (1.0 - SECOND_STAGE), 0.02)


def _begin(
    algorithm: type[BaseAlgorithm], arguments: dict[str, Any], env: Any, setting: Setting
) -> tuple[BaseAlgorithm, Evaluation]:
    """Return a new model, or that of the last checkpoint, and the evaluations before it.

    Raises:
        ValueError: the folder has a run with other options, or the class refuses an argument.
    """
    config, path = setting.config, setting.config.out / RUN
    options = result_options(config, setting.task)
    models = sorted((config.out / CHECKPOINTS).glob("*.zip"), key=_steps_of)
    if path.is_file() and models:
        content = json.loads(path.read_text(encoding="utf-8"))
        steps = max(content["config"]["steps"], options["steps"])  # a run may be extended
        check_same(path, content["config"] | {"steps": steps}, options)
        model = algorithm.load(models[-1], env=env, device="cpu")  # a pickle from this run
        tqdm.write(f"resuming at {model.num_timesteps:,} steps from {models[-1]}")
        kept = [e for e in content["evaluations"] if e["step"] <= model.num_timesteps]
        return model, Evaluation(setting, kept)
    try:
        model = algorithm("MlpPolicy", env, **arguments)
    except (TypeError, ValueError, RuntimeError, AssertionError) as error:
        raise ValueError(f"--algo {config.algo} refuses its arguments: {error}") from error
    network_of(model)  # raises before the training if the policy could not be written
    write_json(path, {"config": options, "evaluations": []})
    return model, Evaluation(setting)


def _steps_of(path: Path) -> int:
    """Return the steps in the name of a checkpoint, `rl_model_<steps>_steps.zip`."""
    return int(path.stem.split("_")[-2])


class ProgressCallback(BaseCallback):  # type: ignore[misc]  # SB3's base has no types here
    """Callback that updates a progress bar, and logs successes and crashes in training."""

    def __init__(self, bar: Any) -> None:
        super().__init__()
        self._bar = bar
        self._successes: deque[float] = deque(maxlen=_RECENT)

    def _on_step(self) -> bool:
        ends = [i["episode_metrics"] for i in self.locals["infos"] if "episode_metrics" in i]
        for metrics in ends:
            for name, measure in RATES.items():
                self.logger.record_mean(f"rollout/{name}", measure(metrics))
            self._successes.append(RATES["success"](metrics))
        if ends:
            text = f"success {sum(self._successes) / len(self._successes):.0%}"
            if returns := [episode["r"] for episode in self.model.ep_info_buffer]:
                text += f", return {np.mean(returns):.3g}"  # of the episodes before these
            self._bar.set_postfix_str(text, refresh=False)
        self._bar.n = min(self.num_timesteps, self._bar.total)
        self._bar.update(0)
        return True


class ScheduleCallback(BaseCallback):  # type: ignore[misc]
    """Callback that reduces the cost of proximity, and begins the second stage of PPO.

    The cost is reduced in tasks that have settings of training, and their usual weight: a weight
    that the user has chosen, or that of an own task, stays.
    """

    def __init__(self, setting: Setting) -> None:
        super().__init__()
        self._steps = setting.config.steps
        task, chosen = setting.blueprints[0].task, setting.config.world_options()
        usual = task.learning is not None and task.reward_weights.get("proximity") == -PROXIMITY[0]
        self._eases = usual and "proximity" not in chosen.get("reward_weights", {})
        self._done = 0.0  # Fraction of the steps at the last rollout

    def _on_step(self) -> bool:
        return True

    def _on_training_start(self) -> None:
        self._done = self.num_timesteps / self._steps  # above 0 if the run is resumed

    def _on_rollout_start(self) -> None:
        done, policy = self.num_timesteps / self._steps, self.model.policy
        if self._eases:
            for core in self.training_env.cores:
                core.set_reward_weights({"proximity": -PROXIMITY[done > CLOSER]})
        if self._done < SECOND_STAGE <= done and hasattr(policy, "log_std"):
            policy.log_std.data.clamp_(min=float(np.log(LEAST_DEVIATION)))
        self._done = done


class EvaluationCallback(BaseCallback):  # type: ignore[misc]
    """Callback that evaluates the policy at regular intervals, and logs the results."""

    def __init__(self, evaluation: Evaluation) -> None:
        super().__init__()
        self._evaluation = evaluation

    def _on_step(self) -> bool:
        config, results = self._evaluation.setting.config, self._evaluation.results
        due = (len(results) + 1) * config.steps / config.evaluations
        if due <= self.num_timesteps < config.steps:
            self.evaluate(self.model)
        return True

    def evaluate(self, model: BaseAlgorithm) -> None:
        """Evaluate the policy of a model, and log and store the results."""
        config, steps = self._evaluation.setting.config, model.num_timesteps
        rates = self._evaluation.add(network_of(model), steps)
        model.logger.record("time/total_timesteps", steps)
        for name, value in rates.items():
            model.logger.record(f"evaluation/{name}", value)
        model.logger.dump(steps)
        options = result_options(config, self._evaluation.setting.task)
        results = self._evaluation.results
        write_json(config.out / RUN, {"config": options, "evaluations": results})


def network_of(model: BaseAlgorithm) -> Network:
    """Return the mean action of a model of Stable-Baselines3 as a network in numpy.

    Raises:
        ValueError: the model's actor has another structure than that of PPO, SAC or TD3, or its
            activation is not tanh.
    """
    policy: Any = model.policy
    if getattr(policy, "activation_fn", None) is not nn.Tanh:
        raise ValueError(
            "the activation of the policy is not tanh, so that it cannot be written as a policy "
            f"file; leave policy_kwargs out of --set (--hidden sets the layers), or {_IN_PYTHON}"
        )
    if hasattr(policy, "action_net"):
        extractor = policy.pi_features_extractor
        layers = linear_layers(policy.mlp_extractor.policy_net, policy.action_net)
    elif hasattr(policy, "actor"):
        extractor, actor = policy.actor.features_extractor, policy.actor
        parts = [actor.latent_pi] if hasattr(actor, "latent_pi") else []
        width = model.action_space.shape[0]
        # The final tanh becomes a hidden activation by an identity layer after it.
        identity = (np.eye(width, dtype=np.float32), np.zeros(width, np.float32))
        layers = (*linear_layers(*parts, actor.mu), identity)
    else:
        raise ValueError(
            f"{type(model).__name__} has no actor that can be written as a policy file; "
            f"{_IN_PYTHON}"
        )
    if type(extractor) not in (FlattenExtractor, SetExtractor):
        raise ValueError(
            f"the features extractor of the policy is {type(extractor).__name__}, which cannot be "
            f"written as a policy file; {_IN_PYTHON}"
        )
    phi = linear_layers(extractor.encoder.phi) if isinstance(extractor, SetExtractor) else None
    return Network(layers, phi, "tanh")
