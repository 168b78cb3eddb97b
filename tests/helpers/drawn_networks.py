"""Networks with weights that are drawn, for files of force models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from swarm_envs.state import FloatArray


def drawn(networks: Mapping[str, Sequence[int]], rng: np.random.Generator) -> dict[str, FloatArray]:
    """Tensors `name.layer.weight` and `name.layer.bias` of networks, given by their widths."""
    tensors = {}
    for name, widths in networks.items():
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            tensors[f"{name}.{k}.weight"] = rng.normal(size=(outputs, inputs))
            tensors[f"{name}.{k}.bias"] = rng.normal(size=outputs)
    return tensors
