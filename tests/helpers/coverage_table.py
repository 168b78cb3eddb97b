"""Covered lines by package, as a table of Markdown, from what `coverage json` wrote."""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path, PurePosixPath

_DEEP = ("baselines", "training", "swarm_envs")


def table(files: dict[str, dict[str, dict[str, int]]]) -> str:
    """Lines and covered lines by package."""
    total, covered = Counter[str](), Counter[str]()
    for path, facts in files.items():
        for name in (_package(PurePosixPath(path)), "all"):
            total[name] += facts["summary"]["num_statements"]
            covered[name] += facts["summary"]["covered_lines"]
    order = [*sorted(name for name in total if name != "all"), "all"]
    lines = ["| package | statements | covered | % |", "|---|--:|--:|--:|"]
    for name in order:
        share = 100 * covered[name] / max(total[name], 1)
        lines.append(f"| `{name}` | {total[name]} | {covered[name]} | {share:.1f} |")
    return "\n".join(lines)


def _package(path: PurePosixPath) -> str:
    """`training/rl` of `training/rl/ppo.py`; `agents` of anything in it."""
    depth = 2 if path.parts[0] in _DEEP and len(path.parts) > 2 else 1
    return "/".join(path.parts[:depth])


if __name__ == "__main__":
    print(table(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))["files"]))
