"""Tables of options: `<!-- commands -->` becomes every command with its options.

Whatever dataclass a command reads is what is written down, so nothing can be forgotten.
`<!-- option table: EnvConfig -->` becomes the options of a class of settings, with their rules, and
`<!-- assignment table -->` the assignments of a course.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from swarm_envs.assignments import ASSIGNMENTS
from swarm_envs.cli import COMMANDS, PROGRAM, load_options
from swarm_envs.envs.config import EnvConfig
from swarm_envs.envs.options import default_of, field_docstrings
from swarm_envs.envs.randomization import Randomization
from swarm_envs.hall import Hall
from swarm_envs.training.interaction_rows import InteractionRows

SETTINGS: dict[str, type] = {
    kind.__name__: kind for kind in (EnvConfig, Hall, Randomization, InteractionRows)
}
"""The dataclasses whose fields a page may ask for."""


@dataclasses.dataclass(frozen=True)
class Option:
    """A line of a table."""

    name: str
    """As it is typed; `FILE` for what has no name."""
    default: str
    """Empty if it must be given."""
    meaning: str
    """From the field's docstring."""


def options_of(cls: type, prefixes: bool, prefix: str = "") -> Iterator[Option]:
    """The options of a dataclass, those of dataclasses in it included."""
    hints, docs = get_type_hints(cls, include_extras=True), field_docstrings(cls)
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        marks: tuple[str, ...] = ()
        aliases: list[str] = []
        typed = field.name
        if get_origin(hint) is Annotated:
            hint, *rest = get_args(hint)
            marks = tuple(str(mark) for mark in rest)
            aliases = [alias for mark in rest for alias in getattr(mark, "aliases", None) or ()]
            typed = next((m.name for m in rest if getattr(m, "name", None)), typed)
        if any("suppress" in mark.lower() for mark in marks):
            continue
        name = prefix + typed.replace("_", "-")
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            yield from options_of(hint, prefixes, f"{name}." if prefixes else "")
            continue
        positional = any("positional" in mark.lower() for mark in marks)
        shown = ", ".join([*aliases, f"--{name}"]) + (f", --no-{name}" if hint is bool else "")
        if hint is bool and "." in name:
            inner = name.rpartition(".")
            shown = f"--{name}, --{inner[0]}.no-{inner[2]}"
        meaning = docs.get(field.name, "")
        yield Option(name.upper() if positional else shown, _default(field), meaning)


def _default(field: dataclasses.Field[Any]) -> str:
    value = default_of(field)
    if value is dataclasses.MISSING:
        return "must be given"
    if value is None:
        return "not given"
    many = isinstance(value, tuple | list)
    return " ".join(map(str, value)) or "none" if many else str(value)


def settings_table(name: str) -> str:
    """Options of settings in Markdown.

    Raises:
        KeyError: there are no such settings.
    """
    settings = SETTINGS[name]
    return options_table(settings, [field.name for field in dataclasses.fields(settings)])


def options_table(settings: type, names: Sequence[str]) -> str:
    """The named options of settings in Markdown."""
    fields = {field.name: field for field in dataclasses.fields(settings)}
    meanings = field_docstrings(settings)
    rows = [
        f"| `{name}` | {_cell(str(fields[name].type), code=True)} | {_default_of(fields[name])} "
        f"| {_cell(meanings[name])} |"
        for name in dict.fromkeys(names)
    ]
    return "\n".join(["| option | type | default | |", "|---|---|---|---|", *rows])


def _default_of(option: dataclasses.Field[Any]) -> str:
    default = default_of(option)
    return "" if default is dataclasses.MISSING else f"`{default!r}`"


def assignment_table() -> str:
    """The assignments of a course in Markdown, each with its page and what it is worth."""
    rows = [
        f"| [{name}]({name}.md) | {task.summary} | `{task.work}` | `{task.metric}` "
        f"| {task.zero:g} | {task.full:g} |"
        for name, task in ASSIGNMENTS.items()
    ]
    head = ["| assignment | goal | submission | metric | 0 points | 100 points |"]
    return "\n".join([*head, "|---|---|---|---|---|---|", *rows])


def command_tables() -> str:
    """Every command with its options in Markdown."""
    return "\n\n".join(map(section, COMMANDS))


def section(command: str) -> str:
    """One command in Markdown: what it does, and its options."""
    cls, prefixes = load_options(command), COMMANDS[command].prefixes
    rows = [
        f"| {' '.join(f'`{part}`' for part in option.name.split(', '))} "
        f"| {_cell(option.default, code=True)} | {_cell(option.meaning)} |"
        for option in options_of(cls, prefixes)
    ]
    title = f"{PROGRAM} {command}"
    head = ["| option | default | |", "|---|---|---|"]
    example = f"    {title} {COMMANDS[command].example}"
    said = [f"## {title}", "", inspect.getdoc(cls) or "", "", example, ""]
    return "\n".join([*said, *head, *rows])


def _cell(text: str, code: bool = False) -> str:
    flat = " ".join(text.split()).replace("|", r"\|").replace("<", "&lt;")
    plain = flat in ("", "not given", "must be given", "none")
    return flat if plain or not code else f"`{flat}`"
