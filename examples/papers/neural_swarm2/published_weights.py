"""The authors' force model, from the weights in a clone of crazyswarm2 (MIT) or neural-swarm.

git clone https://github.com/IMRCLab/crazyswarm2
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from examples.papers.common import Array
from swarm_envs.vehicles import GRAM_FORCE, parse_team

FOLDERS = (
    "crazyflie_sim/crazyflie_sim/backend/data/neuralswarm2",
    "data/models/models/output",
)  # in clones of crazyswarm2 and neural-swarm, whose files are the same
NETWORKS = ("phi_G", "phi_S", "phi_L", "rho_S", "rho_L")


class PublishedWeights:
    """Eq. (10) with the published weights: every other drone is a neighbor, however far.

    Raises:
        FileNotFoundError: the folder has no weights; the message says which clones have.
    """

    def __init__(self, clone: Path) -> None:
        found = [clone / folder for folder in FOLDERS if (clone / folder / "phi_G.pth").is_file()]
        if not found:
            raise FileNotFoundError(
                f"no {FOLDERS[0]}/phi_G.pth in {clone}; clone https://github.com/IMRCLab/crazyswarm2"
            )
        self.name = "published weights"
        self._networks = {name: read_network(found[0] / f"{name}.pth") for name in NETWORKS}

    def forces(self, position: Array, velocity: Array, team: str) -> Array:
        """Return forces (R, N, 3), N, on a team at positions and velocities (R, N, 3)."""
        kinds = ["L" if vehicle.token == "L" else "S" for vehicle in parse_team(team)]
        motion, found = np.concatenate([position, velocity], axis=-1), np.zeros_like(position)
        for i, own in enumerate(kinds):
            code = self._networks["phi_G"](-motion[:, i, 2:])
            for j, other in enumerate(kinds):
                if j != i:
                    code = code + self._networks[f"phi_{other}"](motion[:, j] - motion[:, i])
            found[:, i, 2] = GRAM_FORCE * self._networks[f"rho_{own}"](code)[:, 0]
        return found


def read_network(path: Path) -> Callable[[Array], Array]:
    """Return a ReLU network of four layers, which takes and gives rows."""
    import torch

    # The authors publish nothing but pickled weights; `weights_only` unpickles no code.
    state = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    layers = [
        [state[f"fc{k}.{p}"].detach().double().numpy() for p in ("weight", "bias")]
        for k in range(1, 5)
    ]

    def network(rows: Array) -> Array:
        for weight, bias in layers[:-1]:
            rows = np.maximum(rows @ weight.T + bias, 0.0)
        return np.asarray(rows @ layers[-1][0].T + layers[-1][1])

    return network
