"""Import every module of the installed package; name those that need what was not asked for.

python every_module.py [PACKAGE ...]    packages that may be missing, by the name they import as
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from pathlib import Path

import swarm_envs

OPTIONAL = frozenset(sys.argv[1:])


def missing(name: str) -> str | None:
    """The optional package for want of which a module cannot be imported."""
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        absent = (error.name or "").partition(".")[0]
        if absent not in OPTIONAL:
            raise
        return absent
    except ImportError as error:  # our own words, which name the extra to install
        if not OPTIONAL or "pip install" not in str(error):
            raise
        return "its extra"
    return None


found = pkgutil.walk_packages(swarm_envs.__path__, "swarm_envs.", onerror=lambda name: None)
names = ["swarm_envs", *(module.name for module in found)]
needs = {name: missing(name) for name in names if name != "swarm_envs.__main__"}
if not (
    Path(swarm_envs.__file__).parents[1] / "pyproject.toml"
).exists():  # a checkout has these folders, and they refuse
    for bare in ("agents", "baselines", "training"):
        assert importlib.util.find_spec(bare) is None, f"{bare} is installed by its bare name"
print(f"{len(needs)} modules of {swarm_envs.__file__}")
for name, absent in needs.items():
    if absent:
        print(f"{name} needs {absent}")
