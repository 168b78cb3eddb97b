"""Pages of tasks: `<!-- task: swap_v1 -->` becomes the page of that task, in Gymnasium's order.

Text comes from the docstring of the task's class, numbers from an environment that is made with
the default options. A new task needs a page in `docs/tasks/` with a heading and one such line.
"""

from __future__ import annotations

import dataclasses
import inspect
import re

import swarm_envs
from docs.tables.option_tables import options_table
from swarm_envs import gymnasium_name, swap_v1
from swarm_envs.envs.observation import observation_layout
from swarm_envs.envs.options import TaskOptions, options_type
from swarm_envs.envs.parallel import SwarmParallelEnv
from swarm_envs.tasks.rewards import reward_meanings

_SECTION = re.compile(r"^\*\*([^*\n]+?)\.?\*\*\.? ?", re.MULTILINE)
_ASIDE = re.compile(r"^\([^)]*\):?\s*")
_ACTION = re.compile(r"^\| `(\w+)` \| (.+) \|$", re.MULTILINE)
_KNOWN = ("Start", "Success", "Rewards", "End", "Versions")


def sections(text: str) -> dict[str, str]:
    """The parts of a task's docstring by their titles; what stands before the first is `""`."""
    parts = _SECTION.split(text)
    return {"": parts[0].strip()} | {
        title: body.strip() for title, body in zip(parts[1::2], parts[2::2], strict=True)
    }


def task_page(task: str) -> str:
    """The page of a task such as `swap_v1` in Markdown, with the film of the task's family."""
    options = options_type(task)
    env = swarm_envs.make(task, physics="batch")
    parts = sections(inspect.getdoc(options.task_type) or "")
    head, _, rest = parts[""].partition("\n\n")
    title, _, summary = head.partition(": ")
    family = swarm_envs.task_family(task)
    return "\n\n".join(
        [
            f"![{title.partition(',')[0]}: {summary}](../films/{family}.webp)",
            _facts(task, env),
            f"## Description\n\n{summary[0].upper()}{summary[1:]}",
            _plain(rest),
            *(f"**{name}.** {text}" for name, text in parts.items() if name and name not in _KNOWN),
            f"## Action space\n\n{action_table()}",
            f"## Observation space\n\n{_observations(env)}",
            f"## Rewards\n\n{_rewards(parts['Rewards'], env)}",
            f"## Starting state\n\n{parts['Start']}",
            f"## Episode end\n\n{parts['End']}\n\n**Success.** {parts['Success']}",
            f"## Arguments\n\n{_arguments(options)}",
            f"## Version history\n\n{parts['Versions']}",
        ]
    )


def _plain(text: str) -> str:
    """Text without the docstring's own table, and its code as a block of Python."""
    kept = [line for line in text.splitlines() if not line.startswith("|")]
    code = "\n".join(line[4:] for line in kept if line.startswith("    "))
    code = code.replace("\nenv = ", "\n\nenv = ")  # as a formatter writes it
    said = "\n".join(line for line in kept if not line.startswith("    "))
    return f"```python\n{code}\n```\n\n{said.strip()}"


def _facts(task: str, env: SwarmParallelEnv) -> str:
    first, config = env.possible_agents[0], env.core.config
    rows = {
        "Import": f"`from swarm_envs import {task}`",
        "Gymnasium id": f"`{gymnasium_name(task)}`",
        "Agents": f"{len(env.possible_agents)} by default: `{first}` ...",
        "Action space": f"`{env.action_space(first)}`",
        "Observation space": f"`{env.observation_space(first)}`",
        "Episode length": f"{env.core.task.episode_s:g} s, {config.decision_rate} steps per second",
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {k} | {v} |" for k, v in rows.items())])


def action_table() -> str:
    """The meaning of an action in each mode."""
    rows = _ACTION.findall(inspect.getdoc(swap_v1) or "")
    head = ["| `action=` | each drone's action |", "|---|---|"]
    return "\n".join([*head, *(f"| `{name}` | {meaning} |" for name, meaning in rows)])


def _observations(env: SwarmParallelEnv) -> str:
    rows = [
        f"| {f.where.start}{_until(f.where)} | `{f.name}` | {_unit(f.unit)} | {f.scale:g} |"
        for f in env.observation_layout
    ]
    text = (
        "Each drone observes a row of float32. A quantity is the number in the row times its "
        "scale. The indices are those of the default options: others shift with `num_neighbors` "
        "and with observed obstacles, which come before the fields of the task; "
        "`env.observation_layout` has those of an environment."
    )
    table = ["| index | field | unit | scale |", "|---|---|---|---|", *rows]
    return "\n".join([text, "[Tasks](../tasks.md#observations) explains the fields.", "", *table])


_UNITS = {
    "of maximum": "fraction of maximum",
    "of the weight": "fraction of weight",
    "of a small drone": "mass of a small drone",
    "of full": "fraction of full charge",
    "of the clock": "fraction of time limit",
}
"""Units in full: trained policies depend on the words of the layout itself."""


def _unit(unit: str) -> str:
    return _UNITS.get(unit, unit)


def _until(where: slice) -> str:
    return f"-{where.stop - 1}" if where.stop - where.start > 1 else ""


def observation_table() -> str:
    """The fields of every observation, of one neighbour k and one obstacle k."""
    rows = [
        f"| `{f.name.replace('_0.', '_k.')}` | {f.where.stop - f.where.start} | {_unit(f.unit)} "
        f"| {f.scale:g} |"
        for f in observation_layout(1, 1)
    ]
    return "\n".join(["| field | numbers | unit | scale |", "|---|---|---|---|", *rows])


def _rewards(text: str, env: SwarmParallelEnv) -> str:
    meanings = reward_meanings(env.core.task.write_reward_terms)
    rows = [
        f"| `{name}` | {weight:g} | {meanings.get(name, '')} |"
        for name, weight in env.core.task.reward_weights.items()
    ]
    said = _ASIDE.sub("", text)
    head = [said[:1].upper() + said[1:], "", "| term | weight | value |", "|---|---|---|"]
    return "\n".join([*head, *rows])


def _arguments(options: type[TaskOptions]) -> str:
    shared = {field.name for field in dataclasses.fields(TaskOptions)}
    own = [f.name for f in dataclasses.fields(options) if f.name not in shared]
    said = "`num_drones` and [the options of every task](../tasks.md#options) are accepted too."
    return f"{options_table(options, ['num_drones', *own])}\n\n{said}"
