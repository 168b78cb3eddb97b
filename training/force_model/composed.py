"""The composed model for training, which combines forces of pairs; see `interactions.composed`.

    push_ij = w_ij max(0, wake_ij + n_ij(r, dz, v_r, v_t, v_dz))
    f_z = g_i(-z, |v_xy|, -v_z) - (1 - M exp(-z/h)) (sum_j push_ij^q)^(1/q)

The closed form `wake_ij` and the network n_ij, which corrects it, are fitted together with the
delay of the wakes, q, M and h. A second output of n_ij, from the same hidden units, is the
inclination of the force toward the axis of the wake. It is fitted to the horizontal labels, with
detached gradients, so that it does not change the vertical fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from swarm_envs.interactions.composed import AXIS_RADIUS
from swarm_envs.interactions.field import LOWEST_HEIGHT, ONSET, UNITS_OF_OWN, UNITS_OF_PAIR
from swarm_envs.training.force_model.network import (
    Batch,
    DeepSet,
    DeepSetSpec,
    ForceNetwork,
    NetworkKind,
    fade,
    layers,
    of_types,
    perceptron,
    silence,
)
from swarm_envs.training.force_model.wake import Wake

HIGHEST_DECAY = 3.0
"""Upper bound of the exponent p of a wake, which is not identifiable without one."""
_PAIR_WIDTHS = (len(UNITS_OF_PAIR), 32, 32, 2)
_OWN_WIDTHS = (len(UNITS_OF_OWN), 16, 16, 1)
_START = {"amplitude": 20.0, "width": 0.06, "spread": 0.03}  # g, m, 1
_TINY = 1e-12  # Keeps derivatives of roots and powers finite at zero


class Composed(ForceNetwork):
    """A wake and a network for each pair of types, a network for lone drones, and q, M and h."""

    def __init__(self, spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> None:
        """Initialize the same wake for every pair, and networks with small corrections."""
        super().__init__(spec, dtype)
        count = len(spec.types)
        names = [f"{a}>{b}" for a in spec.types for b in spec.types]
        self.pair = nn.ModuleList([perceptron(_PAIR_WIDTHS, dtype) for _ in names])
        self.own = nn.ModuleList([perceptron(_OWN_WIDTHS, dtype) for _ in spec.types])
        with torch.no_grad():
            for network in self.pair:
                last = layers(network)[-1]
                last.weight.mul_(0.1)
                last.bias.zero_()
        start = torch.tensor([_START[k] for k in ("amplitude", "width", "spread")], dtype=dtype)
        wake = torch.cat([start.log(), torch.zeros(1, dtype=dtype)])
        self.wakes = nn.ParameterList([nn.Parameter(wake.clone()) for _ in names])
        self.delays = nn.Parameter(torch.full((count,), 0.2, dtype=dtype).log())
        self.joining = nn.Parameter(torch.tensor([0.2, 0.05, 0.05], dtype=dtype).log())

    def wake(self, upper: int, lower: int) -> Tensor:
        """Return the parameters of a pair's wake: A (g), w0 (m), S, p."""
        raw = self.wakes[upper * len(self.types) + lower]
        return torch.cat([raw[:3].exp(), HIGHEST_DECAY * torch.sigmoid(raw[3:])])

    def delay(self) -> Tensor:
        """Return the delay of the wake of each type per depth, (T,), s/m."""
        return self.delays.exp()

    def joined_by(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the exponent q, the fraction M of downwash lost at the ground, and h, m."""
        q, kept, height = self.joining.exp()
        return 1.0 + q, 1.0 / (1.0 + kept), height

    def wake_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a weights file besides networks and drag, by name."""
        count, names = len(self.types), self.types
        pairs = [(i, j) for i in range(count) for j in range(count)]
        found = {f"wake.{names[i]}.{names[j]}": self.wake(i, j) for i, j in pairs}
        found |= {f"delay.{names[i]}": self.delay()[i : i + 1] for i in range(count)}
        return found | {"joining": torch.stack(self.joined_by())}

    def set_wake_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        """Set the parameters from the tensors of `wake_tensors`."""
        for k, raw in enumerate(self.wakes):
            upper, lower = (self.types[n] for n in divmod(k, len(self.types)))
            wake = tensors[f"wake.{upper}.{lower}"]
            raw.copy_(torch.cat([wake[:3].log(), torch.logit(wake[3:] / HIGHEST_DECAY)]))
        self.delays.copy_(torch.cat([tensors[f"delay.{name}"] for name in self.types]).log())
        q, lost, height = tensors["joining"]
        self.joining.copy_(torch.stack([q - 1.0, 1.0 / lost - 1.0, height]).log())

    def silence_drone(self, index: int) -> None:
        """Set the output of the network of a lone type to zero."""
        silence(self.own[index])

    @torch.no_grad()
    def silence_pair(self, upper: int, lower: int) -> None:
        """Set the force of one type on another to zero."""
        place = upper * len(self.types) + lower
        silence(self.pair[place])
        self.wakes[place][0] = -torch.inf

    def named_networks(self) -> dict[str, nn.Module]:
        """Return the perceptrons by their names in a weights file."""
        names = [f"pair.{a}.{b}" for a in self.types for b in self.types]
        own = [f"environment.{name}" for name in self.types]
        return dict(zip(names + own, [*self.pair, *self.own], strict=True))

    def heads(self, batch: Batch) -> Tensor:
        """Return the force on every row, (R, 3) gram-force: vertical, then in x and y."""
        q, lost, height = self.joined_by()
        powers, pairs = self._pairs(batch, q)
        some = powers > 0.0
        together = torch.where(some, powers.clamp(min=_TINY**2) ** (1.0 / q), 0.0)
        z = (-batch.environment[:, 0]).clamp(min=LOWEST_HEIGHT)
        down = together * (1.0 - lost * torch.exp(-z / height))
        sideways = pairs[:, :2] * (down / pairs[:, 2].clamp(min=_TINY**2)).detach()[:, None]
        return torch.cat([(self._alone(batch) - down)[:, None], sideways], dim=1)

    def _alone(self, batch: Batch) -> Tensor:
        environment, aloft = self.anchored(batch.environment)
        force = self._own(batch.ego_type, environment)
        return force if aloft is None else force - self._own(batch.ego_type, aloft)

    def _own(self, ego_type: Tensor, environment: Tensor) -> Tensor:
        known = self.clamped(environment)
        speed = _length(environment[:, 1:3]).clamp(max=float(self.environment_high[1]))
        inputs = torch.stack([known[:, 0], speed, known[:, 3]], dim=1)
        inputs = inputs / inputs.new_tensor(UNITS_OF_OWN)
        force = inputs.new_zeros(len(inputs))
        for index, chosen in of_types(ego_type, len(self.types)):
            force = force.index_add(0, chosen, self.own[index](inputs[chosen])[:, 0])
        return force

    def window(self, pair: Tensor) -> Tensor:
        """Return the weights w of pairs (..., 6) by horizontal distance and depth."""
        lateral, vertical = self.spec.window
        weight = fade(_length(pair[..., :2]), *lateral) * fade(pair[..., 2].abs(), *vertical)
        return weight.clamp(min=0.0)  # rounding at the edge

    def _pairs(self, batch: Batch, q: Tensor) -> tuple[Tensor, Tensor]:
        """Return sums over each row's neighbors: of push^q (R,), and of x, y, down (R, 3)."""
        pair, weight, kind, row = self.slots(batch)
        rows, count = len(batch.ego_type), len(self.types)
        powers, sums = pair.new_zeros(rows), pair.new_zeros(rows, 3)
        for index, chosen in self.pair_kinds(batch, kind, row):
            at = row[chosen]
            wind = pair[chosen, 3:5] - batch.environment[at, 1:3]
            push, lean = self._push(*divmod(index, count), pair[chosen], wind, weight[chosen])
            powers = powers.index_add(0, at, push.clamp(min=_TINY) ** q)
            vector = torch.cat([push.detach()[:, None] * lean, push[:, None]], dim=1)
            sums = sums.index_add(0, at, vector)
        return powers, sums

    def _push(
        self, upper: int, lower: int, pair: Tensor, wind: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return push (P,) and inclination (P, 2) of pairs; `wind` is the upper's velocity."""
        inputs, towards = self.turned(pair, wind, self.delay()[upper])
        network = self.pair[upper * len(self.types) + lower]
        assert isinstance(network, nn.Sequential)
        hidden = network[:-1](inputs / inputs.new_tensor(UNITS_OF_PAIR))
        last = layers(network)[-1]
        correction = nn.functional.linear(hidden, last.weight[:1], last.bias[:1])[:, 0]
        lean = nn.functional.linear(hidden.detach(), last.weight[1:], last.bias[1:])
        push = torch.relu(self._wake_of(upper, lower, inputs) + correction) * weight
        return push, lean.clamp(-1.0, 1.0) * towards.detach()

    def _wake_of(self, upper: int, lower: int, inputs: Tensor) -> Tensor:
        amplitude, start, spread, decay = self.wake(upper, lower)
        r, dz = inputs[:, 0], inputs[:, 1]
        width = start + spread * dz.clamp(min=0.0)
        shape = torch.exp(-0.5 * (r / width) ** 2) * torch.sigmoid(dz / ONSET)
        return amplitude * (start / width) ** decay * shape

    def turned(self, pair: Tensor, wind: Tensor, delay: Tensor) -> tuple[Tensor, Tensor]:
        """Return inputs of a pair's network (P, 5), SI, and the direction to the axis (P, 2)."""
        known = pair.clamp(self.pair_low, self.pair_high)
        axis = pair[:, :2] - wind * (pair[:, 2:3].clamp(min=0.0) * delay)
        velocity, fastest = pair[:, 3:5], float(self.pair_high[3])
        square = (axis * axis).sum(dim=1)
        towards = axis / torch.sqrt(square + AXIS_RADIUS**2)[:, None]
        radial = (towards * velocity).sum(dim=1)
        rest = (velocity * velocity).sum(dim=1) - radial * radial
        farthest = float(torch.linalg.vector_norm(self.pair_high[:2]))
        inputs = [
            _root(square).clamp(max=farthest),
            known[:, 2],
            radial.clamp(-fastest, fastest),
            _root(rest).clamp(max=fastest),
            known[:, 5],
        ]
        return torch.stack(inputs, dim=1), towards


def _length(vector: Tensor) -> Tensor:
    """Return the lengths of vectors (..., 2)."""
    return _root((vector * vector).sum(dim=-1))


def _root(square: Tensor) -> Tensor:
    """Return the square root, with a finite derivative at zero."""
    return torch.sqrt(square.clamp(min=_TINY**2))


def build(spec: DeepSetSpec, dtype: torch.dtype = torch.float32) -> ForceNetwork:
    """Return the network of a spec with initial weights."""
    kinds: dict[NetworkKind, Callable[[DeepSetSpec, torch.dtype], ForceNetwork]]
    kinds = {"deep-set": DeepSet, "composed": Composed, "wake": Wake}
    return kinds[spec.kind](spec, dtype)
