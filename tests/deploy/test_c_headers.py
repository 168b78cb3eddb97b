"""Exported policies and force models, compiled by a C compiler and held against the simulator.

The commands and the C of the page about deployment run too.
"""

from __future__ import annotations

import itertools
import json
import re
import shlex
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from swarm_envs import make
from swarm_envs.agents import load, registry
from swarm_envs.agents.c_header import KnownState, costs, decide, draw_state, policy_header
from swarm_envs.agents.features import FULL, GOAL, REFERENCE, TYPED
from swarm_envs.agents.networks import POOLINGS, Layers, Network, to_tensors
from swarm_envs.agents.policy import Policy, PolicyAgent, PolicyNote
from swarm_envs.cli import main
from swarm_envs.envs.actions import ACTIONS
from swarm_envs.interactions import InteractionModel
from swarm_envs.interactions import load as load_model
from swarm_envs.interactions.c_header import c_header
from swarm_envs.interactions.forces import all_forces
from swarm_envs.vehicles import GRAM_FORCE, VEHICLES

COMPILER = next(filter(None, map(shutil.which, ("gcc", "cc", "clang"))), None)
STRICT = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wdouble-promotion"]
STRICT += ["-Wconversion", "-Wshadow", "-ffp-contract=off"]
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
MOST = 9  # drones in a row of the program's input

# Reads states of up to nine drones and a set-point, writes what the drone does and what becomes of
# the set-point in a decision of so many seconds.
PROGRAM = """
#define PILOT_SELF_TEST
#include "pilot.h"
#include <stdio.h>
struct row { int others; float dt; struct pilot_drone drones[9]; struct pilot_own own; @set@; };
struct out { float sound, action[4]; @set@; };
int main(void)
{
    struct row r;
    while (fread(&r, sizeof r, 1, stdin) == 1) {
        struct out out = {0};
        out.sound = (float)pilot_act(r.drones, &r.own, r.others, r.drones + 1, out.action);
        @steer@
        if (fwrite(&out, sizeof out, 1, stdout) != 1) return 2;
    }
    return pilot_self_test() < 1e-5f ? 0 : 1;
}
"""
STEER = "pilot_steer(out.action, &r.s); pilot_advance(&r.s, r.dt); out.s = r.s;"
VECTOR = (np.float32, 3)
DRONE = np.dtype(
    [("position", *VECTOR), ("velocity", *VECTOR), ("goal", *VECTOR), ("type", np.int32)]
)


def as_row(state: KnownState, force: bool = False) -> np.ndarray:
    """A row of the program's input, its set-point at rest; `force`: one is predicted."""
    own: list[Any] = [("up", *VECTOR), ("thrust", np.float32), ("setpoint", *VECTOR)]
    own += [("task", np.float32, len(state.task))]
    own += [("force", *VECTOR)] * force
    near = state.near[3 * force :]
    if len(near):  # how many obstacles are where
        own += [("count", np.int32), ("ways", np.float32, len(near) - 1)]
    own += [("steered", np.float32, 12)]
    drone = np.dtype(DRONE.descr + [("load", *VECTOR)] * bool(state.load.shape[1]))
    head = [("others", np.int32), ("dt", np.float32), ("drones", drone, MOST)]
    row = np.zeros((), np.dtype([*head, *own]))
    count = len(state.position)
    row["others"], row["dt"], row["drones"]["type"][:count] = count - 1, 0.1, state.types
    for name in ("position", "velocity", "goal"):
        row["drones"][name][:count] = getattr(state, name)
    for name in ("up", "thrust", "setpoint", "task"):
        row[name] = getattr(state, name)
    if state.load.shape[1]:
        row["drones"]["load"][:count] = state.load
    if force:
        row["force"] = state.near[:3]
    if len(near):
        row["count"], row["ways"] = near[0], near[1:]
    row["steered"][:3] = state.setpoint
    return row


def build(folder: Path, *sources: str) -> None:
    """Compile sources in a folder into a program called `program`."""
    command = [str(COMPILER), *STRICT, *sources, "-o", "program", "-lm"]
    subprocess.run(command, cwd=folder, check=True)


def run_program(folder: Path, source: str, rows: np.ndarray) -> np.ndarray:
    """What a program that includes a header writes for rows, as float32."""
    (folder / "program.c").write_text(source)
    build(folder, "program.c")
    done = subprocess.run([folder / "program"], input=rows.tobytes(), capture_output=True)
    assert done.returncode == 0, "the header's own test finds it wrong"
    return np.frombuffer(done.stdout, np.float32)


def in_c(policy: Policy, folder: Path, rows: np.ndarray) -> np.ndarray:
    """(rows, 17): whether it decided, its action, the set-point after the decision."""
    (folder / "pilot.h").write_text(policy_header(policy, "pilot"))
    steers = policy.note.action in ("acceleration", "velocity")
    program = PROGRAM.replace("@steer@", STEER if steers else "")
    program = program.replace("@set@", "struct pilot_setpoint s" if steers else "float s[12]")
    return run_program(folder, program, rows).reshape(-1, 17)


def shipped(name: str) -> PolicyAgent:
    agent = load(name)
    assert isinstance(agent, PolicyAgent)
    return agent


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
    features: str,
    encoder: str,
    pooling: str,
    per_type: bool,
    action: str = "velocity",
    activation: str = "tanh",
    **senses: Any,
) -> Policy:
    """Random networks of odd widths."""
    rng = np.random.default_rng(3)
    typed = features != GOAL
    types = ("S", "S*") if typed else ()
    note = PolicyNote(
        *("swap_v0", 6, action, 12, 3, features, encoder, pooling, types),
        per_type=per_type and typed,
        activation=activation,
        **senses,
    )
    sizes, width = note.sizes, ACTIONS[action].width
    networks = {}
    for owner in note.owners:
        inputs, phi = sizes.width, None
        if encoder != "mlp":
            phi = layers(rng, sizes.own + sizes.neighbor, 9, 5)
            inputs = sizes.own + (10 if pooling == "max-sum" else 5)
        score = layers(rng, 10, 4, 1) if encoder == "attention" else None
        actor = layers(rng, inputs, 11, 7, width)
        networks[owner] = Network(actor, phi, score, pooling, activation)
    note.networks(to_tensors(networks))  # such a policy could come from a file
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


POLICIES = [
    *((shipped, (name,)) for name in registry.POLICIES),
    *((odd_policy, (kind, "deep-set", "mean", True)) for kind in (GOAL, TYPED, REFERENCE)),
    *((odd_policy, (TYPED, "deep-set", pooling, False)) for pooling in POOLINGS),
    (odd_policy, (GOAL, "deep-set", "max-sum", False, "acceleration", "relu")),
    (odd_policy, (TYPED, "attention", "mean", True)),
    (odd_policy, (REFERENCE, "attention", "mean", False, "velocity", "relu")),
    (odd_policy, (TYPED, "mlp", "mean", True, "acceleration")),
    (odd_policy, (TYPED, "mlp", "mean", False, "ctbr")),
    (odd_policy, (GOAL, "mlp", "mean", False, "rotors")),
    (odd_policy, (FULL, "deep-set", "max-sum", False)),
    (odd_policy, (FULL, "attention", "mean", True), {"observe_load": True}),
    (odd_policy, (FULL, "mlp", "mean", False), {"observe_force": True, "num_obstacles": 2}),
]


@needs_compiler
@pytest.mark.parametrize("made", POLICIES)
def test_policies_in_c(made: tuple[Any, ...], tmp_path: Path) -> None:
    (make_policy, given, senses), rng = (*made, {})[:3], np.random.default_rng(0)
    policy = make_policy(*given, **senses)
    policy = policy.policy if make_policy is shipped else policy
    found = [draw_state(policy, int(rng.integers(0, MOST)), rng) for _ in range(2000)]
    found += edge_states(policy, rng)
    force = policy.note.observe_force
    out = in_c(policy, tmp_path, np.stack([as_row(state, force) for state in found]))
    expected = decide(policy, found)
    assert out[:, 0].all()
    assert np.ptp(expected, axis=0).min() > 0.5 or make_policy is not shipped
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
        for i in range(len(tokens)):
            order = [i, *(j for j in range(len(tokens)) if j != i)]
            x, y, z, w = state.quaternion[i]
            up = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
            wanted: Any = [1.0 - view.time / view.horizon_s]
            if agent.policy.note.features == REFERENCE:
                wanted = np.concatenate([part[i] for part in reference[:3]])
            thrust = state.rotor_thrust[i].sum() / view.team[i].max_thrust
            moving = [array[order] for array in (state.position, state.velocity, view.goals)]
            own = [np.take(tokens, order), up, thrust, setpoint.position[i], wanted]
            unseen = np.zeros((len(tokens), 0), np.float32), np.zeros(0, np.float32)
            row = as_row(KnownState._make([*moving, *own, *unseen]))
            row["steered"] = np.concatenate([part[i] for part in setpoint[:4]])
            row["dt"] = 1.0 / agent.policy.note.decision_rate
            rows.append(row)
        actions += list(decided.values())
        seen = env.step(decided)[0]
        after += list(np.concatenate(view.setpoint[:4], axis=1))
    env.close()
    return np.stack(rows), np.array(actions), np.array(after)


def equally_near(row: np.ndarray) -> bool:
    """Whether rounding to single precision decides which of two others is nearer."""
    place = row["drones"]["position"][: 1 + row["others"]].astype(np.float64)
    gaps = np.diff(np.sort(np.linalg.norm(place[1:] - place[0], axis=1)))
    return bool((gaps < 1e-6).any())


@needs_compiler
@pytest.mark.parametrize(
    ("name", "task", "options"),
    [("swap-ppo", "swap_v0", {"num_drones": 4}), ("ring-ppo", "ring_v0", {"horizon_s": 3.0})],
)
def test_it_decides_and_steers_as_in_flight(name, task, options, tmp_path):
    """Against the environment itself: its observations, its set-points."""
    agent = shipped(name)
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
    broken: list[tuple[str, Any, float]] = [("up", 1, np.nan), ("task", ..., np.nan)]
    broken += [("position", (0, 1), np.nan), ("velocity", (2, 1), np.nan), ("goal", (4, 2), np.nan)]
    broken += [("thrust", (), np.nan), ("thrust", (), np.inf)]
    large = list(VEHICLES).index("L")  # it was trained with S and S*
    broken += [("type", 0, large), ("type", 3, large)]
    rows = []
    for name, at, value in broken:
        rows.append(good.copy())
        part = rows[-1]["drones"] if name in (DRONE.names or ()) else rows[-1]
        part[name][at] = value
    out = in_c(policy, tmp_path, np.stack([*rows, good]))
    assert not out[:-1, :4].any()
    assert out[-1, 0] == 1.0
    assert out[-1, 1:4].any()


@needs_compiler
@pytest.mark.parametrize("names", [("policy", "learned"), ("a", "b")])
def test_both_headers_go_into_one_program(names: tuple[str, str], tmp_path: Path) -> None:
    """In either order, and in two files of one program."""
    agent = shipped("swap-ppo")
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


@pytest.mark.parametrize(
    ("header", "absent"),
    [
        (lambda *given: policy_header(shipped("swap-ppo").policy, *given), "policy_(?!for )"),
        (lambda *given: c_header(load_model("learned"), *given), "learned_|#include (?!<math.h>)"),
    ],
    ids=["policy", "force"],
)
def test_headers_need_no_heap_and_name_everything_alike(header: Any, absent: str) -> None:
    text = header("pilot")
    assert not re.search(f"double|malloc|{absent}", text)
    assert text != header("pilot", 1)  # another self-test
    for name in ("2fast", "a b"):
        with pytest.raises(ValueError, match=f"name is '{name}', but must be a letter"):
            header(name)


def test_costs_are_counted() -> None:
    """69 features, two hidden layers of 64, three actions; five functions a neighbour."""
    agent = shipped("swap-ppo")
    found = costs(agent.policy)
    assert found.products == 69 * 64 + 64 * 64 + 64 * 3
    assert found.flash_bytes == 4 * (found.products + 64 + 64 + 3)
    assert found.functions == 128 + 1 + 3 * 5
    set_of = costs(odd_policy(TYPED, "deep-set", "mean", False))
    assert set_of.products == 3 * (41 * 9 + 9 * 5) + (21 + 5) * 11 + 11 * 7 + 7 * 3
    assert set_of.functions == 3 * (9 + 5) + 11 + 7 + 1 + 3 * 5


def test_the_command_for_policies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, facts = tmp_path / "pilot.h", tmp_path / "facts.json"
    call = ["export", "policy", "--out", str(out)]
    assert main([*call, "--agent", "swap-ppo", "--json", str(facts)]) == 0
    agent = shipped("swap-ppo")
    assert out.read_text() == policy_header(agent.policy, "pilot")
    report = json.loads(facts.read_text())
    assert report["weights_sha256"] == agent.policy.digest
    assert report["flash_bytes"] == costs(agent.policy).flash_bytes
    assert "pilot_act" in capsys.readouterr().out
    assert main([*call, "--agent", "hover"]) == 2
    assert "'hover' is no trained policy" in capsys.readouterr().err


NEIGHBOURS = 6
BELIEFS = Path(str(resources.files("swarm_envs.baselines.neural_swarm").joinpath("weights")))
SHIPPED_FORCES = ("learned", "learned-v0", *sorted(BELIEFS.glob("*.safetensors")))


# Reads states of six neighbours, of which the first `count` are there, and writes three forces.
FORCE_PROGRAM = """
#define LEARNED_SELF_TEST
#include "learned.h"
#include <stdio.h>
struct row { int count, own, types[6]; float position[3], velocity[3], relative[36]; };
int main(void)
{
    struct row r;
    float force[3];
    while (fread(&r, sizeof r, 1, stdin) == 1) {
        learned_force(r.own, r.position, r.velocity, r.count, r.types, r.relative, force);
        if (fwrite(force, sizeof force, 1, stdout) != 1) return 2;
    }
    return learned_self_test() < 1e-3f ? 0 : 1;
}
"""
FORCE_ROW = np.dtype(
    [
        ("count", np.int32),
        ("own", np.int32),
        ("types", np.int32, NEIGHBOURS),
        ("position", np.float32, 3),
        ("velocity", np.float32, 3),
        ("relative", np.float32, (NEIGHBOURS, 6)),
    ]
)


def check_force(model: InteractionModel, folder: Path, rows: np.ndarray) -> None:
    """Compare the header of a model, compiled, with the float64 model."""
    (folder / "learned.h").write_text(c_header(model))
    force = run_program(folder, FORCE_PROGRAM, rows).reshape(-1, 3)
    expected = np.array([force_in_python(model, row) for row in rows])
    assert np.abs(expected).max() > 5.0 * GRAM_FORCE
    np.testing.assert_allclose(force, expected, rtol=0.0, atol=1e-3 * GRAM_FORCE)


def force_in_python(model: InteractionModel, row: np.ndarray) -> np.ndarray:
    """The float64 model's force (3,) on the drone of one row, N."""
    others = row["relative"][: row["count"]].astype(np.float64)
    position, velocity = (row[key].astype(np.float64) for key in ("position", "velocity"))
    p = np.concatenate([position[None], position + others[:, :3]])[None]
    v = np.concatenate([velocity[None], velocity + others[:, 3:]])[None]
    types = np.concatenate([[row["own"]], row["types"][: row["count"]]])[None].astype(np.int64)
    out = np.empty_like(p)
    all_forces(model.packed, types, p, v, out)
    return out[0, 0]


def random_rows(rng: np.random.Generator, count: int, kinds: int) -> np.ndarray:
    """States of every kind: low and aloft, none to six neighbours, beyond clamps and volume."""
    rows = np.zeros(count, FORCE_ROW)
    rows["count"] = rng.integers(0, NEIGHBOURS + 1, count)
    rows["own"] = rng.integers(0, kinds, count)
    rows["types"] = rng.integers(0, kinds, (count, NEIGHBOURS))
    rows["position"] = rng.uniform([-2.0, -2.0, 0.02], [2.0, 2.0, 1.5], (count, 3))
    rows["velocity"] = rng.normal(0.0, 0.6, (count, 3))
    reach = [0.36, 0.36, 1.15]
    rows["relative"][..., :3] = rng.uniform(np.negative(reach), reach, (count, NEIGHBOURS, 3))
    rows["relative"][..., 3:] = rng.normal(0.0, 0.8, (count, NEIGHBOURS, 3))
    return rows


def edge_rows() -> np.ndarray:
    """Neighbours just inside and outside of every face of the volume, drones about the anchor."""
    edges = [(0.35, 0.0, 0.1), (0.0, -0.35, 0.1), (0.0, 0.0, 1.1), (0.25, 0.0, 0.1), (0, 0, -0.8)]
    cases = list(itertools.product(edges, (1 - 1e-5, 1 + 1e-5), (0.6 - 1e-4, 0.6, 0.6 + 1e-4)))
    rows = np.zeros(len(cases), FORCE_ROW)
    for row, (edge, factor, height) in zip(rows, cases, strict=True):
        row["count"], row["position"][2] = 1, height
        row["relative"][0, :3] = np.multiply(edge, factor)
        row["velocity"] = row["relative"][0, 3:] = 0.3, -0.2, 0.1
    return rows


@needs_compiler
@pytest.mark.parametrize("name", SHIPPED_FORCES)
def test_shipped_models_in_c(name: str | Path, tmp_path: Path) -> None:
    model = load_model(name)
    rows = np.concatenate([random_rows(np.random.default_rng(0), 4000, 2), edge_rows()])
    check_force(model, tmp_path, rows)


@needs_compiler
@pytest.mark.parametrize("anchor", [None, 0.5])
def test_any_model_in_c(tmp_path: Path, anchor: float | None) -> None:
    """Odd widths and names of types, no window, no ranges, with and without anchor."""
    rng = np.random.default_rng(1)
    kinds = ("big one", "a+b", "SELF_TEST")
    widths = {f"phi.{t}": (6, 9, 7, 5) for t in kinds} | {"phi.environment": (4, 3, 5)}
    widths |= {f"rho.{t}": (5, 12, 1) for t in kinds}
    tensors = {f"drag.{t}": rng.uniform(0.0, 0.1, 3) for t in kinds}
    for network, sizes in widths.items():
        for k, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
            tensors[f"{network}.{k}.weight"] = rng.normal(size=(outputs, inputs)) / inputs**0.5
            tensors[f"{network}.{k}.bias"] = rng.normal(size=outputs)
    note = {"format": "deep-set-1", "types": kinds, "anchor_height_m": anchor, "window": None}
    note["command"] = "closes /* the */ comment"
    save_file(tensors, tmp_path / "odd.safetensors", metadata={"swarm_envs": json.dumps(note)})
    model = load_model(tmp_path / "odd.safetensors")
    check_force(model, tmp_path, random_rows(rng, 500, 3))


def test_the_command_for_forces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, facts = tmp_path / "wash.h", tmp_path / "facts.json"
    assert main(["export", "force", "--out", str(out), "--json", str(facts)]) == 0
    assert out.read_text() == c_header(load_model("learned"), "wash")
    assert json.loads(facts.read_text())["weights"] == load_model("learned").field.weights.size
    assert "wash_force_z" in capsys.readouterr().out


def test_only_deep_sets_are_exported() -> None:
    with pytest.raises(ValueError, match="'wake' is neither composed nor a deep set"):
        c_header(load_model("wake"), "wake")


PAGE = (Path(__file__).parents[2] / "docs" / "deploy.md").read_text(encoding="utf-8")


def blocks(kind: str) -> list[str]:
    """The page's blocks of code of a kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_commands_run_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    ours = [shlex.split(line)[1:] for line in lines if line.startswith("swarm-envs ")]
    assert len(ours) == 3
    for call in ours:
        assert main(call) == 0, call
    assert len(list(Path("real").glob("drone_?.csv"))) == 4
    assert Path("policy.h").is_file()


@needs_compiler
def test_its_c_compiles(tmp_path: Path) -> None:
    (block,) = blocks("c")
    for kind, file in (("force", "learned.h"), ("policy", "policy.h")):
        name = ["--agent", "swap-ppo"] if kind == "policy" else []
        assert main(["export", kind, *name, "--out", str(tmp_path / file)]) == 0
    (tmp_path / "app.c").write_text(block)
    subprocess.run([str(COMPILER), *STRICT, "-c", "app.c"], cwd=tmp_path, check=True)
