"""Docstrings as reStructuredText: ours are plain text, Google's sections, names in backticks."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import groupby
from typing import Any

from sphinx.ext.napoleon import Config
from sphinx.ext.napoleon.docstring import GoogleDocstring

from .names import resolve

SECTION = re.compile(r"^(Args|Returns|Raises|Yields|Attributes|Example|Examples|Note|Notes):$")
_CODE = re.compile(r"`+([^`]+)`+")
_IMPORT = re.compile(r"(from \S+ )?import \S+")
_SIMPLE_TABLE = re.compile(r"=+( +=+)+\n")
_CONFIG = Config(napoleon_use_rtype=False, napoleon_use_ivar=True)


def as_rst(lines: list[str], what: str, name: str) -> list[str]:
    """A docstring as autodoc wants it.

    Args:
        lines: of the docstring, without indentation.
        what: `module`, `class`, `function`, ...: of whom.
        name: the full name of that.
    """
    text = "\n".join(_quote_blocks(_free_lists(_tables(_returns(_code(lines))))))
    parts = re.split(r"(\n\n)", text)
    marked = "".join(_inline(p, lambda word: _name(word, name)) for p in parts)
    kind = "function" if what in ("attribute", "data", "property") else what
    return GoogleDocstring(marked.split("\n"), _CONFIG, what=kind, name=name).lines()


def _name(word: str, where: str) -> str:
    target = resolve(word, where)
    return f":py:obj:`{word} <{target}>`" if target else f"``{word}``"


def _inline(text: str, code: Callable[[str], str]) -> str:
    """Names in backticks marked, and whatever else reStructuredText would read as a mark."""
    if _SIMPLE_TABLE.match(text):
        return text  # its columns would no longer stand below each other
    out, last = [], 0
    for found in _CODE.finditer(text):
        out += [_escape(text[last : found.start()]), code(" ".join(found[1].split()))]
        last = found.end()
        if text[last : last + 1].isalnum():
            out.append("\\ ")
    return "".join([*out, _escape(text[last:])])


def _escape(text: str) -> str:
    text = re.sub(r"\|", r"\\|", text)
    text = re.sub(r"(?<=\w)_(?!\w)", r"\\_", text)
    return re.sub(r"(?<!\*)\*(?![*\s])(?!\w+: )", r"\\*", text)


def _returns(lines: list[str]) -> list[str]:
    """The same, where a colon in what is returned does not end a type: we give none."""
    out = list(lines)
    for k, line in enumerate(lines[:-1]):
        if line.strip() == "Returns:":
            body = lines[k + 1]
            out[k + 1] = body[: len(body) - len(body.lstrip())] + ": " + body.lstrip()
    return out


def _code(lines: list[str]) -> list[str]:
    """Paragraphs that begin with an import, indented as the code that they are."""
    out: list[str] = []
    code = False
    for line in lines:
        begins = not out or not out[-1].strip()
        code = bool(line.strip()) and (code or (begins and bool(_IMPORT.match(line))))
        out.append("    " + line if code else line)
    return out


def _tables(lines: list[str]) -> list[str]:
    """Tables of pipes as `list-table`."""
    out: list[str] = []
    for is_row, group in groupby(lines, key=lambda line: line.startswith("|")):
        rows = list(group)
        if not is_row or len(rows) < 3:
            out += rows
            continue
        out += ["", ".. list-table::", ""]
        for row in [rows[0], *rows[2:]]:
            cells = [cell.strip() for cell in row.strip("|").split("|")]
            if any(cells):
                out += [f"   {'*' if k == 0 else ' '} - {cell}" for k, cell in enumerate(cells)]
        out.append("")
    return out


def _free_lists(lines: list[str]) -> list[str]:
    """A blank line before each list."""
    out: list[str] = []
    for line in lines:
        before = out[-1] if out else ""
        if line.startswith("- ") and before.strip() and not before.startswith(("- ", "  ")):
            out.append("")
        out.append(line)
    return out


def _quote_blocks(lines: list[str]) -> list[str]:
    """Blocks of four spaces or more, after a blank line and outside sections, as they stand."""
    out: list[str] = []
    section = quoted = False
    for line in lines:
        if line and not line.startswith(" "):
            section, quoted = bool(SECTION.match(line)), False
        begins = line.startswith("    ") and (not out or not out[-1].strip())
        if begins and not section and not quoted and _outside_list(out):
            out += ["::", ""]
            quoted = True
        out.append(line)
    return out


def _outside_list(lines: list[str]) -> bool:
    last = next((line for line in reversed(lines) if line.strip()), "")
    return not last.startswith(("- ", "  ", ".. "))


def setup(app: Any) -> dict[str, Any]:
    """Tell Sphinx."""

    def convert(app: Any, what: str, name: str, obj: Any, opt: Any, lines: list[str]) -> None:
        lines[:] = as_rst(lines, what, name)

    def shorten(
        app: Any, what: str, name: str, obj: Any, opt: Any, signature: str | None, back: str | None
    ) -> tuple[str | None, str | None]:
        """`<factory>` and other defaults that are no Python would leave a signature unread."""
        return re.sub(r"= <[^<>]*>", "= ...", signature or "") or signature, back

    app.connect("autodoc-process-docstring", convert)
    app.connect("autodoc-process-signature", shorten)
    return {"parallel_read_safe": True}
