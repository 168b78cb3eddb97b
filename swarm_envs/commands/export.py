"""`swarm-envs export`: a force model as a C header."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from swarm_envs.commands.checks import check_file


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Write a fitted force model as a C99 header for a microcontroller.

    It holds the weights as float32 and needs no library; see docs/forces.md.
    """

    out: Path
    """the header to write, such as learned.h"""
    model: str = "learned"
    """`learned`, or the path of weights that `swarm-envs fit` made"""
    name: str | None = None
    """prefix of everything that the header defines; by default the file's name"""
    seed: int = 0
    """the states of the header's self-test are drawn from it"""
    json: Path | None = None
    """write what the header holds to this file too"""

    def __post_init__(self) -> None:
        """Refuse a seed that no generator takes."""
        if self.seed < 0:
            raise ValueError(f"--seed is {self.seed}, but must be 0 or more")


def run(options: ExportOptions) -> None:
    """Write the header.

    Raises:
        Misuse: there is no such place to write.
        ValueError: there is no such model, or the name is none in C.
    """
    for option, file in (("--out", options.out), ("--json", options.json)):
        if file is not None:
            check_file(option, file)
    from swarm_envs.files import write_json, written_whole
    from swarm_envs.interactions import load
    from swarm_envs.interactions.c_header import c_header

    name = options.out.stem if options.name is None else options.name
    model = load(options.model)
    text = c_header(model, name, options.seed)
    with written_whole(options.out) as partial:
        partial.write_text(text, encoding="utf-8")
    facts = {"model": model.name, "types": list(model.types), "weights": model.field.weights.size}
    if options.json is not None:
        write_json(options.json, {"header": str(options.out), "name": name, **facts})
    print(f"wrote {options.out}: {name}_force_z(...), {facts['weights']} weights of {model.name!r}")
