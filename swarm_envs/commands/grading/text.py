"""Submissions' messages in the grader's output: short, without control characters, no formulas."""

from __future__ import annotations

import unicodedata

LONGEST = 500
"""Characters that are kept of a message."""
_HIDDEN = (
    "Cc",
    "Cf",
    "Cs",
    "Co",
    "Cn",
    "Zl",
    "Zp",
)  # Unicode's control, format and line characters
_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


def printable(words: str, longest: int = LONGEST) -> str:
    """Words on one line: control characters as escapes, and no more of them than `longest`."""
    shown = "".join(_shown(letter) for letter in words[: longest + 1])
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def _shown(letter: str) -> str:
    if unicodedata.category(letter) in _HIDDEN:
        return letter.encode("unicode_escape").decode()
    return letter


def cell(words: str) -> str:
    """Words that no spreadsheet takes for a formula, as OWASP says of CSV injection."""
    return f"'{words}" if words.startswith(_FORMULAS) else words
