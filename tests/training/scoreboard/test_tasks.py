"""The tables of tasks and agents."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from swarm_envs.agents import load
from swarm_envs.agents.evaluation import evaluate_agent, frozen_seeds
from swarm_envs.agents.registry import FILTER, SHIPPED
from swarm_envs.physics import bullet_available
from swarm_envs.training.scoreboard import tasks
from swarm_envs.training.scoreboard.agents import AGENTS, LEAST, choose_agents, episodes_of
from swarm_envs.training.scoreboard.metrics import METRICS
from swarm_envs.training.scoreboard.tasks import SEED, TASKS, choose_tasks, digest, make_scored
from tests.helpers.pages import DOCS

DIGESTS = {
    "swap-random-2-v2": "3fafa2d1edc3a7bf",
    "swap-random-4-v2": "e5c18ebf83392ddb",
    "swap-random-SSLL-v2": "1eda464943fa208c",
    "swap-random-8-v2": "a3a10fc25bb085f1",
    "swap-random-16-v2": "03e590b4f7d44c2b",
    "swap-circle-2-v2": "5e969300754f99f7",
    "swap-circle-4-v2": "3078ec7f005d7425",
    "swap-circle-8-v2": "c070564c009d80fc",
    "swap-circle-16-v2": "65a4dbf5a41afa3a",
    "swap-stacked-L2S-v2": "17d4e7a21f992f9d",
    "swap-stacked-4-v2": "b84508eb4ceac6e0",
    "ring-4-v2": "53305b44f6277c35",
    "ring-5-v2": "3b8751b5c68275ec",
    "ring-8-v2": "dc6597b6309b6c81",
    "ring-16-v2": "5692b8740fed2369",
    "formation-tour-8-v2": "07fb59f87102702f",
    "formation-tour-16-v2": "f00d07d6d565ebf8",
    "formation-shuffle-8-v2": "019fb262b9f343cc",
    "formation-shuffle-16-v2": "9cb8f0157d01c41a",
    "air-stack-8-v3": "ca5c1b3a8be90eb3",
    "air-sprint-8-v3": "4ed68b21d7221661",
    "air-delivery-7-v2": "4944700c54317696",
    "air-gates-4-v2": "ea193493af787a38",
    "crowd-open-64-v2": "a86fe3758dc090a5",
    "crowd-forest-16-v2": "ee1bb27bb238a852",
    "crowd-forest-64-v2": "0e1bde184ff25b7d",
    "crowd-buildings-32-v2": "087b5882277b5521",
    "crowd-moving-8-v2": "bb314ece79982697",
    "crowd-swaps-8-v2": "c6aa71ad2df95b0a",
    "crowd-chase-8-v2": "8d6bc505d4c040c2",
    "crowd-random-32-v2": "d6e003aaea740e9c",
    "crowd-random-64-v2": "bcd7a113dfb7b872",
    "crowd-circle-32-v2": "2d8e3002ec28c289",
    "robust-random-8-hall-v2": "13b19e5a9a684fae",
    "robust-ring-5-hall-v2": "0325196ded80d578",
    "robust-ring-16-hall-v2": "3fd43760ae523fe3",
    "robust-shuffle-8-hall-v2": "19d863558878c78b",
    "robust-random-8-noise-v2": "ec78160219feb158",
    "robust-circle-8-noise-v2": "48bade76fd308fbe",
    "robust-random-LLLLSSSS-v2": "1fbd43cb8c9876ed",
    "robust-random-4-bullet-v2": "4bd3bec5ba680b39",
    "transfer-random-8-none-v2": "3fa12f8e6b8a2177",
    "transfer-random-8-wake-v2": "d3a87a043a42f559",
    "transfer-stacked-L2S-wake-v2": "de6ace113bc1ddf3",
    "transfer-ring-5-wake-v2": "14db2a7c487bfd88",
    "air-mixed-6-v3": "1512d8e965de3b3e",
}
"""The definition of each id since it was first used. A line here is never changed: what is flown
otherwise gets a row with the next version in place of the old one."""
NEVER_AGAIN = {"robust-circle-8-hall-v2", "air-stack-8-v2", "air-sprint-6-v2"}
"""Ids that stood for something once, and must not stand for anything else."""
SEEDS = [2727543821, 2207150826, 508070823]


def test_no_id_stands_for_anything_else_than_before():
    assert {name: digest(task) for name, task in TASKS.items()} == DIGESTS
    assert not NEVER_AGAIN & set(TASKS)


def test_a_digest_sees_what_was_changed(monkeypatch):
    task = TASKS["swap-circle-4-v2"]
    others = [
        replace(task, options={"layout": "circle", "num_drones": 5}),
        replace(task, environment="formation_v1"),
        replace(task, score="shapes"),
    ]
    assert digest(replace(task, episodes=1)) == DIGESTS[task.id]
    seen = [DIGESTS[task.id], *map(digest, others)]
    for name, value in (("SEED", SEED + 1), ("_force_model", lambda name: "0" * 64)):
        with monkeypatch.context() as patch:
            patch.setattr(tasks, name, value)
            seen.append(digest(task))
    assert len(set(seen)) == 6


def test_the_frozen_seeds_are_the_same_everywhere():
    assert frozen_seeds(SEED, 256)[:3] == frozen_seeds(SEED, 3) == SEEDS


@pytest.mark.parametrize("task", TASKS.values(), ids=list(TASKS))
def test_every_row_says_what_flies(task):
    classic = r"(swap|ring|formation)-([a-z]+-)?[0-9LS]+-v2"
    new = rf"{task.family}-[a-z]+-[0-9LS]+(-[a-z]+)?-v[23]"
    assert re.fullmatch(classic if task.family == "classic" else new, task.id)
    if task.setting["physics"] == "bullet" and not bullet_available():
        pytest.skip("no pybullet")
    env = make_scored(task.environment, json.loads(json.dumps(task.setting)))
    env.reset(seed=0)
    assert len(env.agents) == task.drones <= 64
    assert env.physics_name == task.setting["physics"]
    assert env.core.config.force_rate == 240
    env.close()


def test_every_task_has_a_certificate():
    for task in TASKS.values():
        name, _, clock_s = task.certificate.partition("@")
        assert name in SHIPPED
        assert not clock_s or float(clock_s) > task.options["horizon_s"]


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_the_certificate_solves_its_task(name):
    task = TASKS[name]
    agent_name, _, clock_s = task.certificate.partition("@")
    agent, longer = load(agent_name), {"horizon_s": float(clock_s)} if clock_s else {}
    env = make_scored(task.environment, {**task.setting, **longer, **agent.requires})
    flown = [*evaluate_agent(env, agent, frozen_seeds(SEED, 20), timed=1)]
    env.close()
    assert sum(each["metrics"]["success"] for each in flown) >= 0.95 * len(flown)


def test_every_agent_that_ships_is_in_the_table():
    assert set(SHIPPED) <= set(AGENTS)
    assert {name.removesuffix(FILTER) for name in AGENTS} == set(SHIPPED)


def test_slow_agents_fly_the_first_of_the_episodes_of_fast_ones():
    swap, tour = TASKS["swap-circle-4-v2"], TASKS["formation-tour-8-v2"]
    for name, episodes in (("swap-dagger", 256), ("detour", 64), ("neural-swarm-planner", 32)):
        assert episodes_of(name, swap) == episodes
    assert episodes_of("neural-swarm-planner", tour) == LEAST
    assert episodes_of("some/file.py:Mine", swap) == 64


def test_patterns_choose_in_the_table_s_order():
    chosen = choose_tasks(["ring-*-v2", "swap-circle-4-v2"])
    assert [task.id for task in chosen] == [
        "swap-circle-4-v2",
        *(name for name in TASKS if re.match("ring-.*-v2", name)),
    ]
    assert choose_tasks(["*"]) == list(TASKS.values())
    names = choose_agents(["a/b.py:Mine", "crowd-dagger*", "hover", "a/b.py:Mine", "detour+filter"])
    wanted = ["hover", "crowd-dagger", "crowd-dagger+filter"]
    assert names == [*wanted, "a/b.py:Mine", "detour+filter"]


WRONG = [(choose_tasks, "circle-4", "circle-4-v2"), (choose_agents, "daggr", "dagger")]


@pytest.mark.parametrize(("choose", "wrong", "right"), WRONG)
def test_what_is_no_name_is_refused_with_the_nearest(choose, wrong, right):
    with pytest.raises(ValueError, match=f"did you mean 'swap-{right}'"):
        choose(["*", f"swap-{wrong}"])
    with pytest.raises(ValueError, match="is empty"):
        choose([])


def test_the_page_explains_every_column_and_names_every_task():
    page = (DOCS / "benchmark.md").read_text(encoding="utf-8")
    measured = page.partition("## Metrics")[2]
    assert all(f"`{metric.name}`" in measured for metric in METRICS)
    shown = page.partition("## Tasks")[2].partition("## Metrics")[0]
    for name in TASKS:
        first, size, version = name.rsplit("-", 2)
        assert f"`{name}`" in shown or (f"`{first}-" in shown and f"`-{size}`" in shown), name
        assert version in shown
