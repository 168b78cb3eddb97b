"""Write the tables of docs/papers.md: `python -m examples.papers runs/papers`."""

from pathlib import Path
from typing import Annotated

import tyro

from examples.papers.page import write_pages


def main(runs: Annotated[Path | None, tyro.conf.Positional] = None) -> None:
    """Keep what the JSON files below a folder compare, and write the tables."""
    write_pages(runs)


if __name__ == "__main__":
    tyro.cli(main)
