"""Which entries become rows, and which rows are held out."""

from __future__ import annotations

import numpy as np
import pytest

from swarm_envs.training.collection.table import DroneRows
from swarm_envs.training.flight_logs import LogOptions
from swarm_envs.training.flight_logs.clock import filtered
from swarm_envs.training.flight_logs.log_options import held_out_blocks, is_guarded, is_held_out


def rows_of(height, force_z_g, shift):
    count = len(height)
    zeros = np.zeros((count, 3))
    up = np.array([0.0, 0.0, 1.0])
    neighbor = np.zeros((count, 1, 6))
    neighbor[:, 0, :3] = shift
    return DroneRows(
        name="cf0",
        ego_type=0,
        scenario="S2S",
        step=np.arange(count),
        position=np.outer(height, up),
        velocity=zeros,
        neighbor=neighbor,
        neighbor_type=np.zeros((count, 1), dtype=np.int64),
        force_g=np.outer(force_z_g, up),
        dropped={},
    )


def test_the_authors_filter():
    near, nan = (0.0, 0.0, 0.3), np.nan
    cases = [  # height, force, shift, reason
        (1.0, -5.0, near, None),
        (1.0, -5.0, (0.35, -0.35, 1.1), None),
        (1.0, -5.0, (0.36, 0.0, 0.3), "no neighbour in the volume"),
        (1.0, -5.0, (0.0, 0.0, -1.2), "no neighbour in the volume"),
        (0.07, -5.0, near, "too low"),
        (0.071, -5.0, near, None),
        (1.0, -50.1, near, "force over 50 g"),
        (0.2, 50.1, near, "force over 50 g"),
        (1.0, 35.1, near, "upward force over 35 g aloft"),
        (0.25, 35.1, near, None),
        (1.0, -49.9, near, None),
        (1.0, nan, near, "force unknown"),
    ]
    heights, forces, shifts, reasons = zip(*cases, strict=True)
    kept = filtered(rows_of(heights, forces, shifts), 0.07)
    assert kept.step.tolist() == [k for k, reason in enumerate(reasons) if reason is None]
    for reason in set(reasons) - {None}:
        assert kept.dropped[reason] == reasons.count(reason)


@pytest.mark.parametrize("lengths", [[1], [2, 1], [5, 5, 5, 5], [3] * 40])
def test_one_in_five_blocks_is_held_out(lengths):
    chosen = held_out_blocks(lengths, 0.2, seed=0)
    assert [len(blocks) for blocks in chosen] == lengths
    count = int(np.concatenate(chosen).sum())
    assert (count >= 1) == (sum(lengths) > 1)
    assert abs(count - sum(lengths) / 5) < 1
    again = held_out_blocks(lengths, 0.2, seed=0)
    assert all((a == b).all() for a, b in zip(chosen, again, strict=True))


def test_the_guard_keeps_training_away_from_held_out_blocks():
    options = LogOptions(block_s=5.0, guard_s=0.5)
    blocks = np.array([False, True, False])
    time = np.arange(0.0, 15.0, 0.01)
    held_out, guarded = is_held_out(time, blocks, options), is_guarded(time, blocks, options)
    assert (time[held_out] >= 5.0).all() and (time[held_out] < 10.0).all()
    assert not (held_out & guarded).any()
    training = time[~held_out & ~guarded]
    assert np.abs(training[:, None] - time[held_out][None]).min() >= 0.5
    assert len(training) == pytest.approx(900, abs=3)
