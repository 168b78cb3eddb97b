"""Words that the docs, docstrings and messages do not use, each with the usual term.

`python -m tests.helpers.vocabulary`, part of `make lint`, prints every place and fails if there is
one. A phrase in `EVERYWHERE` is refused in all strings of the package, one in `READ` in what users
read: pages with comments of their code, generated pages, model cards, assignments, messages, the
help of commands, and docstrings of modules and of the names that they offer.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.helpers.imports import ROOT, SOURCES
from tests.helpers.pages import GENERATED, PAGES

EVERYWHERE = {
    r"\banew\b": "again, or a verb: resample, restart, rewrite",
    r"\b(?:goes|going|went) on\b": "continues; of a command: resumes",
    r"\bcalled again, it\b": "run again, it",
    r"\b(?:trembl\w+)\b": "jitter",
    r"\bpaid for\b": "rewarded for, or penalized for",
    r"\bcounted by time\b": "multiplied by the step duration",
    r"\bblow(?:s|n)? on each other\b": "downwash, or aerodynamic interaction",
    r"\bone by one\b": "one at a time",
    r"\beverybody\b": "all drones, all agents",
    r"\bsomebody\b": "a drone, an agent, a user",
    r"\bhas its word\b|\bown word\b": "estimate, value",
    r"\bbooleans are none\b": "booleans are refused",
}
"""Phrases that are refused everywhere, and what Gymnasium, Stable-Baselines3 or MuJoCo say."""
READ = {
    r"\bnobody\b": "no drone, no agent",
    r"\bwhoever\b": "the agent that, the user who",
    r"\bours\b": "swarm-envs, this package",
    r"\bof our own\b": "custom, included",
    r"`(?:learned|wake)` air\b|\bin air that\b": "environment with the force model",
    r"\bis told\b|\bare told\b": "receives",
    r"\bstands? in\b": "is in, are in",
    r"\bbeside\b": "next to, in addition to, compared with",
    r"\bremade\b": "reproduced",
    r"\bgives? way\b": "yields, avoids",
    r"\bwhat ships\b": "what is included",
    r"\bhow to trust\b|\bdares?\b": "how valid, uses",
    r"\b(?:killed|interrupted),? the same command\b": "commands resume: see docs/commands.md",
    r"\bnew here\b": "new users",
    r"\bone name\b": "a single function",
    r"\bthe clock\b": "the time limit",
    r"\bpasses over\b": "epochs",
    r"\bstrangers?\b": "users, unknown types",
    r"\blest\b": "so that ... not",
    r"\bwishe[sd]\b|\bwish\b": "request, set",
    r"\bwho flies\b": "the agent",
    r"\bcompiled twin\b|\btwin engine\b": "compiled engine",
}
"""Phrases that are refused in what users read as well."""
WRITTEN = [
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")),
    *(page for page in PAGES if page.name != "proof.md"),  # whose words are those of mathematics
    *sorted(GENERATED.glob("*.md")),
    *sorted(ROOT.glob("swarm_envs/*/weights/MODEL_CARD.md")),
    *sorted(ROOT.glob("*/**/weights/MODEL_CARD.md")),
    *sorted((ROOT / "swarm_envs" / "assignments").glob("*/README.md")),
]
"""Every text that users read; of the changelog, the versions from 0.2.0 on."""
_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def found_in(text: str, words: Mapping[str, str]) -> Iterator[tuple[int, str, str]]:
    """Lines of a text from 0 on, the phrase that stands there, and the usual term."""
    for phrase, usual in words.items():
        for match in re.finditer(phrase.replace(" ", r"\s+"), text, re.IGNORECASE):
            yield text[: match.start()].count("\n"), " ".join(match[0].split()), usual


def prose_of(page: Path) -> str:
    """A page with the code in its blocks blanked, but for comments; lines keep their numbers."""
    text = page.read_text(encoding="utf-8")
    return _FENCE.sub(lambda block: "\n".join(map(_comment, block[0].split("\n"))), text)


def _comment(line: str) -> str:
    found = re.search(r"(?:^|\s)#\s.*|\"\"\".*|/\*.*", line)
    return found[0] if found else ""


def read_by_users(file: Path) -> Iterator[tuple[int, str]]:
    """Texts of a module that users read, with their first lines: its docstring and messages.

    Those of names that it offers, and of options, which are the help of commands, too.
    """
    tree = ast.parse(file.read_text(encoding="utf-8"))
    listed = {"__all__"}
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            listed |= set(ast.literal_eval(node.value))
    for node in tree.body:
        name = getattr(node, "name", "")
        shown = name in listed or re.search("(Options|Fields|Config)$", name)
        parts = [node] if node is tree.body[0] or shown else filter(_is_raise, ast.walk(node))
        for part in parts:
            for text in ast.walk(part):
                if isinstance(text, ast.Constant) and " " in str(text.value):
                    yield text.lineno, str(text.value)


def _is_raise(node: ast.AST) -> bool:
    return isinstance(node, ast.Raise)


def places() -> Iterator[str]:
    """Every place in pages, docstrings and messages, as `file:line: 'phrase'; usual: term`."""
    texts: list[tuple[Path, int, str, Mapping[str, str]]] = []
    for page in WRITTEN:
        text = prose_of(page)
        text = text.partition("\n## 0.1.0")[0] if page.name == "CHANGELOG.md" else text
        texts.append((page, 1, text, EVERYWHERE | READ))
    for file in SOURCES.values():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append((file, node.lineno, node.value, EVERYWHERE))
        texts += ((file, first, text, READ) for first, text in read_by_users(file))
    for file, first, text, words in texts:
        for line, phrase, usual in found_in(text, words):
            yield f"{file.relative_to(ROOT)}:{first + line}: {phrase!r}; usual: {usual}"


def main() -> int:
    """Print all places; 1 if there are any."""
    found = [*dict.fromkeys(places())]
    print("\n".join(found) or "no word that the field does not use")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
