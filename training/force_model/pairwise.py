"""A sum over pairs, for comparison: what forces would be if wakes merely added up.

    f_i = f_env,type(i)(-z_i, -v_i) + sum over neighbours j of w_ij f_type(j)->type(i)(p_ij, v_ij)

Every f is a ReLU perceptron of the paper's depth and widths, phi's (6-25-40-40 or 4-25-40-40),
with one output, gram-force. Neural-Swarm2 compares with such a superposition (Sec. VII-C, Fig.
5); window, clamp and anchor are the deep set's.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from swarm_envs.training.force_model.network import Batch, DeepSet, ForceNetwork, perceptron
from swarm_envs.training.force_model.spec import DeepSetSpec


class PairwiseSum(ForceNetwork):
    """One perceptron per pair of types, one per type for the ground; see the module."""

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Make a network with torch's default initialisation.

        Args:
            spec: types, window, clamp, anchor and depth; `hidden` has no meaning here.
            dtype: float32 for training, float64 for checks.
        """
        super().__init__(spec, dtype)
        widths = (*spec.phi_widths[:-1], 1)
        self.pair = nn.ModuleDict({
            upper: nn.ModuleDict({lower: perceptron((6, *widths), dtype) for lower in spec.types})
            for upper in spec.types
        })  # fmt: skip
        self.environment = nn.ModuleDict(
            {name: perceptron((4, *widths), dtype) for name in spec.types}
        )

    def named_networks(self) -> dict[str, nn.Module]:
        """Return its perceptrons by the names that they have in a weights file."""
        types = self.spec.types
        pair = {f"pair.{a}.{b}": self.network_of(a, b) for a in types for b in types}
        return pair | {f"environment.{name}": self.environment[name] for name in types}

    def network_of(self, neighbor: str, ego: str) -> nn.Module:
        """Return the perceptron of the force that one type puts on another."""
        row = self.pair[neighbor]
        assert isinstance(row, nn.ModuleDict)
        return row[ego]

    def heads(self, batch: Batch) -> Tensor:
        """Vertical force of every row, (R, 1) gram-force."""
        environment, aloft = self.anchored(batch.environment)
        force = self._environment(batch.ego_type, environment) + self._pairs(batch)
        return force if aloft is None else force - self._environment(batch.ego_type, aloft)

    def _environment(self, ego_type: Tensor, environment: Tensor) -> Tensor:
        force = environment.new_zeros(len(environment), 1)
        for index, name in enumerate(self.spec.types):
            chosen = torch.nonzero(ego_type == index).squeeze(1)
            if len(chosen):
                value = self.environment[name](self.clamped(environment[chosen]))
                force = force.index_add(0, chosen, value)
        return force

    def _pairs(self, batch: Batch) -> Tensor:
        rows, slots = batch.pair_type.shape
        pair = batch.pair.reshape(rows * slots, 6)
        weight = self.window(pair)
        kind = torch.where(weight > 0, batch.pair_type.reshape(-1), -1)
        ego = batch.ego_type.repeat_interleave(slots)
        force = pair.new_zeros(rows, 1)
        for upper, above in enumerate(self.spec.types):
            for lower, below in enumerate(self.spec.types):
                chosen = torch.nonzero((kind == upper) & (ego == lower)).squeeze(1)
                if len(chosen):
                    inputs = pair[chosen].clamp(self.pair_low, self.pair_high)
                    value = self.network_of(above, below)(inputs) * weight[chosen, None]
                    force = force.index_add(0, chosen // slots, value)
        return force


def build(spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> ForceNetwork:
    """Make the network of a spec, with torch's default initialisation."""
    return PairwiseSum(spec, dtype) if spec.kind == "pairwise" else DeepSet(spec, dtype)
