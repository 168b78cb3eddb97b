"""Runs that are killed in the middle."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def calls_of(
    owner: Any, name: str, killed_at: int | None = None
) -> Iterator[list[tuple[Any, ...]]]:
    """Note the arguments of each call of a function of `owner`, and be killed in one, from 1."""
    original, calls = getattr(owner, name), list[tuple[Any, ...]]()

    def counted(*arguments: Any, **options: Any) -> Any:
        calls.append(arguments)
        if len(calls) == killed_at:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, counted)
        yield calls
