"""The validator and the instances, against known answers and the tools beside the checkout."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from swarm_envs.baselines.rth3d import FAMILIES, GridPlan, make_instance, plan, validate
from swarm_envs.baselines.rth3d.grid import check_instance
from swarm_envs.baselines.rth3d.grid_validation import MOVES, as_vertices, check_paths
from tests.baselines.rth3d.cases import load_checker, load_tool

SQUARE = np.array([[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]])


def report(*rows, shape=(2, 2, 2)):
    paths = np.array(rows)
    return validate(paths, paths[0], paths[-1], shape)


def test_a_ring_of_four_may_turn():
    found = report(SQUARE, np.roll(SQUARE, -1, axis=0))
    assert found and (found.makespan, found.sum_of_costs, found.moves) == (1, 4, 4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_may_follow_another_along_each_axis(axis):
    train = np.zeros((2, 3), dtype=int)
    train[1, axis] = 1
    move = np.eye(3, dtype=int)[axis]
    assert report(train, train + move, shape=(3, 3, 3))
    assert "swaps places" in report(train, train[::-1], shape=(3, 3, 3)).reason


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ([SQUARE[:2], SQUARE[1::-1]], "swaps places with another robot at time 1"),
        ([SQUARE[:2], SQUARE[[1, 1]], SQUARE[:2]], "on the vertex of another robot at time 1"),
        ([SQUARE[:1], SQUARE[2:3]], "moves by more than one edge at time 1"),
        ([[[0, 0, 1]], [[0, 1, 0]]], "moves by more than one edge"),
        (
            [
                [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)],
                [(0, 0, 1), (1, 1, 0), (1, 1, 0), (0, 0, 0)],  # the last follows the first
                [(0, 0, 1), (0, 1, 0), (1, 1, 0), (0, 0, 0)],
            ],
            "robot 1 is on the vertex of another robot at time 1",
        ),
        ([[[0, 0, 0]], [[0, 0, -1]], [[0, 0, 0]]], "leaves the grid at time 1"),
        ([[[0, 0, 0]], [[70000, 0, 0]], [[0, 0, 0]]], "leaves the grid at time 1"),
    ],
)
def test_what_is_broken_is_named(rows, reason):
    found = report(*rows)
    assert not found
    assert reason in found.reason


def test_goals_belong_to_robots_and_paths_to_all_of_them():
    turn = np.stack([SQUARE, np.roll(SQUARE, -1, axis=0)])
    assert "end" in validate(turn, turn[0], turn[1, ::-1], (2, 2, 2)).reason
    for wrong in (turn[0], turn[:0], np.repeat(turn, 2, axis=1)):
        with pytest.raises(ValueError, match="paths have shape"):
            validate(wrong, turn[0], turn[1], (2, 2, 2))


def judged_plainly(paths, starts, goals, walls):
    """The rule that is broken first, robot and time; or makespan, sum of costs and moves."""
    steps, count = range(1, len(paths)), range(len(starts))
    for robot in count:
        if paths[0][robot] != starts[robot]:
            return "begin", robot, 0
    for robot in count:
        if paths[-1][robot] != goals[robot]:
            return "end", robot, len(paths) - 1
    for time in steps:
        before, now = paths[time - 1], paths[time]
        for robot in count:
            place, away = now[robot], sum(map(abs, np.subtract(now[robot], before[robot])))
            if place not in walls:
                return "leaves", robot, time
            if walls[place]:
                return "obstacle", robot, time
            if away > 1:
                return "more than one edge", robot, time
            met = [k for k in count if before[k] == place and now[k] == before[robot] != place]
            if met:
                return "swaps", robot, time
        stay = {now[robot] for robot in count if now[robot] == before[robot]}
        for robot in count:
            if now[robot] != before[robot] and now[robot] in stay:
                return "vertex of another", robot, time
            stay.add(now[robot])
    moved = [[t for t in steps if paths[t][k] != paths[t - 1][k]] for k in count]
    last = [max(times, default=0) for times in moved]
    return max(last), sum(last), sum(map(len, moved))


def test_what_is_broken_first_and_what_a_plan_costs_is_as_plain_code_says():
    rng, shape, verdicts = np.random.default_rng(0), (2, 3, 2), []
    places = [(int(x), int(y), int(z)) for x, y, z in np.ndindex(shape)]
    for _ in range(1500):
        walls = dict.fromkeys(places, False)
        starts = [places[k] for k in rng.permutation(len(places))[: rng.integers(1, 6)]]
        for place in rng.permutation(places)[: rng.integers(3)].tolist():
            walls[tuple(place)] = tuple(place) not in starts
        paths = [starts]
        for _ in range(rng.integers(4)):
            steps = np.vstack([np.eye(3), -np.eye(3), np.zeros((3, 3))])[rng.integers(9, size=9)]
            paths.append([tuple((np.array(p) + s).astype(int)) for p, s in zip(paths[-1], steps)])
        goals = paths[-1]
        if rng.random() < 0.2:
            changed = paths[rng.integers(len(paths))]
            changed = paths[rng.integers(len(paths))] = list(changed)
            changed[rng.integers(len(changed))] = tuple(rng.integers(-1, 4, size=3).tolist())
        free = {place for place in places if not walls[place]}
        if len({*goals} & free) < len(starts):
            continue  # no instance
        wall = np.array([walls[place] for place in places]).reshape(shape)
        found = validate(np.array(paths), starts, goals, shape, wall)
        expected = judged_plainly(paths, starts, goals, walls)
        if found:
            assert expected == (found.makespan, found.sum_of_costs, found.moves)
            instance = check_instance(starts, goals, shape, wall)
            _, moves = check_paths(as_vertices(np.array(paths), shape), instance)
            np.testing.assert_array_equal(MOVES[moves], np.diff(paths, axis=0))
        else:
            assert expected[0] in found.reason and expected[1:] == (found.robot, found.time)
            assert (found.makespan, found.sum_of_costs, found.moves) == (0, 0, 0)
        verdicts.append(expected[0] if not found else "")
    assert len({*verdicts}) == 8


def test_damaged_plans_are_judged_as_by_the_other_checker(shared_data):
    checker = load_checker(shared_data)
    instance = make_instance("uniform", (9, 6, 3), seed=0)
    good = plan(**instance.fields(), method="rth3d-lba").paths
    rng = np.random.default_rng(0)
    verdicts = []
    for _ in range(200):
        paths = good.copy()
        time, robot = rng.integers(len(paths)), rng.integers(paths.shape[1])
        other = rng.integers(paths.shape[1])
        kind = rng.integers(3)
        if kind == 0:
            paths[time, robot] = rng.integers((9, 6, 3))
        elif kind == 1:
            paths[: time + 1, [robot, other]] = paths[: time + 1, [other, robot]]
        else:
            paths[time:-1, robot] = paths[time + 1 :, robot]
        theirs = checker(instance, paths)["ok"]
        assert bool(validate(paths, **instance.fields())) == theirs
        verdicts.append(theirs)
    assert 0 < sum(verdicts) < len(verdicts)


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_is_drawn_from_its_seed(name):
    first, second, other = (make_instance(name, (18, 18, 9), seed=s) for s in (1, 1, 2))
    assert first.starts.tobytes() == second.starts.tobytes()
    assert first.goals.tobytes() == second.goals.tobytes()
    assert name == "rings" or first.starts.tobytes() != other.starts.tobytes()
    assert first.density == pytest.approx(2 / 9 if FAMILIES[name].buildings else 1 / 3)


def test_rings_are_those_of_the_other_tool(shared_data):
    tool = load_tool(shared_data / "tools" / "mapf" / "instances.py")
    shape, starts, goals = tool.rings(12)
    instance = make_instance("rings", shape)
    pairs = {tuple(row) for row in np.hstack([starts, goals]).tolist()}
    assert pairs == {tuple(row) for row in np.hstack([instance.starts, instance.goals]).tolist()}


def test_blocks_move_as_a_whole():
    for name, parts in (("blocks", 3), ("small-blocks", 6)):
        instance = make_instance(name, (18, 18, 18), seed=4)
        sides = 18 // parts
        pairs = np.hstack([instance.starts // sides, instance.goals // sides])
        assert len(np.unique(pairs, axis=0)) == parts**3


def test_a_plan_is_read_as_it_was_written(tmp_path):
    instance = make_instance("buildings", (9, 9, 4), 40, seed=0)
    found = plan(**instance.fields())
    found.save(tmp_path / "plan.npz")
    again = GridPlan.load(tmp_path / "plan.npz")
    assert again.paths.tobytes() == found.paths.tobytes() and again.phases == found.phases
    assert (again.winner, again.bound, again.ratio) == (found.winner, found.bound, found.ratio)
    (tmp_path / "cut.npz").write_bytes((tmp_path / "plan.npz").read_bytes()[:-200])
    with pytest.raises(ValueError, match="no plan, or damaged"):
        GridPlan.load(tmp_path / "cut.npz")
    with pytest.raises(ValueError, match="suffix"):
        found.save(tmp_path / "plan.pkl")


def test_a_byte_that_has_changed_is_refused_or_changes_no_move(tmp_path):
    found = plan([[0, 0, 0], [2, 0, 0]], [[2, 0, 0], [0, 0, 0]], (3, 2, 1))
    found.save(tmp_path / "plan.npz")
    whole = (tmp_path / "plan.npz").read_bytes()
    for place in range(len(whole)):
        content = bytearray(whole)
        content[place] ^= 1 + place % 255
        (tmp_path / "changed.npz").write_bytes(content)
        with suppress(ValueError):
            assert np.array_equal(GridPlan.load(tmp_path / "changed.npz").moves, found.moves)
    replace(found, bound=1).save(tmp_path / "changed.npz")
    with pytest.raises(ValueError, match="its bound is 1, but"):
        GridPlan.load(tmp_path / "changed.npz")
