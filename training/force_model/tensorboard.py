"""The history of a fit for TensorBoard, if it is wanted and installed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def scalar_writer(folder: Path | None) -> Iterator[Callable[[Mapping[str, float]], None] | None]:
    """Open a folder of event files; gives a function that writes one entry of a history.

    Args:
        folder: where TensorBoard will look (`tensorboard --logdir FOLDER`); None writes nothing
            and gives None.

    Raises:
        ImportError: the package tensorboard is not installed.
    """
    if folder is None:
        yield None
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ImportError(
            "event files need the package tensorboard, which is not installed; install it by "
            "`pip install 'swarm-envs[tensorboard]'`, or leave --tensorboard out"
        ) from error
    writer = SummaryWriter(str(folder))

    def write(entry: Mapping[str, float]) -> None:
        for name, value in entry.items():
            if name != "step":
                writer.add_scalar(name, value, int(entry["step"]))

    try:
        yield write
    finally:
        writer.close()
