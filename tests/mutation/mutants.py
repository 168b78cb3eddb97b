"""Mutants of a source file: small changes that its tests should notice.

Most are made by cosmic-ray's operators. Its own runner starts a process for each mutant, which
costs seconds of imports every time, so `tests.mutation.runner` stands in its place. Decorators
stay, since uncompiled they do nothing, and so do annotations, which are never evaluated.
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import parso  # first, since cosmic_ray imports its modules in an order that fails
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider

assert parso

_BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul Pow_Mul FloorDiv_Mul Mod_Mul BitAnd_BitOr BitOr_BitAnd"
_COMPARISON = "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq "
_IDENTITY = "Is_IsNot IsNot_Is"
_UNARY = "Delete_USub Delete_Not Delete_Invert"

OPERATORS = (
    *(f"ReplaceBinaryOperator_{pair}" for pair in _BINARY.split()),
    *(f"ReplaceComparisonOperator_{pair}" for pair in (_COMPARISON + _IDENTITY).split()),
    *(f"ReplaceUnaryOperator_{change}" for change in _UNARY.split()),
    "AddNot",
    "NumberReplacer",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ZeroIterationForLoop",
)
"""Those of cosmic-ray that change meaning by little: the many that no float survives, such as
shifts, would only be counted as kills."""

REMOVE = "RemoveStatement"
"""Our own: a call, or a store into an array, an attribute or a sum, is left out."""


@dataclass(frozen=True)
class Mutant:
    """One change to one file."""

    path: str
    operator: str
    occurrence: int
    line: int

    def source(self) -> str | None:
        """The changed text, or None where that is no Python, or means what it did."""
        text = _text(self.path)
        if self.operator == REMOVE:
            changed = _without(text, _statements(text)[self.occurrence])
        else:
            changed = mutate_code(text, OperatorProvider()[self.operator](), self.occurrence)
        try:
            same = ast.dump(ast.parse(changed)) == ast.dump(ast.parse(text))
        except SyntaxError:
            return None
        return None if same else changed

    def difference(self, source: str) -> str:
        """The lines of a source that differ from the file's: `- before` and `+ after`."""
        lines = _text(self.path).splitlines(), source.splitlines()
        changed = difflib.unified_diff(*lines, n=0, lineterm="")
        kept = [x for x in changed if x[0] in "+-" and not x.startswith(("+++", "---"))]
        return "\n".join(f"{line[0]} {line[1:].strip()}" for line in kept)


@cache
def mutants(path: str) -> tuple[Mutant, ...]:
    """Every mutant of a file, in an order that depends on nothing but its text."""
    text = _text(path)
    found, nodes = [], list(ast_nodes(get_ast(text)))
    ignored = set(_annotation_positions(ast.parse(text)))
    for name in OPERATORS:
        operator: Any = OperatorProvider()[name]()
        starts = [start for node in nodes for start, _ in operator.mutation_positions(node)]
        found += [Mutant(path, name, k, at[0]) for k, at in enumerate(starts) if at not in ignored]
    removed = enumerate(_statements(text))
    return (*found, *(Mutant(path, REMOVE, k, statement.lineno) for k, statement in removed))


def sample(paths: Iterable[str], size: int, seed: int) -> Iterator[tuple[Mutant, str]]:
    """Mutants of several files with their sources, drawn without replacement."""
    everything = [mutant for path in paths for mutant in mutants(path)]
    drawn = np.random.default_rng(seed).permutation(len(everything)).tolist()
    pairs = ((everything[k], everything[k].source()) for k in drawn)
    usable = ((mutant, source) for mutant, source in pairs if source is not None)
    return islice(usable, size or None)


@cache
def _text(path: str) -> str:
    return Path(path).read_text(encoding="utf-8")


def _annotation_positions(tree: ast.Module) -> Iterator[tuple[int, int]]:
    """(line, column) of every character of an annotation."""
    for node in ast.walk(tree):
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(part, ast.expr):
                assert part.end_lineno is not None and part.end_col_offset is not None
                for line in range(part.lineno, part.end_lineno + 1):
                    first = part.col_offset if line == part.lineno else 0
                    last = part.end_col_offset if line == part.end_lineno else 200
                    yield from ((line, column) for column in range(first, last))


@cache
def _statements(text: str) -> tuple[ast.stmt, ...]:
    statements = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.stmt))
    return tuple(node for node in statements if _does_something(node))


def _without(text: str, statement: ast.stmt) -> str:
    lines = text.splitlines(keepends=True)
    first, last = statement.lineno - 1, statement.end_lineno
    return "".join([*lines[:first], f"{' ' * statement.col_offset}pass\n", *lines[last:]])


def _does_something(node: ast.stmt) -> bool:
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    if isinstance(node, ast.Assign):
        return all(isinstance(target, ast.Subscript | ast.Attribute) for target in node.targets)
    return isinstance(node, ast.AugAssign)
