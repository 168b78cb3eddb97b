"""Submissions' messages in the grader's output: short, without control characters, no formulas."""

from __future__ import annotations

LONGEST = 500  # Characters that are kept of a message
_FORMULAS = ("=", "+", "-", "@", "\t", "\r")


def printable(words: str, longest: int = LONGEST) -> str:
    """Words on one line: control characters as escapes, and no more of them than `longest`."""
    letters = [c if c.isprintable() else ascii(c)[1:-1] for c in words[: longest + 1]]
    shown = "".join(letters)
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


def cell(words: str) -> str:
    """Words that no spreadsheet takes for a formula, as OWASP says of CSV injection."""
    return f"'{words}" if words.startswith(_FORMULAS) else words
