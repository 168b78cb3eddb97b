"""Options of `swarm-envs reproduce all`, and what it does with them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from swarm_envs import __version__
from swarm_envs.errors import check_integer
from swarm_envs.files import claimed, write_json, written_whole
from swarm_envs.training.reproduce.everything.item import Preset
from swarm_envs.training.reproduce.everything.page import markdown, page, results
from swarm_envs.training.reproduce.everything.registry import ITEMS, choose, listing
from swarm_envs.training.reproduce.everything.runner import (
    Execute,
    Job,
    Outcome,
    run_all,
    standing,
)

SETTINGS = "settings.json"
"""What all items of a folder share."""


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Remake every table and figure of the three papers, and set ours beside the papers' values.

    Writes a folder for each item, `index.html` (all of it on one page, self-contained),
    `side_by_side.md` and `results.json`. Killed and called again it goes on where it was; an item
    that fails is named on the page, stops no other, and is tried again the next time.
    """

    out: Path = Path("reproduce-all")
    """folder, made if missing"""
    quick: bool = False
    """few runs of small cases: minutes instead of hours"""
    items: tuple[str, ...] = ()
    """items to remake, such as neural-swarm2/table-3; all if none are named"""
    list: bool = False
    """list the items and end"""
    data: Path | None = None
    """rows of measured force for Table III, as `swarm-envs fit` reads them; collected in simulation
    if not given"""
    seed: int = 0
    """of every command"""
    json: Path | None = None
    """write the results to this file too"""

    def __post_init__(self) -> None:
        """Refuse what cannot be done.

        Raises:
            ValueError: an unknown item, or a negative seed.
            FileNotFoundError: there are no such rows.
        """
        choose(self.items)
        check_integer("seed", self.seed, 0)
        if self.data is not None and not self.data.exists():
            raise FileNotFoundError(
                f"no file of rows at {str(self.data)!r}; give its path by --data"
            )

    @property
    def preset(self) -> Preset:
        """How much is run."""
        return "quick" if self.quick else "full"


def run(options: ReproduceOptions, execute: Execute) -> tuple[str, bool]:
    """Remake what was asked for.

    Args:
        options: what was asked for.
        execute: runs the words of a `swarm-envs` command.

    Returns:
        What to print, and whether everything that was asked for was remade.

    Raises:
        ValueError: the folder holds a run of other settings.
        BlockingIOError: another process writes into it.
        OSError: it cannot be written.
    """
    if options.list:
        return listing(), True
    wanted = choose(options.items)
    job = Job(options.out, options.preset, options.data, execute, options.seed)
    with claimed(options.out):
        _check_settings(options)
        others = {key: standing(job, item) for key, item in ITEMS.items()}
        found = run_all(job, wanted, lambda some: _write(options, {**others, **some}))
        everything = {**others, **found}
        _write(options, everything)
    failed = [outcome for outcome in found.values() if outcome.state == "failed"]
    lines = [f"failed: {outcome.item.key}: {outcome.error}" for outcome in failed]
    spent = sum(outcome.cpu_s for outcome in everything.values())
    lines.append(f"{spent / 60:.1f} minutes of CPU time")
    lines.append(f"wrote {options.out / 'index.html'}, side_by_side.md and results.json")
    return "\n".join(lines), not failed


def _settings(options: ReproduceOptions) -> dict[str, object]:
    return {
        "preset": options.preset,
        "seed": options.seed,
        "data": None if options.data is None else str(options.data.resolve()),
        "version": __version__,
    }


def _check_settings(options: ReproduceOptions) -> None:
    """Write what all items share, or compare it with what stands there."""
    path, wanted = options.out / SETTINGS, _settings(options)
    if not path.is_file():
        write_json(path, wanted)
        return
    try:
        made = dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{str(path)!r} is damaged ({error}); delete it") from error
    differing = [name for name in wanted if made.get(name) != wanted[name]]
    if differing:
        was = ", ".join(f"{name} {made.get(name)!r}" for name in differing)
        raise ValueError(
            f"{str(options.out)!r} was begun with {was}; go on with that, or choose another folder "
            "by --out"
        )


def _write(options: ReproduceOptions, outcomes: Mapping[str, Outcome]) -> None:
    """The page, the table and the results of what there is by now."""
    listed = list(outcomes.values())
    content = results(listed, _settings(options))
    write_json(options.out / "results.json", content)
    if options.json is not None:
        write_json(options.json, content)
    texts = {
        "index.html": page(listed, _about(options), options.out),
        "side_by_side.md": markdown(listed, _about(options)),
    }
    for name, text in texts.items():
        with written_whole(options.out / name) as partial:
            partial.write_text(text, encoding="utf-8")


def _about(options: ReproduceOptions) -> tuple[str, ...]:
    quick = " --quick" if options.quick else ""
    how = (
        "Few runs of small cases (`--quick`): without it there are the papers' sizes and counts."
        if options.quick
        else "Sizes and counts as in the papers, where the text gives them."
    )
    return (
        f"Every table and figure of three papers, remade by `swarm-envs reproduce all{quick}` "
        f"(swarm-envs {__version__}). {how}",
        "Each number has a range that counts as the paper's. What lies "
        "outside is explained only if a known reason covers it, in its direction and so far; else "
        "it stands as unexplained.",
    )
