"""Tables of docs/papers.md, from `items.csv` and the results of the commands.

    python -m examples.papers runs/papers

reads the JSON files below a folder with one folder for each paper, stores the compared numbers in
docs/papers/results.json, and writes the tables into docs/generated.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from examples.papers.common import format_number, markdown, write_json

ROOT = Path(__file__).parent.parent.parent
RESULTS = ROOT / "docs" / "papers" / "results.json"
GENERATED = ROOT / "docs" / "generated"
PAPERS = {"neural_swarm2": "Neural-Swarm2", "dmpc_swarm": "DMPC-Swarm", "rth3d": "RTH3D"}
NAMES = {"table_2_flights": "import"}  # commands whose JSON file has another name
SHOWN = 3  # results of an item that are printed

Results = Mapping[str, Sequence[Mapping[str, Any]]]  # comparisons by command, `rth3d figure-5`


class Item(NamedTuple):
    """An equation, algorithm, statement, table or figure of a paper, and where it is here."""

    paper: str
    item: str
    content: str
    code: str  # `module:name`, empty if there is none
    evidence: str  # a test, or `PAPER COMMAND TEXT`: results whose quantity has the text
    reason: str  # of a deviation

    @property
    def sources(self) -> list[str]:
        """The tests or commands of the evidence."""
        return self.evidence.split(" + ") if self.evidence else []

    def results(self, results: Results) -> list[Mapping[str, Any]]:
        """Return what the commands of the evidence found."""
        found = []
        for source in self.sources:
            if not source.startswith("tests/"):
                paper, command, text = source.split(" ", 2)
                own = results.get(f"{paper} {command}", ())
                found += [row for row in own if text in row["quantity"]]
        return found

    def verdict(self, results: Results) -> str:
        """Return `holds`, `differs`, `put in`, `measured`, or `not compared`."""
        if self.evidence.startswith("tests/"):
            return "holds"
        said = {row["difference"].split(":")[0].split(",")[0] for row in self.results(results)}
        for difference, verdict in (
            ("differs", "differs"),
            ("agrees", "holds"),
            ("put in", "put in"),
            ("nothing to compare", "measured"),
        ):
            if difference in said:
                return verdict
        return "not compared"


def items() -> list[Item]:
    """Return the items of all papers, in their order."""
    lines = (Path(__file__).parent / "items.csv").read_text(encoding="utf-8").splitlines()
    return [Item(*line.split(";", 5)) for line in lines[1:]]


def load_results() -> dict[str, Any]:
    """Return the kept comparisons, by command."""
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def collect(runs: Path) -> None:
    """Keep what the JSON files in `runs/PAPER` compare, in place of what was kept of them."""
    results = load_results() if RESULTS.is_file() else {}
    for paper in PAPERS:
        for path in sorted((runs / paper).glob("*.json")):
            found = json.loads(path.read_text(encoding="utf-8")).get("comparison")
            if found:
                command = NAMES.get(path.stem, path.stem.replace("_", "-"))
                results[f"{paper} {command}"] = found
    write_json(RESULTS, dict(sorted(results.items())))


def pages(results: Results) -> dict[str, str]:
    """Return the counts of verdicts and the table of each paper as Markdown, by file name."""
    all_items = items()
    counts = Counter(item.verdict(results) for item in all_items)
    found = {
        "papers": f"{len(all_items)} items: {counts['holds']} hold, {counts['differs']} differ, "
        f"{counts['put in']} follow from what was put in, {counts['measured']} have no value in "
        f"the paper, {counts['not compared']} are not compared.\n"
    }
    for name, paper in PAPERS.items():
        lines = [line(item, results) for item in all_items if item.paper == paper]
        found[name] = markdown(lines, list(lines[0])) + "\n"
    return found


def line(item: Item, results: Results) -> dict[str, str]:
    """Return the line of an item."""
    found, verdict = item.results(results), item.verdict(results)
    reasons = [row["difference"].partition(": ")[2] for row in found]
    reasons = list(dict.fromkeys([*filter(None, reasons), *filter(None, [item.reason])]))
    code = f"`{item.code.rpartition(':')[2]}` ({item.code.partition(':')[0]})" if item.code else ""
    sources = dict.fromkeys(_short(source) for source in item.sources)
    shown = "; ".join(map(result, found[:SHOWN])) + (" ..." if len(found) > SHOWN else "")
    return {
        "item": f"{item.item}: {item.content}",
        "code": code,
        "by": ", ".join(sources),
        "result (paper)": shown,
        "verdict": verdict + (f": {'; '.join(reasons)}" if reasons else ""),
    }


def _short(source: str) -> str:
    if source.startswith("tests/"):
        return f"`{source.rpartition('::')[2]}`"
    return f"`{' '.join(source.split(' ', 2)[:2])}`"


def result(row: Mapping[str, Any]) -> str:
    """Return a number with its spread and the paper's."""
    number = "none" if row["result"] is None else format_number(row["result"])
    if row["spread"]:
        number += f" [{', '.join(format_number(end) for end in row['spread'])}]"
    return f"{number} ({row['paper']})"


def write_pages(runs: Path | None = None) -> None:
    """Collect the results below a folder, if one is given, and write the tables."""
    if runs is not None:
        collect(runs)
    for name, text in pages(load_results()).items():
        (GENERATED / f"{name}.md").write_text(text, encoding="utf-8")
