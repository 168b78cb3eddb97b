"""DAgger in torch: a policy imitates teachers in the states that it visits itself.

Ross et al., "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning", 2011: the policy acts, a teacher labels every decision with its own action, and the
policy is fitted to a replay buffer of these labels. At first the teacher's actions are executed
with a probability that decreases to 0; a third of the environments have noise on the actions, so
that the policy learns to recover from errors.

A teacher is any agent, and may be privileged: see `labels`. Parts of a curriculum and team sizes
may have different teachers. After each checkpoint new episodes begin, with random numbers that
depend on the seed and the number of rollouts, so that a resumed run has the same result as one that
was not interrupted.
"""

from __future__ import annotations

import importlib.util
import json
import math
import time
from contextlib import closing
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from stable_baselines3.common.logger import configure
from torch import Tensor, nn
from tqdm import tqdm

from swarm_envs import __version__
from swarm_envs.agents.features import features_of
from swarm_envs.agents.policy import CHECKPOINT, PolicyAgent
from swarm_envs.agents.registry import load_agent
from swarm_envs.envs.core import SwarmCore
from swarm_envs.envs.observation import Float32Array
from swarm_envs.envs.options import Blueprint
from swarm_envs.files import claimed, write_json, write_table
from swarm_envs.tasks.learning import RATES
from swarm_envs.training.force_model.export import write_safetensors
from swarm_envs.training.provenance import check_same
from swarm_envs.training.rl.advice import advice
from swarm_envs.training.rl.encoders import Actor
from swarm_envs.training.rl.labels import Teacher, teachers_of
from swarm_envs.training.rl.rl_config import RlConfig
from swarm_envs.training.rl.runs import (
    REPORT,
    Evaluation,
    Setting,
    make_setting,
    parts_of,
    result_options,
)

LARGEST_GRADIENT = 1.0
NOISY = 3  # One in this many environments has noise on its actions
NOISE = 0.1  # Standard deviation of that noise
HUBER = 0.1  # Error of an action above which it counts linearly in the loss
LAST_RATE = 0.02  # Final learning rate divided by the initial one
CURVE = "progress.csv"
STARTED_ALIKE = (
    *("action", "decision_rate", "num_neighbors", "num_obstacles"),
    *("observe_load", "observe_force", "observe_setpoint"),
)
"""Entries of a policy's note that must be the same for the initial policy of a run."""


def train_dagger(config: RlConfig, task: str) -> dict[str, Any]:
    """Train a policy, and write and return the report; see `runs.train_policy`."""
    torch.set_num_threads(1)  # more threads are slower for small matrices
    with claimed(config.out):
        dagger = Dagger(make_setting(config, task))
        try:
            dagger.resume()
            dagger.train()
        finally:
            dagger.close()
        report = {
            "config": result_options(config, task),
            "steps": dagger.steps,
            "chosen": dagger.evaluation.best,
            "last": dagger.evaluation.results[-1],
            "next": advice(dagger.config, task, dagger.evaluation.results),
            "cpu_s": round(dagger.cpu_s, 1),
            "wall_s": round(dagger.wall_s, 1),
            "version": __version__,
        }
        write_json(config.out / REPORT, report)
    return report


class ReplayBuffer:
    """Replay buffer: features (size, width), labels (size, actions), weights (size, 1)."""

    def __init__(self, size: int, width: int, actions: int) -> None:
        self.parts = [torch.zeros(size, columns) for columns in (width, actions, 1)]
        self.size, self.place, self.filled = size, 0, 0

    def add(self, *rows: Float32Array) -> None:
        """Add R rows to each part, replacing the oldest."""
        count = len(rows[0])
        places = torch.from_numpy((self.place + np.arange(count)) % self.size)
        for part, new in zip(self.parts, rows, strict=True):
            part[places] = torch.from_numpy(new)
        self.place = (self.place + count) % self.size
        self.filled = min(self.filled + count, self.size)

    def draw(self, rng: np.random.Generator, count: int) -> list[Tensor]:
        """Return a random batch of each part."""
        chosen = torch.from_numpy(rng.integers(self.filled, size=count))
        return [part[chosen] for part in self.parts]


class Dagger:
    """A run of DAgger.

    Args:
        setting: the environments and options of the run.

    Raises:
        ValueError: a part of the training has no teacher or no environment, or the initial policy
            has other observations, actions or layers.
    """

    def __init__(self, setting: Setting) -> None:
        self.setting, self.config = setting, setting.config
        self.evaluation = Evaluation(setting)
        self._make_cores()
        width = self.cores[0].mode.width
        torch.manual_seed(self.config.seed)
        sets = self.config.set_hidden if self.config.encoder == "deep-set" else None
        self.actor = Actor(setting.sizes, self.config.hidden, width, sets)
        self._start()
        self.adam = torch.optim.Adam(self.actor.parameters())
        self.buffer = ReplayBuffer(self.config.dagger.buffer_size, setting.sizes.width, width)
        self.rollout, self.cpu_s, self.wall_s = 0, 0.0, 0.0
        self.curve: list[dict[str, Any]] = []

    def _make_cores(self) -> None:
        """Create the environments and teachers of all parts of every team's curriculum."""
        share = self.config.environments // len(self.setting.blueprints)
        parts: list[Blueprint] = []
        counts: list[int] = []
        taught: list[tuple[str, int]] = []
        for blueprint in self.setting.blueprints:
            found = parts_of(self.config, self.setting.task, blueprint.task)
            given = [max(1, round(portion * share)) for portion, _ in found.values()]
            counts += [share - sum(given[1:]), *given[1:]]
            parts += [blueprint._replace(task=task) for _, task in found.values()]
            taught += [(part, len(task.team)) for part, (_, task) in found.items()]
        if min(counts) < 1:
            raise ValueError(
                f"--environments is {self.config.environments}, which does not suffice for "
                f"{len(counts)} parts of the training in their shares; give twice as many"
            )
        names = teachers_of(self.config.dagger.teacher, taught)
        self.teachers = [Teacher(n, b) for n, b in zip(names, parts, strict=True)]
        self.cores = [
            SwarmCore(b.task, b.config, count) for b, count in zip(parts, counts, strict=True)
        ]

    def _start(self) -> None:
        if self.config.start is None:
            return
        agent = load_agent(self.config.start)
        if not isinstance(agent, PolicyAgent):
            raise ValueError(f"--start is {self.config.start!r}, but must be a trained policy")
        theirs, ours = agent.policy.note, self.setting.note()
        for name in STARTED_ALIKE:
            if getattr(theirs, name) != getattr(ours, name):
                raise ValueError(
                    f"--start is {self.config.start!r} with {name} {getattr(theirs, name)!r}, but "
                    f"this run has {getattr(ours, name)!r}; they must be the same"
                )
        self.actor.fill(agent.policy.network)

    @property
    def steps(self) -> int:
        """The number of decisions of single drones so far."""
        return self.rollout * self.config.decisions * self.config.dagger.train_freq

    def train(self) -> None:
        """Train to the end, with checkpoints and evaluations."""
        config, total = self.config, self.config.rollouts
        due = [math.ceil((k + 1) * total / config.evaluations) for k in range(config.evaluations)]
        bar = tqdm(total=total, initial=self.rollout, unit="rollout", disable=not config.progress)
        events = ["tensorboard"] * bool(importlib.util.find_spec("tensorboard"))
        with closing(configure(str(config.out), events)) as log, bar:
            while self.rollout < total:
                begun, first = (time.process_time(), time.monotonic()), self.rollout
                end = min(first + config.checkpoint_rollouts, total)
                entry = self.fly(end, bar)
                if any(first < rollout <= end for rollout in due):
                    entry |= self.evaluation.add(self.actor.network(), self.steps)
                self.curve.append(entry)
                self.cpu_s += time.process_time() - begun[0]
                self.wall_s += time.monotonic() - begun[1]
                self.save()
                for name, value in entry.items():
                    log.record(name, value)
                log.dump(self.steps)

    def fly(self, end: int, bar: Any = None) -> dict[str, Any]:
        """Train with new episodes until rollout `end`; return means over these rollouts."""
        config = self.config
        words = np.random.SeedSequence([config.seed, self.rollout]).generate_state(2)
        self.rng, seed = np.random.default_rng(words), int(words[0]) >> 1
        for core in self.cores:
            core.reset([seed + e for e in range(core.num_envs)])
            seed += core.num_envs
        self.ends: list[list[float]] = []  # the measures of each episode
        guided = config.dagger.guided * config.rollouts
        while self.rollout < end:
            share = max(0.0, 1.0 - self.rollout / guided) if guided else 0.0
            for _ in range(config.dagger.train_freq):
                self._decide(share)
            loss = self._learn()
            self.rollout += 1
            means = np.mean(self.ends or [[0.0] * len(RATES)], axis=0)
            rates = dict(zip(RATES, means.tolist(), strict=True))
            if bar is not None:
                bar.set_postfix_str(
                    f"success {rates['success']:.0%}, loss {loss:.3g}", refresh=False
                )
                bar.update()
        return {"step": self.steps, **rates, "loss": loss}

    def _decide(self, guided: float) -> None:
        """Simulate one decision of every drone, and store the teacher's labels."""
        for core, teacher in zip(self.cores, self.teachers, strict=True):
            rows = features_of(core.rows, *core.form[1:])
            with torch.no_grad():
                own = self.actor(torch.from_numpy(rows)).numpy()
            label, weight = teacher.labels(core, self.config.dagger.avoiding)
            flies = core.world.drones["active"] > 0.0
            self.buffer.add(rows[flies], label[flies], weight[flies])
            result = core.step(self._mixed(own, label, guided))
            ended = result.terminated | result.truncated
            if ended.any():
                metrics = core.metrics_of(np.flatnonzero(ended).tolist())
                self.ends += [[measure(m) for measure in RATES.values()] for m in metrics]
                core.reset(mask=ended)

    def _mixed(self, own: Float32Array, label: Float32Array, guided: float) -> Any:
        """Return the policy's or the teacher's actions (E, N, width), with noise in some."""
        draws = self.rng.random((len(own), 1, 1))
        noise = self.rng.normal(0.0, NOISE, own.shape)
        noise[np.arange(len(own)) % NOISY != 0] = 0.0
        return np.clip(np.where(draws < guided, label, own) + noise, -1.0, 1.0)

    def _learn(self) -> float:
        """Take the gradient steps of a rollout; return the mean loss."""
        options, losses = self.config.dagger, []
        cosine = 0.5 + 0.5 * math.cos(math.pi * self.rollout / self.config.rollouts)
        self.adam.param_groups[0]["lr"] = options.learning_rate * max(cosine, LAST_RATE)
        for _ in range(options.gradient_steps):
            seen, label, weight = self.buffer.draw(self.rng, options.batch_size)
            errors = nn.functional.huber_loss(
                self.actor(seen), label, reduction="none", delta=HUBER
            )
            loss = (weight * errors).mean()
            self.adam.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(self.actor.parameters(), LARGEST_GRADIENT)
            self.adam.step()
            losses.append(float(loss.detach()))
        return float(np.mean(losses))

    def save(self) -> None:
        """Write a checkpoint; the last one does not contain the replay buffer."""
        filled = self.buffer.filled if self.rollout < self.config.rollouts else 0
        tensors = {f"actor.{n}": t for n, t in self.actor.state_dict().items()}
        tensors |= {f"buffer.{k}": part[:filled] for k, part in enumerate(self.buffer.parts)}
        for k, state in self.adam.state_dict()["state"].items():
            tensors |= {f"adam.{k}.{n}": torch.as_tensor(t).clone() for n, t in state.items()}
        progress = {
            "config": result_options(self.config, self.setting.task),
            "rollout": self.rollout,
            "place": self.buffer.place,
            "evaluations": self.evaluation.results,
            "curve": self.curve,
            "cpu_s": self.cpu_s,
            "wall_s": self.wall_s,
        }
        metadata = {"progress": json.dumps(progress, allow_nan=False)}
        write_safetensors(self.config.out / CHECKPOINT, tensors, metadata)
        names = dict.fromkeys(name for entry in self.curve for name in entry)
        rows = [{name: entry.get(name, "") for name in names} for entry in self.curve]
        write_table(self.config.out / CURVE, rows)

    def resume(self) -> None:
        """Continue from the checkpoint of the folder, if there is one.

        Raises:
            ValueError: the checkpoint is damaged, or of a run with other options.
        """
        path = self.config.out / CHECKPOINT
        if not path.is_file():
            return
        try:
            with safe_open(path, framework="pt") as file:
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
                progress: dict[str, Any] = json.loads((file.metadata() or {})["progress"])
            made = dict(progress["config"])
        except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"checkpoint {str(path)!r} is damaged ({error}); delete the folder and train again"
            ) from error
        check_same(path, made, result_options(self.config, self.setting.task))
        self._restore(tensors, progress)
        tqdm.write(f"resuming at {self.steps:,} steps from the checkpoint in {self.config.out}")

    def _restore(self, tensors: dict[str, Tensor], progress: dict[str, Any]) -> None:
        self.actor.load_state_dict(
            {n.removeprefix("actor."): t for n, t in tensors.items() if n.startswith("actor.")}
        )
        state: dict[int, dict[str, Tensor]] = {}
        for name in (name for name in tensors if name.startswith("adam.")):
            _, number, entry = name.split(".")
            state.setdefault(int(number), {})[entry] = tensors[name]
        groups = self.adam.state_dict()["param_groups"]
        self.adam.load_state_dict({"state": state, "param_groups": groups})
        for k, part in enumerate(self.buffer.parts):
            held = tensors[f"buffer.{k}"]
            part[: len(held)] = held
            self.buffer.filled = len(held)
        self.buffer.place, self.rollout = int(progress["place"]), int(progress["rollout"])
        self.evaluation = Evaluation(self.setting, progress["evaluations"])
        self.curve = progress["curve"]
        self.cpu_s, self.wall_s = progress["cpu_s"], progress["wall_s"]

    def close(self) -> None:
        """Free the environments."""
        for core in self.cores:
            core.close()
