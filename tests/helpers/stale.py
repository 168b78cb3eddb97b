"""Lists what was computed from a force model that has changed since: `make stale`.

Weights, figures and tables of the documentation depend on the force models that ship, and some on
each other: the belief of the compensated controller is fitted to flights in `learned`, and figures
fly that belief. `made_from.json` keeps the hash that every source had when a product was made.
After you have made a product anew, `python -m tests.helpers.stale --made NAME` records it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import NamedTuple

from tests.helpers.imports import ROOT

RECORD = Path(__file__).with_name("made_from.json")
WEIGHTS = ROOT / "agents" / "weights"
LEARNED = "swarm_envs/interactions/weights/learned.safetensors"
LEARNED_V0 = "swarm_envs/interactions/weights/learned-v0.safetensors"
WAKE = "swarm_envs/interactions/weights/wake.json"
BELIEF = "baselines/neural_swarm/weights/belief.safetensors"
BELIEF_WAKE = "baselines/neural_swarm/weights/belief_wake.safetensors"
POLICIES = tuple(f"agents/weights/{p.name}" for p in sorted(WEIGHTS.glob("*.safetensors")))
_PAPER = "swarm-envs reproduce neural-swarm2"


class Product(NamedTuple):
    """Something in the repository that is computed from models."""

    files: tuple[str, ...]  # paths of what is computed, from the root
    sources: tuple[str, ...]  # paths of the models that it is computed from
    command: str  # what makes it


PRODUCTS = {
    "belief": Product((BELIEF,), (LEARNED,), "python -m swarm_envs.training.belief --out DIR"),
    "belief-wake": Product(
        (BELIEF_WAKE,),
        (WAKE,),
        "python -m swarm_envs.training.belief --out DIR --collection.interactions wake",
    ),
    "figure-1": Product(
        ("docs/reproduce/figure_1.png",), (LEARNED, BELIEF), f"{_PAPER} --figure 1 --out DIR"
    ),
    "figure-5": Product(
        (
            "docs/reproduce/figure_5.png",
            "docs/reproduce/superposition_gaps.png",
            "docs/reproduce/larger_swarms.png",
        ),
        (LEARNED,),
        f"{_PAPER} --figure 5 --out DIR",
    ),
    **{
        f"figure-{n}": Product(
            (f"docs/reproduce/figure_{n}.png",),
            (LEARNED, BELIEF),
            f"{_PAPER} --figure {n} --out DIR",
        )
        for n in (6, 7, 8, 9)
    },
    "limits": Product(
        tuple(f"docs/limits/{n}" for n in ("ball.png", "lag.png", "limits.csv", "limits.png")),
        (LEARNED, BELIEF),
        "python -m swarm_envs.training.reproduce.limits_study --out DIR, lag_study, ball_study",
    ),
    "curriculum": Product(
        ("docs/curriculum/learned.json", "docs/curriculum/learned.png"),
        (LEARNED,),
        "swarm-envs curriculum --out DIR",
    ),
    "demo": Product(("docs/demo.png",), (LEARNED, BELIEF), "make demo"),
    "hall": Product(
        ("docs/limits/hall.png",),
        (LEARNED, WAKE, BELIEF, BELIEF_WAKE),
        f"{_PAPER} --study hall --engine batch --out DIR, which has the tables of docs/hall.md too",
    ),
    "adaptation": Product(
        ("docs/generated/adaptation.md",),
        (LEARNED, WAKE, BELIEF),
        "python -m tests.benchmarks.adaptation > docs/generated/adaptation.md",
    ),
    "side-by-side": Product(
        ("docs/generated/side_by_side.md",),
        (LEARNED, WAKE, BELIEF, BELIEF_WAKE),
        "swarm-envs reproduce all --data ROWS --out DIR",
    ),
    "planning": Product(
        ("docs/planning.png",), (LEARNED,), "python tests/benchmarks/planning.py --picture FILE"
    ),
    "policies": Product(
        tuple(
            f"agents/weights/{n}.safetensors"
            for n in ("swap-ppo", "swap-ppo-8", "formation-ppo", "ring-ppo")
        ),
        (LEARNED_V0,),
        "the commands in agents/weights/MODEL_CARD.md",
    ),
    "imitation": Product(
        tuple(
            f"agents/weights/{n}.safetensors"
            for n in ("swap-dagger", "pursuit-dagger", "crowd-dagger")
        ),
        (LEARNED,),
        "the commands in agents/weights/MODEL_CARD.md",
    ),
    **{
        f"{task}-dagger": Product(
            (f"agents/weights/{task}-dagger.safetensors",),
            (LEARNED, BELIEF),
            "the command in agents/weights/MODEL_CARD.md",
        )
        for task in ("gates", "stack", "mixed", "sprint", "ring")
    },
    "delivery-dagger": Product(
        ("agents/weights/delivery-dagger.safetensors",),
        (LEARNED,),
        "the command in agents/weights/MODEL_CARD.md",
    ),
    "benchmark": Product(
        ("docs/benchmark.png", "docs/generated/benchmark.md", "agents/recommended.json"),
        (LEARNED, WAKE, BELIEF, *POLICIES),
        "swarm-envs benchmark --out DIR",
    ),
}
"""Every product by its name."""


def digests(sources: tuple[str, ...]) -> dict[str, str]:
    """SHA-256 of each source as it is now."""
    return {name: hashlib.sha256((ROOT / name).read_bytes()).hexdigest() for name in sources}


def stale() -> dict[str, list[str]]:
    """The sources that have changed since, by the name of each product that is stale.

    A product is stale, too, if one of its sources is a file of a stale product.
    """
    made: dict[str, dict[str, str]] = json.loads(RECORD.read_text())
    found: dict[str, list[str]] = {}
    old: set[str] = set()
    for name, product in PRODUCTS.items():
        now = digests(product.sources)
        changed = [s for s in now if made.get(name, {}).get(s) != now[s] or s in old]
        if changed:
            found[name] = changed
            old.update(product.files)
    return found


def record(names: list[str]) -> None:
    """Note that these products were made from the sources as they are now."""
    made = json.loads(RECORD.read_text()) if RECORD.is_file() else {}
    made.update({name: digests(PRODUCTS[name].sources) for name in names})
    ordered = {name: made[name] for name in PRODUCTS if name in made}
    RECORD.write_text(json.dumps(ordered, indent=1) + "\n")


def main() -> None:
    """Read the command line, and print a line for every product that is stale."""
    parser = argparse.ArgumentParser(description="what was computed from models that have changed")
    parser.add_argument("--made", nargs="+", choices=PRODUCTS, help="record that these are new")
    asked = parser.parse_args()
    if asked.made:
        record(asked.made)
    found = stale()
    for name, changed in found.items():
        print(f"{name}: made before {', '.join(changed)} changed; make it by: ", end="")
        print(PRODUCTS[name].command)
    print(f"{len(found)} of {len(PRODUCTS)} products are stale")


if __name__ == "__main__":
    main()
