"""`swarm-envs collect`: collect flight logs in simulation."""

from __future__ import annotations

from swarm_envs.commands.checks import check_inputs, check_outputs
from swarm_envs.files import claimed
from swarm_envs.training.collection import __main__ as collection
from swarm_envs.training.collection.__main__ import CollectOptions


def run_collect(options: CollectOptions) -> None:
    """Check the options, and collect, write and print."""
    check_outputs(options.out, options.json)
    check_inputs(options.config)
    with claimed(options.out):
        collection.run_collect(options)
