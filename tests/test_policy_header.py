"""The exported policy, compiled by a C compiler and held against the numpy policy in flight."""

from __future__ import annotations

import itertools
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarm_envs import make
from swarm_envs.agents import load
from swarm_envs.agents.c_header import costs, policy_header
from swarm_envs.agents.c_samples import KnownState, decide, draw_state
from swarm_envs.agents.feature_sets import GOAL, REFERENCE, TYPED
from swarm_envs.agents.networks import ANY, Layers, Network, to_tensors
from swarm_envs.agents.policy import PolicyAgent
from swarm_envs.agents.policy_file import Policy, PolicyNote
from swarm_envs.cli import main
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.interactions import load as load_model
from swarm_envs.interactions.c_header import c_header
from swarm_envs.vehicles import VEHICLES
from tests.helpers.c_programs import MOST, ROW, as_row, build, in_c, needs_compiler

SHIPPED = ("swap-ppo", "swap-ppo-8", "formation-ppo", "ring-ppo")


def layers(rng: np.random.Generator, *widths: int) -> Layers:
    """Random layers of a network."""
    return tuple(
        (
            rng.normal(0.0, into**-0.5, (out, into)).astype(np.float32),
            rng.normal(0.0, 0.3, out).astype(np.float32),
        )
        for into, out in itertools.pairwise(widths)
    )


def odd_policy(
    features: str, encoder: str, pooling: str, per_type: bool, action: str = "velocity"
) -> Policy:
    """Random networks of odd widths."""
    rng = np.random.default_rng(3)
    typed = features != GOAL
    types = ("S", "S*") if typed else ()
    note = PolicyNote(
        "swap_v0", 6, action, 12, 3, features, encoder, pooling, types, per_type and typed
    )
    sizes, width = note.sizes, ACTIONS[action].width
    networks = {}
    for owner in note.plan.owners:
        phi = None
        if encoder == "deep-set":
            phi = {token: layers(rng, sizes.neighbor, 9, 5) for token in types or (ANY,)}
        told = sizes.own + 5 if phi else sizes.width
        networks[owner] = Network(layers(rng, told, 11, 7, width), phi, pooling)
    note.plan.networks(to_tensors(networks))  # such a policy could come from a file
    return Policy(note, networks, {"config": {"name": "closes /* the */ comment"}})


def edge_states(policy: Policy, rng: np.random.Generator) -> list[KnownState]:
    """Nobody there, fewer than are seen, all in one place, at the goal, equally near, fast."""
    found = [draw_state(policy, others, rng) for others in (0, 0, 1, 1, 2, 8)]
    for scale in (0.0, 1e-4):
        state = draw_state(policy, 5, rng)
        near = state.position[:1] + np.float32(scale) * state.position
        found += [state._replace(position=near), state._replace(goal=state.position)]
        found += [state._replace(velocity=np.float32(scale) * state.velocity)]
    state = draw_state(policy, 4, rng)
    sides = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], np.float32)
    found += [state._replace(position=sides), state._replace(velocity=8.0 * state.velocity)]
    far = state.position * np.float32(20.0)
    return [*found, state._replace(position=far)]


def states(policy: Policy, count: int) -> list[KnownState]:
    """Random and odd ones."""
    rng = np.random.default_rng(0)
    drawn = [draw_state(policy, int(rng.integers(0, MOST)), rng) for _ in range(count)]
    return [*drawn, *edge_states(policy, rng)]


@needs_compiler
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_policies_in_c(name: str, tmp_path: Path) -> None:
    agent = load(name)
    assert isinstance(agent, PolicyAgent)
    found = states(agent.policy, 2000)
    out = in_c(agent.policy, tmp_path, np.stack([as_row(state) for state in found]))
    expected = decide(agent.policy, found)
    assert out[:, 0].all()
    assert np.ptp(expected, axis=0).min() > 0.5
    np.testing.assert_allclose(out[:, 1:4], expected, rtol=0.0, atol=1e-5)


@needs_compiler
@pytest.mark.parametrize("pooling", ["mean", "max", "sum"])
@pytest.mark.parametrize("per_type", [False, True])
@pytest.mark.parametrize("features", [GOAL, TYPED, REFERENCE])
def test_any_deep_set_in_c(features: str, per_type: bool, pooling: str, tmp_path: Path) -> None:
    policy = odd_policy(features, "deep-set", pooling, per_type)
    found = states(policy, 200)
    out = in_c(policy, tmp_path, np.stack([as_row(state) for state in found]))
    np.testing.assert_allclose(out[:, 1:4], decide(policy, found), rtol=0.0, atol=1e-5)


@needs_compiler
@pytest.mark.parametrize(
    ("features", "per_type", "action"),
    [(TYPED, True, "acceleration"), (TYPED, False, "ctbr"), (GOAL, False, "rotors")],
)
def test_any_perceptron_in_c(features: str, per_type: bool, action: str, tmp_path: Path) -> None:
    policy = odd_policy(features, "mlp", "mean", per_type, action)
    found = states(policy, 200)
    out = in_c(policy, tmp_path, np.stack([as_row(state) for state in found]))
    expected = decide(policy, found)
    np.testing.assert_allclose(out[:, 1 : 1 + expected.shape[1]], expected, rtol=0.0, atol=1e-5)


def flown(agent: PolicyAgent, task: str, seed: int, **options: Any) -> tuple[np.ndarray, ...]:
    """What is known to every drone at each decision, what it did, and its set-point afterwards."""
    env = make(task, physics="batch", **dict(agent.requires), **options)
    rows, actions, after = [], [], []
    seen, _ = env.reset(seed=seed)
    agent.reset(env, seed)
    tokens = [list(VEHICLES).index(vehicle.token) for vehicle in env.view.team]
    while env.agents:
        view, decided = env.view, agent.act(seen, None)
        state, setpoint, reference = view.state, view.setpoint, view.reference(view.time)
        moving = np.concatenate([state.position, state.velocity, view.goals], axis=1)
        for i in range(len(tokens)):
            row = np.zeros((), ROW)
            order = [i, *(j for j in range(len(tokens)) if j != i)]
            row["others"], row["types"][: len(order)] = len(order) - 1, np.take(tokens, order)
            row["moving"][: len(order)] = moving[order]
            x, y, z, w = state.quaternion[i]
            row["up"] = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
            row["thrust"] = state.rotor_thrust[i].sum() / view.team[i].max_thrust
            row["setpoint"] = np.concatenate([part[i] for part in setpoint[:4]])
            row["task"][0] = 1.0 - view.time / view.horizon_s
            if agent.policy.note.features == REFERENCE:
                row["task"] = np.concatenate([part[i] for part in reference[:3]])
            row["dt"] = 1.0 / agent.policy.note.decision_rate
            rows.append(row)
        actions += list(decided.values())
        seen = env.step(decided)[0]
        after += [
            np.concatenate([part[i] for part in view.setpoint[:4]]) for i in range(len(tokens))
        ]
    env.close()
    return np.stack(rows), np.array(actions), np.array(after)


def equally_near(row: np.ndarray) -> bool:
    """Whether rounding to single precision decides which of two others is nearer."""
    place = row["moving"][: 1 + row["others"], :3].astype(np.float64)
    gaps = np.diff(np.sort(np.linalg.norm(place[1:] - place[0], axis=1)))
    return bool((gaps < 1e-6).any())


@needs_compiler
@pytest.mark.parametrize(
    ("name", "task", "options"),
    [("swap-ppo", "swap_v0", {"num_drones": 4}), ("ring-ppo", "ring_v0", {"horizon_s": 3.0})],
)
def test_it_decides_and_steers_as_in_flight(
    name: str, task: str, options: dict[str, Any], tmp_path: Path
) -> None:
    """Against the environment itself: its observations, its set-points."""
    agent = load(name)
    assert isinstance(agent, PolicyAgent)
    rows, actions, after = flown(agent, task, 3, **options)
    clear = [not equally_near(row) for row in rows]
    assert np.mean(clear) > 0.9
    out = in_c(agent.policy, tmp_path, rows)[clear]
    assert out[:, 0].all()
    np.testing.assert_allclose(out[:, 1:4], actions[clear], rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(out[:, 5:14], after[clear, :9], rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(out[:, 14:], after[clear, 9:], rtol=0.0, atol=1e-3)


@needs_compiler
def test_what_is_not_finite_or_unknown_asks_for_nothing(tmp_path: Path) -> None:
    policy = odd_policy(TYPED, "mlp", "mean", False)
    good = as_row(draw_state(policy, 4, np.random.default_rng(1)))
    broken = []
    for field, at in (("moving", (0, 1)), ("moving", (2, 4)), ("moving", (4, 8)), ("up", 1)):
        row = good.copy()
        row[field][at] = np.nan
        broken.append(row)
    for field, value in (("thrust", np.inf), ("task", np.nan)):
        row = good.copy()
        row[field] = value
        broken.append(row)
    for at in (0, 3):
        row = good.copy()
        row["types"][at] = list(VEHICLES).index("L")  # it was trained with S and S*
        broken.append(row)
    out = in_c(policy, tmp_path, np.stack([*broken, good]))
    assert not out[:-1, :4].any()
    assert out[-1, 0] == 1.0
    assert out[-1, 1:4].any()


@needs_compiler
@pytest.mark.parametrize("names", [("policy", "learned"), ("a", "b")])
def test_both_headers_go_into_one_program(names: tuple[str, str], tmp_path: Path) -> None:
    """In either order, and in two files of one program."""
    agent = load("swap-ppo")
    assert isinstance(agent, PolicyAgent)
    pilot, force = names
    (tmp_path / f"{pilot}.h").write_text(policy_header(agent.policy, pilot))
    (tmp_path / f"{force}.h").write_text(c_header(load_model("learned"), force))
    tests = [f'#define {name.upper()}_SELF_TEST\n#include "{name}.h"\n' for name in names]
    check = f"{pilot}_self_test() < 1e-5f && {force}_self_test() < 1e-3f"
    one, main_text = "int one(void);\nint one(void)", "int one(void);\nint main(void)"
    (tmp_path / "one.c").write_text(f"{''.join(tests)}{one} {{ return {check}; }}\n")
    backwards = "".join(reversed(tests))
    (tmp_path / "two.c").write_text(f"{backwards}{main_text} {{ return !(one() && {check}); }}\n")
    build(tmp_path, "one.c", "two.c")
    assert subprocess.run([tmp_path / "program"]).returncode == 0


def test_the_header_says_what_it_is() -> None:
    agent = load("swap-ppo")
    assert isinstance(agent, PolicyAgent)
    text = policy_header(agent.policy, "pilot")
    assert agent.digest in text
    assert "double" not in text
    assert "malloc" not in text
    assert "policy_" not in text.replace("swap_ppo", "")
    assert text == policy_header(agent.policy, "pilot")
    assert text != policy_header(agent.policy, "pilot", seed=1)
    with pytest.raises(ValueError, match="name is '2fast', but must be a letter"):
        policy_header(agent.policy, "2fast")


def test_costs_are_counted() -> None:
    """69 features, two hidden layers of 64, three actions; five functions a neighbour."""
    agent = load("swap-ppo")
    assert isinstance(agent, PolicyAgent)
    found = costs(agent.policy)
    assert found.products == 69 * 64 + 64 * 64 + 64 * 3
    assert found.flash_bytes == 4 * (found.products + 64 + 64 + 3)
    assert found.functions == 128 + 1 + 3 * 5
    set_of = costs(odd_policy(TYPED, "deep-set", "mean", False))
    assert set_of.products == 3 * (20 * 9 + 9 * 5) + (21 + 5) * 11 + 11 * 7 + 7 * 3
    assert set_of.functions == 3 * (9 + 5) + 11 + 7 + 1 + 3 * 5


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, facts = tmp_path / "pilot.h", tmp_path / "facts.json"
    call = ["export", "policy", "--out", str(out)]
    assert main([*call, "--policy", "swap-ppo", "--json", str(facts)]) == 0
    agent = load("swap-ppo")
    assert isinstance(agent, PolicyAgent)
    assert out.read_text() == policy_header(agent.policy, "pilot")
    told = json.loads(facts.read_text())
    assert told["weights_sha256"] == agent.digest
    assert told["flash_bytes"] == costs(agent.policy).flash_bytes
    assert "pilot_act" in capsys.readouterr().out
    assert main([*call, "--policy", "hover"]) == 2
    assert "'hover' is no trained policy" in capsys.readouterr().err
    assert main([*call, "--policy", "swap-ppx"]) != 0
