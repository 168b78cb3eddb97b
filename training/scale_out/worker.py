"""A process that does jobs for another: requests come in by lines, answers go out by lines.

Started by `local`. It ends when its standard input does, which the death of its parent brings
about, in the middle of a job too.
"""

from __future__ import annotations

import os
import sys
from queue import SimpleQueue
from threading import Thread
from typing import TextIO

from swarm_envs.training.scale_out.jobs import answer


def main() -> None:
    """Answer until the standard input ends. What jobs print goes to the standard error."""
    requests, answers = _take_streams()
    lines: SimpleQueue[str] = SimpleQueue()
    Thread(target=_listen, args=(requests, lines), daemon=True).start()
    while True:
        answers.write(answer(lines.get()) + "\n")
        answers.flush()


def _take_streams() -> tuple[TextIO, TextIO]:
    """Keep standard input and output for jobs' lines; others find nothing there, or the error."""
    requests = os.fdopen(os.dup(0), encoding="ascii")
    answers = os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return requests, answers


def _listen(requests: TextIO, lines: SimpleQueue[str]) -> None:
    for line in requests:
        lines.put(line)
    sys.stderr.flush()
    os._exit(0)  # the parent is gone, and nobody wants what is being done


if __name__ == "__main__":
    main()
