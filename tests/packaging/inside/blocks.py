"""Run every Python block of a page, as it stands: python blocks.py PAGE."""

from __future__ import annotations

import re
import sys
from pathlib import Path

BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)

page = Path(sys.argv[1])
blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
assert blocks, f"{page} has no Python block"
for number, block in enumerate(blocks, 1):
    print(f"--- block {number} of {page.name}", flush=True)
    exec(compile(block, f"{page.name}, block {number}", "exec", dont_inherit=True), {})
