"""The scoreboard as one HTML page that needs no server and no network.

It is whole without JavaScript: the script only sorts, filters, and puts one metric in the place
of another, out of numbers in the page. A policy in its head forbids it to fetch
anything, and any script but its own to run.

Matplotlib draws the charts as SVG in the page. They have the page's own colours, light or dark.
What belongs to an agent is in groups with its name, so that a script can bring it out.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from html import escape
from importlib import resources
from io import StringIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle

from swarm_envs.files import written_whole
from swarm_envs.training.scoreboard.board import Board, Entry, read
from swarm_envs.training.scoreboard.markup import Content, format_duration, format_value, html, tag
from swarm_envs.training.scoreboard.tables import PRIVILEGED, Tables, short_label

__all__ = ["write"]


WIDTH, HEIGHT = 400, 280
"""Of a chart, in units of which its text is 12 high."""
FRAME = (0.13, 0.145, 0.815, 0.82)  # Left, bottom, width and height of its axes, as shares of that
_MARKERS, _OTHER = "osD^vP*X", "."
"""Shapes, so that nobody needs colours to tell agents apart; and of agents without a colour."""
_DASHES = ("-", (0, (3.5, 1.5)), (0, (1, 1.25)), (0, (4.5, 1.5, 1, 1.5)))
_OWN, _QUIET, _LINE = "#010101", "#020202", "#030303"
_THEME = {_OWN: "var(--own)", _QUIET: "var(--quiet)", _LINE: "var(--line)"}
"""What stands for a colour in a drawing, and the style sheet's name of that colour."""
_STYLE: Any = {
    "font.size": 12,
    "font.sans-serif": ["DejaVu Sans"],
    "text.color": _QUIET,
    "text.parse_math": False,  # users choose names
    "axes.labelcolor": _QUIET,
    "axes.axisbelow": True,
    "xtick.color": _QUIET,
    "ytick.color": _QUIET,
    "ytick.major.size": 0,
    "grid.color": _LINE,
    "lines.linewidth": 2,
    "path.simplify": False,
    "svg.fonttype": "none",
}
Palette = dict[str, int]
"""Number of each agent's colour and marker, if it has one: the same all over the page."""


def palette(board: Board) -> Palette:
    """Colours for the best of each family in turn, as many as people tell apart."""
    orders = [board.ranked(family) for family in board.families]
    turns = [order[k] for k in range(len(board.agents)) for order in orders if k < len(order)]
    return {name: k for k, name in enumerate([*dict.fromkeys(turns)][: len(_MARKERS)])}


def color_class(colors: Palette, name: str) -> str:
    """The class that gives an element its agent's colour."""
    return f"c{colors[name]}" if name in colors else "cx"


def swatch(colors: Palette, name: str) -> Element:
    """An agent's marker beside its name in a text."""
    style = MarkerStyle(_MARKERS[colors[name]] if name in colors else _OTHER)
    path = style.get_path().transformed(style.get_transform())
    outline = np.asarray(path.to_polygons()[0]).tolist()
    points = "L".join(f"{7 + 9 * x:.1f} {7 - 9 * y:.1f}" for x, y in outline)
    of = color_class(colors, name)
    drawn = tag("path", d=f"M{points}Z")
    return tag("svg", drawn, viewBox="0 0 14 14", class_=f"swatch {of}", aria_hidden="true")


def profile_chart(board: Board, colors: Palette, family: str) -> Element:
    """How many of a family's runs reach each score, a line an agent."""
    profile, label = board.profiles[family], f"Performance profiles, {family}"
    groups: dict[str, tuple[str, str, str]] = {}

    def belongs(artist: Artist, kind: str, name: str, title: str = "") -> None:
        """Say whose a part of the drawing is; the title is shown to whoever points at it."""
        artist.set_gid(key := f"{kind}-{len(groups)}")
        groups[key] = f"{kind} {color_class(colors, name)}", name, title

    with mpl.rc_context({**_STYLE, "svg.hashsalt": label}):
        figure = Figure(figsize=(WIDTH / 72, HEIGHT / 72), dpi=72, frameon=False)
        axes = figure.add_axes(FRAME, frameon=False)
        axes.grid(axis="y")
        shares, x = (0.0, 0.25, 0.5, 0.75, 1.0), profile["thresholds"]
        axes.set_yticks(shares, [f"{100 * share:.0f}" for share in shares])
        axes.set(xlabel=profile["label"], ylabel="runs that reach it, %")
        axes.set(xlim=(x[0], x[-1]), ylim=(0.0, 1.0))
        # Those with the first colours are drawn last, above the others.
        for name in sorted(profile["agents"], key=lambda name: -colors.get(name, len(colors))):
            curve = profile["agents"][name]
            around = [*curve["high"], *curve["low"][::-1]]
            (band,) = axes.fill([*x, *x[::-1]], around, color=_OWN, alpha=0.14, linewidth=0)
            belongs(band, "band", name)
            dashes = _DASHES[colors.get(name, 0) % len(_DASHES)]
            (line,) = axes.plot(x, curve["fraction"], color=_OWN, linestyle=dashes)
            belongs(line, "line", name, board.agents[name]["label"])
        file = StringIO()
        figure.savefig(file, format="svg")
    drawn = fromstring(file.getvalue())
    for each in drawn.iter():
        _adopt(each, groups)
    content = [each for each in drawn if each.tag == "g"]
    return tag("svg", content, viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img", aria_label=label)


def _adopt(element: Element, groups: Mapping[str, tuple[str, str, str]]) -> None:
    """Make an element of a drawing one of the page: without namespaces, in its colours."""
    given = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
    given.pop("clip-path", None)  # nothing is drawn outside of the axes
    if "d" in given:
        given["d"] = re.sub(r"(\.\d\d)\d+", r"\1", " ".join(given["d"].split()))
    for color, variable in _THEME.items():
        if "style" in given:
            given["style"] = given["style"].replace(color, variable)
    element.tag = element.tag.rpartition("}")[2]
    if element.tag == "g":
        kind, name, title = groups.get(given.pop("id", ""), ("", "", ""))
        if kind:
            given |= {"class": kind, "data-agent": name}
        if title:
            element.insert(0, tag("title", title))
    element.attrib.clear()
    element.attrib.update(given)


FILE = "report.html"
"""The page's name in a scoreboard's folder."""
_BETTER = {"higher": "more is better", "lower": "less is better", "neither": ""}


def write(folder: Path) -> Path:
    """Write the page of a scoreboard's folder, whole or not at all.

    Args:
        folder: holds `scores.json`; replays that it names are linked if they are there.

    Returns:
        The page.

    Raises:
        FileNotFoundError: there is no `scores.json`.
        ValueError: it is of another format or version, or damaged; the message says where.
        OSError: the page cannot be written.
    """
    text = _page(read(folder), lambda file: (folder / file).is_file())
    with written_whole(folder / FILE) as partial:
        partial.write_text(text, encoding="utf-8")
    return folder / FILE


def _page(board: Board, linked: Callable[[str], bool]) -> str:
    colors, tables, script = palette(board), Tables(board, linked), _asset("report.js")
    parts: dict[str, Content] = {
        "facts": tag("dl", [_defined(*pair) for pair in _facts(board.manifest)], class_="facts"),
        "leaderboards": _leaderboards(board, colors),
        "families": [tag("option", family, value=family) for family in board.families],
        "metrics": [tag("option", metric.label, value=metric.name) for metric in board.metrics],
        "matrix": tables.matrix(),
        "not_flown": _not_flown(board),
        "legend": _legend(board, colors),
        "profiles": _profiles(board, colors),
        "numbers": tables.every_number(),
        "reproduce": _reproduce(board),
        "glossary": _glossary(board),
    }
    texts = {
        "title": "swarm-envs scoreboard",
        "script_hash": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        "css": _asset("report.css"),
        "script": script,
        "summary": escape(_summary(board)),
        **{name: html(content) for name, content in parts.items()},
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: texts[found[1]], _asset("report.html"))


def _asset(name: str) -> str:
    folder = resources.files("swarm_envs.training.scoreboard").joinpath("page")
    return folder.joinpath(name).read_text(encoding="utf-8")


def _summary(board: Board) -> str:
    flown = [cell for cell in board.cells if cell["status"] == "flown"]
    episodes = sum(cell["episodes"] for cell in flown)
    return (
        f"{len(board.agents)} agents on {len(board.tasks)} tasks: {len(flown)} pairs flown, "
        f"{format_value(episodes)} episodes. On each task all fly the "
        "same frozen seeds, slow agents the first of them."
    )


def _facts(manifest: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    started = str(manifest.get("started") or "")
    if started:
        yield "Started", started[:16].replace("T", " ") + " UTC"
    taken = [
        f"{format_duration(manifest[key])} {word}"
        for key, word in (("wall_s", "wall"), ("cpu_s", "CPU"))
        if type(manifest.get(key)) in (int, float)
    ]
    if taken:
        yield "Took", ", ".join(taken)
    machine = manifest.get("machine")
    if isinstance(machine, dict):
        cores = machine.get("cores")
        parts = [machine.get("cpu"), f"{cores} cores" if cores else None, machine.get("system")]
        yield "Machine", ", ".join(str(part) for part in parts if part)
    versions = manifest.get("versions")
    if isinstance(versions, dict):
        yield "Versions", ", ".join(f"{name} {v}" for name, v in versions.items() if v)
    if manifest.get("commit"):
        yield "Commit", str(manifest["commit"])[:12]
    yield "Configuration", str(manifest.get("config_hash", "unknown"))[:12]


def _leaderboards(board: Board, colors: Palette) -> list[Element]:
    cards = []
    for family in board.families:
        names, standings = board.ranked(family), board.aggregates.get(family, {})
        if not names:
            continue
        tasks = [task.id for task in board.tasks if task.task == family]
        rows = []
        for place, name in enumerate(names, 1):
            cells = (board.pairs.get((task, name)) for task in tasks)
            flown = sum(cell is not None and cell["status"] == "flown" for cell in cells)
            part = f"{flown}/{len(tasks)}" if flown < len(tasks) else ""
            rows.append(_place(place, board.agents[name], standings[name], part, colors))
        what = standings[names[0]].get("metric", "score")
        about = tag("p", what[:1].upper() + what[1:], class_="quiet")
        ranking = tag("ol", rows, _scale(), class_="board")
        cards.append(tag("article", tag("h3", family), about, ranking))
    return cards


def _place(place: int, agent: Entry, standing: Entry, part: str, colors: Palette) -> Element:
    low, high = standing.get("interval") or (standing["value"], standing["value"])
    text = format_value(standing["value"], "%")
    ends = f"{format_value(low, '%')} to {format_value(high, '%')} %"
    said = f"{text} %, 95 % interval {ends}"
    whisker = tag("i", style=f"left:{100 * low:.2f}%;width:{100 * (high - low):.2f}%")
    dot = tag("b", style=f"left:{100 * standing['value']:.2f}%")
    who = (
        swatch(colors, agent["name"]),
        tag("span", agent["label"], class_="label", title=agent["label"]),
        tag("abbr", "◆", title=PRIVILEGED) if agent["privileged"] else None,
        tag("small", part, title="tasks flown, of those of this family") if part else None,
    )
    return tag(
        "li",
        tag("span", str(place), class_="rank"),
        tag("span", who, class_="who"),
        tag("span", whisker, dot, class_="bar", title=said),
        tag("span", text, class_="score", title=said),
        class_=color_class(colors, agent["name"]),
        data_agent=agent["name"],
    )


def _scale() -> Element:
    ticks = [tag("i", text, style=f"left:{text}%") for text in ("0", "50", "100")]
    axis = tag("span", ticks, class_="bar axis")
    name = tag("span", "score, %", class_="score")
    return tag("li", tag("span"), name, axis, class_="axis", aria_hidden="true")


def _not_flown(board: Board) -> Element | None:
    """What has no numbers, or not all, and why: each agent and reason once, with the tasks."""
    labels = {name: agent["label"] for name, agent in board.agents.items()}
    tasks = {task.id: f"{task.task} {short_label(task)}" for task in board.tasks}
    groups: dict[tuple[str, str, str], list[str]] = {}
    for cell in board.cells:
        if cell["status"] != "flown" or cell["reason"]:
            key = cell["status"], cell["agent"], cell["reason"]
            groups.setdefault(key, []).append(tasks[cell["task"]])
    if not groups:
        return None
    rows = []
    for (status, name, reason), where in sorted(groups.items()):
        said = "in part" if status == "flown" else status
        word, who = tag("span", said, class_=f"word {status}"), tag("strong", labels[name])
        why = f": {reason or 'no reason was given'} "
        rows.append(
            tag("li", word, " ", who, why, tag("span", f"({', '.join(where)})", class_="quiet"))
        )
    count = sum(map(len, groups.values()))
    title = f"Why {count} of {len(board.cells)} pairs have no numbers, or (†) not of all episodes"
    return tag("details", tag("summary", title), tag("ul", rows, class_="reasons"))


def _legend(board: Board, colors: Palette) -> Element:
    """All agents of the charts; a script makes each a switch that brings it out."""
    shown = {name for family in board.families for name in board.ranked(family)}
    labels = {name: agent["label"] for name, agent in board.agents.items()}
    names = [*colors, *(name for name in labels if name in shown and name not in colors)]
    return tag(
        "ul",
        [tag("li", tag("span", swatch(colors, n), labels[n], data_key=n)) for n in names],
        class_="legend",
    )


def _profiles(board: Board, colors: Palette) -> list[Element]:
    return [
        tag("figure", tag("figcaption", family), profile_chart(board, colors, family))
        for family in board.families
        if family in board.profiles
    ]


def _reproduce(board: Board) -> list[Element]:
    manifest = board.manifest
    command = str(manifest.get("command") or "swarm-envs benchmark --out scoreboard")
    config = json.dumps(manifest.get("config", {}), indent=1, ensure_ascii=False)
    seed = manifest.get("seed", "unknown")
    return [
        tag("pre", tag("code", command)),
        tag(
            "p",
            f"The seeds of all episodes follow from seed {seed}; the first of many are those of "
            "few. The same configuration gives the same numbers on the same machine; times of "
            "compute are those of this machine. SHA-256 of the configuration: ",
            tag("code", str(manifest.get("config_hash", "unknown")), class_="hash"),
        ),
        tag(
            "p",
            "Each episode's numbers are in ", tag("code", "episodes.parquet"), " (or ",
            tag("code", ".csv"), "), what this page shows in ", tag("code", "scores.json"),
            ", what was run where in ",
            tag("code", "manifest.json"), ".",
        ),
        tag("details", tag("summary", "The configuration"), tag("pre", tag("code", config))),
    ]  # fmt: skip


def _glossary(board: Board) -> list[Element]:
    metrics, tasks = [], []
    for metric in board.metrics:
        words = filter(None, (metric.unit, _BETTER[metric.better], metric.name))
        about = tag("small", "; ".join(words))
        metrics.append(_defined(metric.label, [metric.help, " ", about]))
    options = [task.options for task in board.tasks]
    common = {k: v for k, v in options[0].items() if all(o.get(k) == v for o in options)}
    for task in board.tasks:
        own = {name: value for name, value in task.options.items() if name not in common}
        about = tag("small", f"{_as_text(own)}; {task.episodes} episodes")
        tasks.append(_defined(task.label, [tag("code", task.id), f" {task.help} ", about]))
    agents = [
        _defined(
            agent["label"],
            [agent["help"], " ", tag("em", f"◆ {PRIVILEGED}") if agent["privileged"] else None],
        )
        for agent in board.agents.values()
    ]
    for_all = tag("p", f"Each with {_as_text(common)}." if common else None, class_="quiet")
    return [
        tag("h3", "Metrics"), tag("dl", metrics, class_="terms"),
        tag("h3", "Tasks"), for_all, tag("dl", tasks, class_="terms"),
        tag("h3", "Agents"), tag("dl", agents, class_="terms"),
    ]  # fmt: skip


def _defined(name: str, content: Content) -> Element:
    return tag("div", tag("dt", name), tag("dd", content))


def _as_text(options: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name} {value if isinstance(value, str) else json.dumps(value)}"
        for name, value in options.items()
    )
