"""The closed-form wake for training; see `swarm_envs.interactions.wake`.

The vertical force on a drone, gram-force, downwash positive inside:

    pair_k = A (w0/w)^p exp(-(r/w)^2 / 2) s(dz / 0.03 m),    w = w0 + S max(dz, 0)
    f_z = G exp(-(z - 0.07 m)/h) - (1 - M exp(-z/hm)) (sum_k pair_k^q)^(1/q)

s is the logistic function, dz the height of neighbor k above the drone, and r the horizontal
distance from the wake's axis, which trails behind a moving neighbor: at depth dz it is shifted
by -v dz / U, where U is the advection speed of the neighbor's type. Pairs fade at the edge of the
interaction volume as in the learned model.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from swarm_envs.interactions.field import LOWEST_HEIGHT, ONSET
from swarm_envs.interactions.wake import FORMAT
from swarm_envs.training.force_model.network import Batch, DeepSetSpec, ForceNetwork

LIMITS = {  # number of type axes (the upper drone first), initial, lowest and highest value
    "amplitude_g": (2, 20.0, 0.0, 80.0),
    "width_m": (2, 0.05, 0.01, 0.2),
    "spread": (2, 0.05, 0.0, 0.5),
    "decay": (2, 1.5, 0.2, 3.0),
    "advection_speed": (1, 3.0, 0.3, 50.0),
    "ground_g": (1, 5.0, 0.0, 30.0),
    "ground_height_m": (1, 0.05, 0.01, 0.3),
    "combine_q": (0, 1.4, 1.0, 5.0),
    "mitigation": (0, 0.4, 0.0, 1.0),
    "mitigation_height_m": (0, 0.2, 0.02, 1.0),
}
"""Parameters by name: A, w0, S, p, U (m/s), G, h, q, M and hm, SI units but for gram-force."""
_TINY = 1e-15  # Keeps derivatives of powers finite at zero


class Wake(ForceNetwork):
    """The closed form, with parameters bounded by `LIMITS`."""

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Initialize the same parameters for all types."""
        super().__init__(spec, dtype)
        count, self.raw = len(spec.types), nn.ParameterDict()
        for name, (axes, start, low, high) in LIMITS.items():
            place = torch.tensor((start - low) / (high - low), dtype=dtype)
            self.raw[name] = nn.Parameter(torch.logit(place).repeat(count**axes))

    def value(self, name: str) -> Tensor:
        """Return a parameter, with the axes of types of `LIMITS`."""
        axes, _, low, high = LIMITS[name]
        inside = torch.sigmoid(self.raw[name])
        return (low + (high - low) * inside).reshape((len(self.types),) * axes)

    def named_networks(self) -> dict[str, nn.Module]:
        """Return an empty dictionary, as there is no perceptron."""
        return {}

    @torch.no_grad()
    def silence_drone(self, index: int) -> None:
        """Set the ground effect of a type to zero."""
        self.raw["ground_g"][index] = -torch.inf

    @torch.no_grad()
    def silence_pair(self, upper: int, lower: int) -> None:
        """Set the force of one type on another to zero."""
        self.raw["amplitude_g"][upper * len(self.types) + lower] = -torch.inf

    def heads(self, batch: Batch) -> Tensor:
        """Return the vertical force on every row, (R, 1), gram-force."""
        ego, q = batch.ego_type, self.value("combine_q")
        height = (-batch.environment[:, 0]).clamp(min=LOWEST_HEIGHT)
        together = self._pairs(batch)
        down = torch.where(together > 0.0, together.clamp(min=_TINY) ** (1.0 / q), 0.0)
        lost = self.value("mitigation") * torch.exp(-height / self.value("mitigation_height_m"))
        above = (height - LOWEST_HEIGHT) / self.value("ground_height_m")[ego]
        ground = self.value("ground_g")[ego] * torch.exp(-above)
        return (ground - down * (1.0 - lost))[:, None]

    def _pairs(self, batch: Batch) -> Tensor:
        """Return the sum of downwash^q over every row's neighbors, (R,)."""
        pair, weight, kind, row = self.slots(batch)
        near = torch.nonzero(kind >= 0).squeeze(1)
        pair, weight, upper, row = pair[near], weight[near], kind[near], row[near]
        lower, dz = batch.ego_type[row], pair[:, 2]
        depth = dz.clamp(min=0.0)
        wind = pair[:, 3:5] - batch.environment[row, 1:3]  # the neighbor's velocity, world frame
        lag = depth / self.value("advection_speed")[upper]
        axis = pair[:, :2] - wind * lag[:, None]
        start = self.value("width_m")[upper, lower]
        width = start + self.value("spread")[upper, lower] * depth
        shrink = (start / width) ** self.value("decay")[upper, lower]
        shape = torch.exp(-0.5 * (axis * axis).sum(dim=1) / width**2) * torch.sigmoid(dz / ONSET)
        push = self.value("amplitude_g")[upper, lower] * weight * shrink * shape
        power = push.clamp(min=_TINY) ** self.value("combine_q")
        return pair.new_zeros(len(batch.ego_type)).index_add(0, row, power)


@torch.no_grad()
def description(wake: Wake) -> dict[str, object]:
    """Return the content of a wake's file without provenance; `"L>S"` is a large above a small."""
    found = {name: wake.value(name).double().numpy().tolist() for name in LIMITS}
    names = list(wake.types)
    pair = {"A_g": "amplitude_g", "w0_m": "width_m", "S": "spread", "p": "decay"}
    return {
        "format": FORMAT,
        "types": names,
        "pair": {
            f"{upper}>{lower}": {key: found[name][i][j] for key, name in pair.items()}
            for i, upper in enumerate(names)
            for j, lower in enumerate(names)
        },
        "advection_speed": dict(zip(names, found["advection_speed"], strict=True)),
        "advection_velocity": "neighbor",
        "combine_q": found["combine_q"],
        "ground": {
            name: {"G_g": found["ground_g"][i], "h_m": found["ground_height_m"][i]}
            for i, name in enumerate(names)
        },
        "mitigation": {"M": found["mitigation"], "hm_m": found["mitigation_height_m"]},
        "drag": dict(zip(names, wake.drag.tolist(), strict=True)),
        "window": wake.spec.window._asdict(),
        "input_range": wake.spec.input_range and vars(wake.spec.input_range),
    }
