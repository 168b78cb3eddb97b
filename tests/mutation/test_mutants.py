"""The mutants are what they say, and a fork runs them: on a file made for it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("cosmic_ray")

from tests.mutation.mutants import REMOVE, mutants, sample

SOURCE = '''"""A file."""

LIMIT: float | None = 2.0


def within(x: float, low: float | None = None) -> bool:
    """Whether x is inside."""
    found = [0]
    if low is not None:
        found[0] += 1
    return -x < LIMIT and not found[0]
'''


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "file.py"
    path.write_text(SOURCE, encoding="utf-8")
    return str(path)


def test_each_mutant_changes_one_line_and_no_annotation(file: str) -> None:
    found = list(sample([file], 0, 0))
    names = {mutant.operator.removeprefix("Replace") for mutant, _ in found}
    assert {"ComparisonOperator_Lt_LtE", "UnaryOperator_Delete_USub", "AndWithOr"} <= names
    assert {"NumberReplacer", "AddNot", REMOVE, "ComparisonOperator_IsNot_Is"} <= names
    assert "BinaryOperator_BitOr_BitAnd" not in names  # the bars of annotations
    for mutant, source in found:
        before, after = SOURCE.splitlines(), source.splitlines()
        (changed,) = [
            k for k, lines in enumerate(zip(before, after, strict=True)) if len(set(lines)) > 1
        ]
        assert changed + 1 == mutant.line
        assert (
            mutant.difference(source) == f"- {before[changed].strip()}\n+ {after[changed].strip()}"
        )


def test_a_sample_is_the_beginning_of_a_larger_one(file: str) -> None:
    few, more = list(sample([file], 3, 5)), list(sample([file], 6, 5))
    assert more[:3] == few and len(more) == 6
    assert len({source for _, source in sample([file], 0, 5)}) <= len(mutants(file))
    assert list(sample([file], 6, 6)) != more
