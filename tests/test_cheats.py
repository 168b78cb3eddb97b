"""Works that cheat: none gets points, nothing outlives it, and the next work is graded."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
import struct
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import swarm_envs
from swarm_envs.agents import load
from swarm_envs.assignments import ASSIGNMENTS
from swarm_envs.cli import main
from swarm_envs.commands import grade
from swarm_envs.training.interaction_rows import save_rows
from tests.helpers.wake_rows import wake_rows

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="confinement is Linux's")
if sys.platform == "linux":
    from swarm_envs.commands.grade_force import grade_model
    from swarm_envs.commands.grading import confinement, remote
    from swarm_envs.commands.grading.confinement import Protections
    from swarm_envs.commands.grading.copies import copied_acts
    from swarm_envs.commands.grading.messages import BadMessage, Channel
    from swarm_envs.commands.grading.remote import opened
    from swarm_envs.commands.grading.text import cell, printable

PACKAGE = Path(swarm_envs.__file__).parent
STARTERS = PACKAGE / "assignments"
SHORT_S = 10.0
ALONE = ("own processes", "files hidden")  # what only a confined work cannot do

WORK = """
import atexit, ctypes, gc, json, multiprocessing, os, pathlib, resource, signal, socket
import struct, subprocess, sys, threading, time
import numpy as np
TABLE, RESULT = {table!r}, {result!r}
class Agent:
    requires, privileged = {{'action': 'acceleration', 'decision_rate': 10}}, False
    def reset(self, env, seed): pass
    def act(self, observations, view):
        return {{name: np.zeros(3, np.float32) for name in observations}}
{cheat}
"""

# What a cheat does, and what the table says of it: nothing if it flies on and gets nothing.
CHEATS = {
    "writes a report and ends": (
        """
        class Agent(Agent):
            def act(self, observations, view):
                json.dump({'agents': [{'success_rate': 1.0}]}, open('report.json', 'w'))
                os._exit(0)
        """,
        "exit code 0",
    ),
    "writes a report at its exit": (
        """
        atexit.register(lambda: print(json.dumps({'success_rate': 1.0})))
        class Agent(Agent):
            def act(self, observations, view): sys.exit(0)
        """,
        "SystemExit",
    ),
    "looks for the judge's memory": (
        """
        for thing in gc.get_objects():
            if type(thing).__name__ in ('SwarmCore', 'World', 'SwarmParallelEnv'):
                raise RuntimeError('found it')
        """,
        "",
    ),
    "looks for env in the frames of its callers": (
        """
        class Agent(Agent):
            def reset(self, env, seed):
                frame = sys._getframe()
                while frame is not None:
                    for thing in list(frame.f_locals.values()):
                        thing = getattr(thing, 'env', thing)
                        core = getattr(thing, 'core', None)
                        if hasattr(core, 'world') or hasattr(core, 'reset'):
                            raise RuntimeError('found it')
                    frame = frame.f_back
        """,
        "",
    ),
    "replaces the code that scores": (
        """
        from swarm_envs.agents import evaluation
        def perfect(episodes): return {'success_rate': 1.0, 'collision_rate': 0.0}
        evaluation.score_episodes.__code__ = perfect.__code__
        evaluation.evaluate_agent.__code__ = perfect.__code__
        """,
        "",
    ),
    "says that all episodes were flown before": (
        """
        for folder in (pathlib.Path(TABLE).parent, pathlib.Path('.')):
            try:
                (folder / 'report.episodes').mkdir()
                (folder / 'report.episodes' / 'x.jsonl').write_text('{"seed": 0}')
            except OSError: pass
        """,
        "",
    ),
    "leaves a session that rewrites the table": (
        """
        SCRIPT = f"while :; do echo work,points > {TABLE}; echo eve,100 >> {TABLE}; sleep 0.1; done"
        subprocess.Popen(['setsid', 'sh', '-c', SCRIPT])
        """,
        "",
    ),
    "lies once of what it sees": (
        """
        class Agent(Agent):
            asked = 0
            @property
            def privileged(self):
                Agent.asked += 1
                return Agent.asked == 1
            def act(self, observations, view):
                assert view is None, 'it sees'
                return super().act(observations, view)
        """,
        "",
    ),
    "leaves sixty-six sleepers": (
        "for _ in range(66): subprocess.Popen(['setsid', 'sleep', '1000'])",
        "",
    ),
    "leaves a daemon that forked twice": (
        """
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                time.sleep(1000)
            os._exit(0)
        """,
        "",
    ),
    "leaves threads running": (
        """
        def spin():
            while True: time.sleep(0.01)
        for _ in range(8): threading.Thread(target=spin).start()
        """,
        "",
    ),
    "forks until it may not": (
        """
        try:
            for _ in range(400):
                if os.fork() == 0: time.sleep(1000)
        except OSError: pass
        """,
        "",
    ),
    "ends its parent": (
        """
        for code in (signal.SIGINT, signal.SIGTERM):
            if os.getppid() > 1: os.kill(os.getppid(), code)
        """,
        "own processes",
    ),
    "writes into the package": (
        f"""
        try:
            open({str(PACKAGE / "errors.py")!r}, 'a').write('#')
        except OSError: pass
        """,
        "",
    ),
    "reads the grader's memory": (
        """
        for entry in os.listdir('/proc'):
            if entry.isdigit() and int(entry) != os.getpid():
                try: open(f'/proc/{entry}/mem', 'rb').read(0)
                except OSError: continue
                if entry == str(os.getppid()): raise RuntimeError('found it')
        """,
        "own processes",
    ),
    "writes through ctypes": (
        """
        libc = ctypes.CDLL(None)
        libc.ptrace(16, os.getppid(), 0, 0)
        libc.prctl(4, 1, 0, 0, 0)
        descriptor = libc.open(RESULT.encode(), 577, 0o644)
        libc.write(descriptor, b'100', 3)
        """,
        "",
    ),
    "answers in place of the process": (
        """
        for descriptor in range(3, 64):
            try: os.write(descriptor, b'{"kind": "done", "success_rate": 1.0}')
            except OSError: pass
        """,
        "nonsense",
    ),
    "answers with absurd lengths": (
        """
        for descriptor in range(3, 64):
            try: os.write(descriptor, struct.pack('<4sII', b'SWRM', 2**32 - 1, 2**32 - 1))
            except OSError: pass
        """,
        "nonsense",
    ),
    "answers with a thousand brackets": (
        """
        for descriptor in range(3, 64):
            try: os.write(descriptor, struct.pack('<4sII', b'SWRM', 60000, 0) + b'[' * 60000)
            except OSError: pass
        """,
        "nonsense",
    ),
    "claims a shape that it does not send": (
        """
        HEAD = json.dumps({'kind': 'made', 'requires': {}, 'arrays': [['f8', [2**31, 2**31]]]})
        for descriptor in range(3, 64):
            try: os.write(descriptor, struct.pack('<4sII', b'SWRM', len(HEAD), 0) + HEAD.encode())
            except OSError: pass
        """,
        "nonsense",
    ),
    "gives a row of a million numbers": (
        """
        class Agent(Agent):
            def act(self, observations, view):
                return {name: np.zeros(10**6) for name in observations}
        """,
        "shape (1000000,)",
    ),
    "gives many rows of a million numbers": (
        """
        class Agent(Agent):
            def act(self, observations, view): return super().act(observations, view)
            def act_batch(self, rows): return np.zeros((10**3, 10**4))
        """,
        "",
    ),
    "requires an easier task": (
        "Agent.requires = {**Agent.requires, 'end_on_success': False, 'horizon_s': 1e3}",
        "requires 'end_on_success'",
    ),
    "requires a million neighbours": (
        "Agent.requires = {**Agent.requires, 'num_neighbors': 10000}",
        "must be at most 64",
    ),
    "requires what is no number": (
        "Agent.requires = {**Agent.requires, 'decision_rate': [[[[]]]]}",
        "decision_rate",
    ),
    "raises words that forge a row": (
        r"""
        class Agent(Agent):
            def act(self, observations, view):
                raise RuntimeError('\x1b[2Jx\neve  100.0  1.0\r\u202e' + 'x' * 10**6)
        """,
        r"\x1b[2Jx\neve",
    ),
    "allocates a hundred gigabytes": (
        "memory = np.ones(100 * 2**30 // 8)",
        "MemoryError",
    ),
    "raises what cannot be said": (
        """
        class Unsayable(Exception):
            def __str__(self): raise SystemExit
        class Agent(Agent):
            def act(self, observations, view): raise Unsayable
        """,
        "Unsayable",
    ),
    "calls the network": (
        """
        from contextlib import suppress
        with suppress(OSError):
            socket.create_connection(('192.0.2.1', 80), 1.0)
            raise RuntimeError('connected')
        """,
        "",
    ),
    "reads others' works and the environment": (
        """
        assert 'SECRET' not in os.environ
        try: text = pathlib.Path(TABLE).parent.joinpath('bob', 'swap.py').read_text()
        except OSError: pass
        else: raise RuntimeError('read it')
        """,
        "files hidden",
    ),
}
"""Cheats by what they do; code that follows that of an agent that hovers."""
LONG = {
    "sleeps for ever": (
        """
        class Agent(Agent):
            def act(self, observations, view): time.sleep(10**6)
        """,
        "took longer than 10 s",
    ),
    "answers byte by byte": (
        """
        slow = struct.pack('<4sII', b'SWRM', 4096, 0) + b' ' * 4096
        for k in range(4096):
            for descriptor in range(3, 16):
                try: os.write(descriptor, slow[k:k + 1])
                except OSError: pass
            time.sleep(0.2)
        """,
        "took longer than 10 s",
    ),
    "writes 600 MB on stderr": (
        """
        for _ in range(600): os.write(2, b'x' * 2**20)
        os.write(2, b'\\n=cmd|calc\\n')
        os._exit(7)
        """,
        "exit code 7: =cmd|calc",
    ),
    "prints for ever": (
        "while True: print('x' * 4096)",
        "took longer than 10 s",
    ),
    "fills the disk": (
        """
        with open('big', 'wb') as file:
            while True: file.write(b'x' * 2**20)
        """,
        "OSError",
    ),
    "forks for ever": (
        """
        while True:
            try: os.fork()
            except OSError: time.sleep(0.01)
        """,
        "took longer than 10 s",
    ),
    "stops itself": ("os.kill(os.getpid(), signal.SIGSTOP); time.sleep(100)", "took longer"),
    "waits for a second decision": (
        """
        class Agent(Agent):
            count = 0
            def act(self, observations, view):
                Agent.count += 1
                if Agent.count > 1: time.sleep(10**6)
                return super().act(observations, view)
        """,
        "longer than",
    ),
}
"""Cheats that last."""


def written(folder: Path, cheat: str) -> tuple[list[str], Path]:
    """The works of a class in which Eve cheats, and the path of their table."""
    table, result = folder / "grades.csv", folder / "result.txt"
    for name, code in (("eve", cheat), ("bob", "")):
        (folder / name).mkdir()
        code = textwrap.dedent(code)
        text = WORK.format(table=str(table), result=str(result), cheat=code)
        (folder / name / "swap.py").write_text(text, encoding="utf-8")
    return [f"{folder / name / 'swap.py'}:Agent" for name in ("eve", "bob")], table


def graded(folder: Path, cheat: str, limit_s: float) -> dict[str, dict[str, str]]:
    """The table of a class in which Eve cheats, by name."""
    works, table = written(folder, cheat)
    before, state = confinement.descendants(), remote.package_state()
    words = ["--episodes", "1", "--limit-s", str(limit_s), "--out", str(table)]
    code = main(["grade", "--assignment", "swap", *words, "--agent", *works])
    assert confinement.descendants() - before == set()
    assert remote.package_state() == state
    result = folder / "result.txt"
    assert not result.exists() or not result.stat().st_size
    time.sleep(0.3)  # whatever were left would write now
    with table.open(newline="", encoding="utf-8") as file:
        eve, bob = csv.DictReader(file)
    assert (bob["points"], bob["success_rate"], bob["error"]) == ("0.0", "0.0", "")
    assert eve["points"] == "0.0" and code == bool(eve["error"])
    assert len(eve["error"]) <= 500
    assert "found it" not in eve["error"]
    return {"eve": eve, "bob": bob}


@pytest.fixture(autouse=True)
def quick(monkeypatch) -> Iterator[None]:
    monkeypatch.setenv("SECRET", "42")
    yield


def checked(folder: Path, cheat: str, says: str, limit_s: float = 60.0) -> None:
    says = "" if says in ALONE else says
    error = graded(folder, cheat, limit_s)["eve"]["error"]
    assert says in error if says else not error


@pytest.mark.slow
@pytest.mark.parametrize("name", CHEATS)
def test_a_cheat_gets_nothing_and_leaves_nothing(tmp_path, name):
    checked(tmp_path, *CHEATS[name])


@pytest.mark.parametrize(
    "name",
    [
        "leaves a session that rewrites the table",
        "answers in place of the process",
        "raises words that forge a row",
    ],
)
def test_some_cheats_get_nothing(tmp_path, name):
    checked(tmp_path, *CHEATS[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_what_lasts_is_ended(tmp_path, name):
    checked(tmp_path, *LONG[name], SHORT_S)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CHEATS if CHEATS[name][1] not in ALONE])
def test_a_cheat_gets_nothing_where_the_system_helps_nobody(tmp_path, monkeypatch, name):
    monkeypatch.setattr(remote, "probe", lambda: Protections((), 0))
    checked(tmp_path, *CHEATS[name])


PEEKS = """
import gc, sys
import numpy as np
class Peeks:
    def fit(self, rows): self.mean = rows.force_g[:, 2].mean()
    def predict(self, rows):
        found, frame = rows.force_g[:, 2], sys._getframe()
        while frame is not None:
            for thing in [*frame.f_locals.values(), *gc.get_objects()]:
                force = vars(thing).get('force_g') if type(thing) is type(rows) else None
                if force is not None and len(force) == len(found) and force.any():
                    found = force[:, 2]
            frame = frame.f_back
        return found
class Mean(Peeks):
    def predict(self, rows): return np.zeros(len(rows.force_g))
class Bare:
    def fit(self, rows): assert rows.force_g.any()
    def predict(self, rows): return np.full(len(rows.force_g) + 1, 0.0)
"""


def test_held_out_labels_are_nowhere_in_the_process_of_a_model(tmp_path):
    data, work = tmp_path / "rows.npz", tmp_path / "work.py"
    save_rows(data, wake_rows(400))
    work.write_text(PEEKS, encoding="utf-8")
    scores = {}
    for name in ("Peeks", "Mean"):
        with opened(f"{work}:{name}", "fit") as (process, _):
            scores[name] = grade_model(process, data)
    assert scores["Peeks"] == scores["Mean"]
    with (
        opened(f"{work}:Bare", "fit") as (process, _),
        pytest.raises(ValueError, match="must give 100 finite numbers"),
    ):
        grade_model(process, data)


STOLEN = """
import numpy as np
from swarm_envs.agents import load
class Agent:
    def __init__(self):
        self.own = load('swap-ppo')
        self.requires, self.privileged = dict(self.own.requires), False
    def reset(self, env, seed): self.own.reset(env, seed)
    def act(self, observations, view):
        return {n: 0.97 * a for n, a in self.own.act(observations, view).items()}
class Peeks(Agent):
    def __init__(self):
        super().__init__()
        self.requires = {'action': 'acceleration', 'decision_rate': 10}
    def reset(self, env, seed): self.env = env
    def act(self, observations, view):
        view = self.env.view
        assert np.allclose(view.reference(view.time).position, view.goals)
        asked = 1.5 * (view.goals - view.state.position) - 1.2 * view.state.velocity
        return dict(zip(observations, np.clip(asked / 5.0, -1.0, 1.0)))
"""


def test_what_ships_and_who_looks_at_the_truth_is_starred(monkeypatch, tmp_path, capsys):
    four = {"task": "swap", "layout": "random", "drones": 4}  # as many as `swap-ppo` flies
    swap = dataclasses.replace(ASSIGNMENTS["swap"], flown=four)
    monkeypatch.setattr(grade, "ASSIGNMENTS", {"swap": swap})
    work, table, stolen = tmp_path / "swap.py", tmp_path / "grades.csv", tmp_path / "weights"
    work.write_text(STOLEN, encoding="utf-8")
    stolen.mkdir()
    shipped = PACKAGE / "agents" / "weights" / "swap-ppo.safetensors"
    (stolen / "policy.safetensors").write_bytes(shipped.read_bytes())
    source = tmp_path / "line" / "swap.py"
    source.parent.mkdir()
    scripted = (PACKAGE / "agents" / "scripted.py").read_text(encoding="utf-8")
    source.write_text(scripted.replace("class StraightLineAgent", "class Mine"), encoding="utf-8")
    starter = tmp_path / "starter" / "swap.py"
    starter.parent.mkdir()
    starter.write_bytes((STARTERS / "swap" / "swap.py").read_bytes())
    works = [f"{work}:Agent", f"{work}:Peeks", str(stolen), f"{source}:Mine", f"{starter}:MyAgent"]
    words = ["--episodes", "2", "--out", str(table), "--agent", *works]
    assert main(["grade", "--assignment", "swap", *words]) == 0
    with table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["copied"] for row in rows] == ["swap-ppo", "", "swap-ppo", "straight-line", ""]
    assert [row["privileged"] for row in rows] == ["False", "True", "False", "False", "False"]
    assert "flies as swap-ppo" in capsys.readouterr().out


def _decisions(law, agent="swap-ppo", seeds=(0, 1)):
    """Rows and actions of flights of four by a law of rows (N, width) and the observed fields."""
    requires = {**load(agent).requires, "physics": "batch"}
    env = swarm_envs.swap_v1.parallel_env(num_drones=4, layout="random", **requires)
    where, kept = {field.name: field.where for field in env.observation_layout}, []
    for seed in seeds:
        observations, _ = env.reset(seed=seed)
        while env.agents:
            rows = np.stack([*observations.values()])
            kept.append((rows, np.clip(law(rows, where), -1.0, 1.0)))
            acts = kept[-1][1].astype(np.float32)
            observations, *_ = env.step(dict(zip(env.agents, acts)))
    return env, kept


@pytest.mark.parametrize("name", ["swap-ppo", "swap-ppo+filter"])
@pytest.mark.parametrize("factor", [1.0, 0.8])
def test_what_ships_is_known_by_its_acts(name, factor):
    agent: Any = load(name)
    agent.reset(swarm_envs.swap_v1.parallel_env(num_drones=4, **agent.requires), 0)
    env, kept = _decisions(lambda rows, _: factor * agent.act_batch(rows[None])[0], name)
    assert copied_acts(env, kept).removesuffix("+filter") == "swap-ppo"


@pytest.mark.parametrize(("stiffness", "damping"), [(2.0, 2.0), (4.0, 3.0), (8.0, 5.0)])
def test_a_law_of_one_s_own_is_nobody_s_copy(stiffness, damping):
    def law(rows, where):
        return (
            stiffness * rows[:, where["self.setpoint_offset"]]
            - damping * rows[:, where["self.velocity"]]
        ) / 5.0

    env, kept = _decisions(law)
    assert copied_acts(env, kept) == ""


@pytest.mark.parametrize(
    ("assignment", "task", "episodes"),
    [
        ("swap", ["--layout", "random", "--team", "SSSSSSSSLLLLLLLL"], "80"),
        ("controller", ["--layout", "stacked", "--drones", "3", "--world", "hall"], "4"),
    ],
)
def test_honest_works_get_the_mark_of_evaluate(tmp_path, assignment, task, episodes):
    table, report = tmp_path / "grades.csv", tmp_path / "report.json"
    work = f"{STARTERS / assignment / ASSIGNMENTS[assignment].work}"
    common = ["--episodes", episodes, "--seed", "7"]
    main(["grade", "--assignment", assignment, *common, "--out", str(table), "--agent", work])
    main(["evaluate", "--task", "swap", *task, *common, "--json", str(report), "--agent", work])
    expected = json.loads(report.read_text(encoding="utf-8"))
    with table.open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    metric = ASSIGNMENTS[assignment].metric
    assert float(row[metric]) == expected[metric]
    assert float(row["points"]) == ASSIGNMENTS[assignment].points(expected)


def test_what_is_missing_is_said(monkeypatch, tmp_path, capsys):
    bare = Protections((), 0)
    monkeypatch.setattr(confinement, "probe", lambda: bare)
    words = ["--assignment", "swap", "--agent", str(tmp_path / "none.py:Agent")]
    assert main(["grade", *words]) == 2  # there is no such file
    said = capsys.readouterr().out
    assert all(missing in said for missing in bare.missing)
    assert said.count("a work is not confined as it should be") == len(bare.missing) >= 4
    whole = Protections(("unshare", "--pid"), 7)
    monkeypatch.setattr(confinement, "_pids_can_be_few", lambda: True)
    assert whole.missing == []


def test_cells_are_no_formulas_and_words_stay_on_their_line():
    assert [cell(words) for words in ("=1", "+1", "-1", "@a", "\ta", "a=1")] == [
        *("'=1", "'+1", "'-1", "'@a", "'\ta", "a=1")
    ]
    assert printable("a\n\x1b\u202e\u2028é") == "a\\n\\x1b\\u202e\\u2028é"
    assert len(printable("x" * 10**6)) == 500


def test_a_message_that_is_not_what_it_says_is_refused():
    source, sink = os.pipe()
    channel = Channel(source, sink)
    numbers = np.arange(6, dtype=np.float32).reshape(2, 3)
    channel.send({"kind": "rows", "x": 1}, [numbers, numbers > 2])
    header, arrays = channel.receive()
    assert header["x"] == 1
    np.testing.assert_array_equal(arrays[0], numbers)
    np.testing.assert_array_equal(arrays[1], numbers > 2)
    wrong: list[Any] = [[["f8", [7]]], [["O", [1]]], [["f4", [-1]]], [["f4", [2.0]]], "f4", [[]]]
    for listed in wrong:
        head = json.dumps({"kind": "rows", "arrays": listed}).encode()
        os.write(sink, struct.pack("<4sII", b"SWRM", len(head), 4) + head + b"1234")
        with pytest.raises(BadMessage):
            channel.receive()
    os.close(source)
    os.close(sink)
