"""Options of the trainer; distillation: what teachers may see and teach, and that a run goes on."""

from __future__ import annotations

import dataclasses
import json
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch

from swarm_envs.training.force_model import train as module
from swarm_envs.training.force_model.examples import Examples, shuffled, turned_rows
from swarm_envs.training.force_model.force_fit_config import (
    FitConfig,
    TrainConfig,
    with_mode_defaults,
)
from swarm_envs.training.force_model.network import DeepSet, swarm_batch
from swarm_envs.training.force_model.optimisers import hold_spectral_norms
from swarm_envs.training.force_model.pipeline import fit
from swarm_envs.training.force_model.train import (
    Training,
    predict,
    symmetric_mean,
    teacher_checkpoint,
    teacher_config,
    to_batch,
    train,
    train_taught,
)
from swarm_envs.training.interaction_rows import InteractionRows, save_rows
from swarm_envs.training.provenance import scalar_writer
from tests.helpers.interrupts import calls_of
from tests.helpers.tiny_fits import PLAIN, SPEC, rows_of


def norms(network):
    return [np.linalg.norm(p.detach().numpy(), 2) for p in network.parameters() if p.ndim == 2]


def test_a_pass_takes_every_row_once_in_an_order_of_its_own():
    rows = rows_of(300)
    batch = to_batch(rows)
    examples = Examples(batch, torch.arange(300.0), torch.ones(300))
    config = dataclasses.replace(PLAIN, symmetry="none")
    first, second, again = (shuffled(examples, config, epoch) for epoch in (0, 1, 0))
    assert torch.equal(first.label.sort().values, examples.label)
    assert not torch.equal(first.label, second.label)
    assert torch.equal(first.label, again.label)
    order = first.label.long()
    for shuffled_values, values in zip(first.batch, batch, strict=True):
        assert torch.equal(shuffled_values, values[order])


@pytest.mark.parametrize("symmetry", ["square", "circle"])
def test_random_turns_keep_what_does_not_depend_on_direction(symmetry):
    examples = Examples(to_batch(rows_of(200)), torch.arange(200.0), torch.ones(200))
    moved = shuffled(examples, dataclasses.replace(PLAIN, symmetry=symmetry), 0)
    order = moved.label.long()
    old, new = examples.batch.pair[order, 0], moved.batch.pair[:, 0]
    assert torch.equal(old[:, [2, 5]], new[:, [2, 5]])
    assert torch.allclose(old[:, :2].norm(dim=1), new[:, :2].norm(dim=1), atol=1e-6)
    before, after = ((x[:, :2] * x[:, 3:5]).sum(1) for x in (old, new))
    assert torch.allclose(before, after, atol=1e-6)
    own = [b[:, 1:3] for b in (examples.batch.environment[order], moved.batch.environment)]
    before, after = ((x[:, :2] * v).sum(1) for x, v in zip((old, new), own, strict=True))
    assert torch.allclose(before, after, atol=1e-6)  # drone and neighbour turn together
    assert not torch.allclose(old, new)


def test_a_turn_is_counterclockwise():
    position = torch.tensor([[[0.0, 0.0, 1.0], [1.0, 0.0, 1.5]]])
    velocity = torch.tensor([[[0.2, 0.0, 0.1], [0.0, 0.3, 0.0]]])
    quarter = torch.tensor([[0.0, -1.0], [1.0, 0.0]]).expand(2, 2, 2)
    batch = turned_rows(swarm_batch(position, velocity, [0, 0]), quarter)
    expected = torch.tensor([0.0, 1.0, 0.5, -0.3, -0.2, -0.1])
    assert torch.allclose(batch.pair[0, 0], expected, atol=1e-6)
    assert torch.allclose(batch.environment[0], -torch.tensor([1.0, 0.0, 0.2, 0.1]), atol=1e-6)


def test_epochs_say_how_many_steps_there_are():
    rows = rows_of()
    count = int((~rows.validation).sum())
    run = train(rows, SPEC, dataclasses.replace(PLAIN, steps=None, epochs=1.5), progress=False)
    assert run.step == round(1.5 * np.ceil(count / 64))


def test_average_of_the_last_steps_is_within_the_clip():
    config = dataclasses.replace(PLAIN, average_share=0.1, learning_rate=3e-2)
    whole = train(rows_of(noise=5.0), SPEC, config, progress=False)
    assert max(norms(whole.network)) <= 3.0 * (1 + 1e-6)
    assert "average" in whole.chosen


@pytest.mark.parametrize("seed", [0, 1])
def test_average_is_nearer_the_truth_than_a_noisy_last_step(seed, monkeypatch):
    """Of steps that jump about the truth, each by itself, a share s of each leaves s / (2 - s)."""

    class Jumping(torch.optim.Optimizer):
        def __init__(self, parameters, lr):
            super().__init__(parameters, {"lr": lr})
            (self.values,) = self.param_groups[0]["params"]
            self.truth = self.values.detach().clone()
            self.rng = torch.Generator().manual_seed(seed)

        @torch.no_grad()
        def step(self, closure=None):
            noise = torch.randn(self.truth.shape, generator=self.rng)
            self.values.copy_(self.truth + 1e-2 * noise)

    monkeypatch.setattr(torch.optim, "Adam", Jumping)
    truth, errors = module.start(SPEC, PLAIN).weights.values.detach().clone(), {}
    for average in (0.0, 0.25):
        config = dataclasses.replace(PLAIN, average_share=average, spectral="none")
        network = train(rows_of(), SPEC, config, progress=False).network
        found = torch.nn.utils.parameters_to_vector(network.parameters()).detach()
        errors[average] = float(((found - truth) ** 2).mean())
    assert PLAIN.steps is not None
    share = 1.0 / (0.25 * PLAIN.steps)
    assert errors[0.25] == pytest.approx(share / (2.0 - share) * errors[0.0], rel=0.2)


@pytest.mark.parametrize("average", [0.0, 0.02])
def test_exact_normalisation_gives_every_matrix_the_norm(average):
    config = dataclasses.replace(
        PLAIN, spectral="exact", max_spectral_norm=1.7, average_share=average
    )
    run = train(rows_of(), SPEC, config, progress=False)
    assert norms(run.network) == pytest.approx([1.7] * 20, rel=1e-5)
    free = train(rows_of(), SPEC, dataclasses.replace(config, spectral="none"), progress=False)
    assert np.ptp(norms(free.network)) > 0.1


def test_zero_matrix_cannot_be_normalised_exactly():
    with pytest.raises(ValueError, match="shape \\(2, 3\\) is zero"):
        hold_spectral_norms([torch.zeros(2, 3)], 1.0, "exact")
    hold_spectral_norms([torch.zeros(2, 3)], 1.0, "clip")


def test_each_mode_has_its_own_length_unless_it_is_given():
    plain, given = TrainConfig(), TrainConfig(steps=70, average_share=0.1)
    assert (with_mode_defaults(plain).steps, with_mode_defaults(plain).average_share) == (6000, 0.0)
    measured = with_mode_defaults(plain, "measured")
    assert measured.steps is None and measured.epochs and measured.average_share
    assert measured.slope_limit is None and measured.position_jitter_m == 0.0
    kept = with_mode_defaults(given, "measured")
    assert (kept.steps, kept.epochs, kept.average_share) == (70, None, 0.1)
    assert with_mode_defaults(kept, "measured") == kept
    with pytest.raises(ValueError, match=r"steps is 70 and epochs 2\.0"):
        dataclasses.replace(given, epochs=2.0)


def test_a_measured_fit_refuses_what_it_would_leave_out():
    """Rather than to be told a slope limit and to train without."""
    with pytest.raises(ValueError, match=r"slope_limit is 100\.0, but a measured fit takes None"):
        with_mode_defaults(TrainConfig(slope_limit=100.0), "measured")
    assert with_mode_defaults(TrainConfig(slope_limit=100.0)).slope_limit == 100.0
    assert with_mode_defaults(TrainConfig(slope_limit=None), "measured").balance == 0.0


def test_event_files_hold_the_history_and_are_optional(tmp_path, monkeypatch):
    """A writer that notes what it is given; the package itself may be missing."""
    written, closed = [], []

    class Writer:
        def __init__(self, folder):
            assert folder == str(tmp_path)

        def add_scalar(self, name, value, step):
            written.append((name, value, step))

        def close(self):
            closed.append(True)

    module = types.ModuleType("torch.utils.tensorboard")
    vars(module)["SummaryWriter"] = Writer
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    with scalar_writer(tmp_path) as watch:
        run = train(rows_of(), SPEC, PLAIN, progress=False, watch=watch)
    assert written == [(n, e[n], e["step"]) for e in run.history for n in ("loss", "validation")]
    assert closed == [True]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with scalar_writer(None) as watch:
        assert watch is None
    with pytest.raises(ImportError, match=r"envs\[tensorboard\]"), scalar_writer(tmp_path):
        pass


@pytest.mark.parametrize("name", ["validation", "neighbor", "flight"])
def test_checkpoint_of_other_rows_or_options_is_refused(name, tmp_path):
    """The same labels split otherwise would train on rows whose error is then called validation."""
    rows, path = rows_of(), tmp_path / "checkpoint.safetensors"
    short = dataclasses.replace(PLAIN, steps=2)
    train(rows, SPEC, short, path, progress=False)
    train(rows, SPEC, short, path, progress=False)
    other = dataclasses.replace(rows, **{name: getattr(rows, name)[::-1].copy()})
    with pytest.raises(ValueError, match="was made with other options: rows is"):
        train(other, SPEC, short, path, progress=False)
    with pytest.raises(ValueError, match=r"options: training.seed is 0 there, 1 here; choose"):
        train(rows, SPEC, dataclasses.replace(short, seed=1), path, progress=False)


TAUGHT = dataclasses.replace(
    PLAIN,
    steps=None,
    epochs=2.0,
    teachers=2,
    teacher_epochs=2.0,
    optimiser="soap",
    schedule="constant",
    average_share=0.2,
)


def vector(run: Training) -> torch.Tensor:
    return torch.nn.utils.parameters_to_vector(run.network.parameters()).detach()


def other_labels(rows: InteractionRows, changed: np.ndarray) -> InteractionRows:
    return rows.with_vertical_force(np.where(changed, 30.0, rows.force_g[:, 2]))


def test_the_mean_over_symmetries_is_symmetric() -> None:
    torch.manual_seed(0)
    network, rows = DeepSet(SPEC), rows_of(50, flights=1)
    with torch.no_grad():
        for weight in network.parameters():
            weight.mul_(3.0)  # or it hardly depends on its inputs
    found = symmetric_mean(network, to_batch(rows))
    assert not torch.allclose(found, predict(network, to_batch(rows)), atol=0.01)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    both = np.kron(np.eye(2), quarter)
    turned = dataclasses.replace(
        rows, velocity=rows.velocity @ quarter.T, neighbor=rows.neighbor @ both.T
    )
    assert torch.allclose(found, symmetric_mean(network, to_batch(turned)), rtol=1e-4)


def test_the_network_learns_what_teachers_say() -> None:
    rows = rows_of(1000, flights=1)
    config = dataclasses.replace(TAUGHT, teachers=1, epochs=60.0, teacher_epochs=3.0)
    teacher = train(rows, SPEC, teacher_config(config, 1), progress=False)
    taught = train_taught(rows, SPEC, config, progress=False)
    told = symmetric_mean(teacher.network, to_batch(rows)).numpy()
    training = ~rows.validation
    answer = predict(taught.network, to_batch(rows)).numpy()
    own = predict(teacher.network, to_batch(rows)).numpy()
    from_lesson = np.mean((answer - told)[training] ** 2)
    assert from_lesson < 0.5 * np.mean((own - told)[training] ** 2)
    assert from_lesson < 0.5 * np.mean((answer - rows.force_g[:, 2])[training] ** 2)
    error = np.mean((answer - rows.force_g[:, 2])[rows.validation] ** 2)
    assert taught.history[-1]["validation"] == pytest.approx(error, rel=1e-3)
    assert "taught by 1 network" in taught.chosen


def test_held_out_rows_teach_nobody() -> None:
    rows = rows_of(1000, flights=1)
    first = train_taught(rows, SPEC, TAUGHT, progress=False)
    again = train_taught(other_labels(rows, rows.validation), SPEC, TAUGHT, progress=False)
    assert torch.equal(vector(first), vector(again))


@pytest.mark.parametrize(("killed_at", "left"), [(5, 78), (40, 42), (65, 16)])
def test_killed_run_goes_on_with_the_network_it_was_at(
    killed_at: int, left: int, tmp_path: Path
) -> None:
    rows, path = rows_of(1000, flights=1), tmp_path / "checkpoint.safetensors"
    config = dataclasses.replace(TAUGHT, slope_limit=50.0, slope_inputs=16, position_jitter_m=0.02)
    whole = train_taught(rows, SPEC, config, progress=False)
    with calls_of(module, "_step", killed_at), pytest.raises(KeyboardInterrupt):
        train_taught(rows, SPEC, config, path, progress=False)
    with calls_of(module, "_step") as calls:
        resumed = train_taught(rows, SPEC, config, path, progress=False)
    assert torch.equal(vector(whole), vector(resumed))
    assert resumed.history == whole.history
    assert len(calls) == left  # of 26 steps for each of three networks
    assert teacher_checkpoint(path, 1).exists()


def test_fit_records_its_teachers_and_removes_their_checkpoints(tmp_path: Path) -> None:
    save_rows(tmp_path / "rows.npz", rows_of(1000, flights=1))
    config = FitConfig(data=tmp_path / "rows.npz", out=tmp_path / "out", mode="measured",
                       epochs=1.0, teachers=1, teacher_epochs=1.0, lipschitz_samples=0,
                       progress=False)  # fmt: skip
    fit(config)
    assert sorted(p.name for p in config.out.iterdir()) == ["learned.json", "learned.safetensors"]
    written = json.loads((config.out / "learned.json").read_text())
    assert (written["config"]["optimiser"], written["config"]["teachers"]) == ("soap", 1)
    assert "taught by 1 network" in written["chosen"]
