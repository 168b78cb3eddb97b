"""Every Python block of the README and the docs runs as it stands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
BLOCKS = [
    pytest.param(block, id=f"{page.relative_to(ROOT)}-{k}")
    for page in PAGES
    for k, block in enumerate(BLOCK.findall(page.read_text()))
]


@pytest.mark.parametrize("block", BLOCKS)
def test_block_runs(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where it may leave files
    code = compile(block, "block", "exec", dont_inherit=True)
    exec(code, {"__name__": "block"})


def test_the_readme_has_a_loop_of_env_step() -> None:
    loops = [b for b in BLOCK.findall((ROOT / "README.md").read_text()) if "env.step(" in b]
    assert loops
    assert 15 <= len(loops[0].splitlines()) <= 25
