"""Words that the docs, docstrings and messages do not use, each with the usual term.

`python -m tests.helpers.vocabulary`, part of `make lint`, prints every place and fails if there is
one. A phrase in `EVERYWHERE` is refused in pages, docstrings and messages, one in `PAGES_ONLY` in
pages.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.helpers.imports import ROOT, SOURCES
from tests.helpers.pages import PAGES

EVERYWHERE = {
    r"\banew\b": "again, or a verb: resample, restart, rewrite",
    r"\b(?:goes|going|went) on\b": "continues; of a command: resumes",
    r"\bcalled again, it\b": "run again, it",
    r"\bcompiled twin\b": "compiled engine",
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
PAGES_ONLY = {
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
}
"""Phrases that are refused in pages and help texts as well."""
_PROOF = ROOT / "docs" / "mlr-dmpc" / "proof.md"  # its words are those of mathematics
_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def found_in(text: str, words: Mapping[str, str]) -> Iterator[tuple[int, str, str]]:
    """Lines of a text from 0 on, the phrase that stands there, and the usual term."""
    for phrase, usual in words.items():
        for match in re.finditer(phrase.replace(" ", r"\s+"), text, re.IGNORECASE):
            yield text[: match.start()].count("\n"), " ".join(match[0].split()), usual


def prose_of(page: Path) -> str:
    """A page with its code blanked, so that lines keep their numbers."""
    text = page.read_text(encoding="utf-8")
    return _FENCE.sub(lambda block: "\n" * block[0].count("\n"), text)


def places() -> Iterator[str]:
    """Every place in pages, docstrings and messages, as `file:line: 'phrase'; usual: term`."""
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES):
        if page != _PROOF:
            for line, phrase, usual in found_in(prose_of(page), EVERYWHERE | PAGES_ONLY):
                yield f"{page.relative_to(ROOT)}:{line + 1}: {phrase!r}; usual: {usual}"
    for file in SOURCES.values():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                for line, phrase, usual in found_in(node.value, EVERYWHERE):
                    where = f"{file.relative_to(ROOT)}:{node.lineno + line}"
                    yield f"{where}: {phrase!r}; usual: {usual}"


def main() -> int:
    """Print all places; 1 if there are any."""
    found = [*dict.fromkeys(places())]
    print("\n".join(found) or "no word that the field does not use")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
