"""One layer of a network on a block of samples, each sample a lane of a vector register.

Compiled from loops, the sums would lie in memory and go three times slower. So the product is
written here as vector instructions, which LLVM turns into those of the machine at hand.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

Numbers = npt.NDArray[np.floating[Any]]
"""Weights and scratch: float64, or float32 for speed."""

BLOCK_BYTES = 64
"""Size of a row of lanes: eight float64 or sixteen float32."""
TILES = (4, 1)
"""Numbers of outputs whose sums are in registers at once; the largest that fits is taken."""
WIDE_TILES = (8, *TILES)
"""The same where a register holds a whole row of lanes. In half of one, eight do not fit."""


def affine(
    weights: Numbers, start: int, inputs: int, outputs: int, x: Numbers, y: Numbers, lowest: float
) -> None:
    """Write max(W x + b, lowest) into `y` in every lane; W and b lie at `start` of the weights.

    What a lane gives does not depend on which lane it is, nor on what lies in the others. This body
    runs where nothing is compiled; elsewhere `_write_affine` says what runs.

    Args:
        weights: flat; the transposed matrix (inputs, outputs), then the bias.
        start: where this layer begins in them.
        inputs: number of inputs.
        outputs: number of outputs.
        x: (at least inputs, lanes).
        y: (at least outputs, lanes), overwritten.
        lowest: 0 for a ReLU, minus infinity for none.
    """
    bias = start + inputs * outputs
    matrix = weights[start:bias].reshape(inputs, outputs)
    product = matrix.T @ x[:inputs] + weights[bias : bias + outputs, None]
    y[:outputs] = np.maximum(product, lowest)


@overload(affine)  # type: ignore[untyped-decorator]
def _compiled_affine(
    weights: Any, start: Any, inputs: Any, outputs: Any, x: Any, y: Any, lowest: Any
) -> Any:
    def call(
        weights: Any, start: Any, inputs: Any, outputs: Any, x: Any, y: Any, lowest: Any
    ) -> None:
        _affine(weights, start, inputs, outputs, x, y, lowest)

    return call


@intrinsic  # type: ignore[untyped-decorator]
def _affine(
    typing: Any, weights: Any, start: Any, inputs: Any, outputs: Any, x: Any, y: Any, lowest: Any
) -> Any:
    counts = (types.intp, types.intp, types.intp)
    return types.void(weights, *counts, x, y, weights.dtype), _write_affine


def _write_affine(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write the instructions of `affine`: tiles of outputs, the large ones first."""
    data = [
        context.make_array(signature.args[k])(context, builder, arguments[k]).data
        for k in (0, 4, 5)
    ]
    _, start, inputs, outputs, _, _, lowest = arguments
    layer = _Layer(builder, lowest.type, data, start, inputs, outputs)
    floor, done = layer.spread(lowest), ir.Constant(outputs.type, 0)
    features = context.codegen().magic_tuple()[2]
    for tile in WIDE_TILES if "+avx512f" in features else TILES:
        count = builder.sdiv(builder.sub(outputs, done), ir.Constant(outputs.type, tile))
        with cgutils.for_range(builder, count) as loop:
            first = builder.add(done, builder.mul(loop.index, ir.Constant(outputs.type, tile)))
            layer.write_tile(first, tile, floor)
        done = builder.add(done, builder.mul(count, ir.Constant(outputs.type, tile)))
    return context.get_dummy_value()


class _Layer:
    """Writes the instructions of one layer's tiles; pointers and counts are LLVM values."""

    def __init__(
        self,
        builder: Any,
        number: Any,
        data: list[Any],
        start: Any,
        inputs: Any,
        outputs: Any,
    ) -> None:
        weights, source, target = data
        self.bytes = 8 if isinstance(number, ir.DoubleType) else 4
        self.vector = ir.VectorType(number, BLOCK_BYTES // self.bytes)
        self.builder, self.inputs, self.outputs = builder, inputs, outputs
        self.source = builder.bitcast(source, self.vector.as_pointer())
        self.target = builder.bitcast(target, self.vector.as_pointer())
        self.matrix = builder.gep(weights, [start])
        self.bias = builder.gep(self.matrix, [builder.mul(inputs, outputs)])
        name = f"llvm.fmuladd.v{self.vector.count}f{8 * self.bytes}"
        fused = ir.FunctionType(self.vector, [self.vector] * 3)
        self.fused = cgutils.get_or_insert_function(builder.module, fused, name)

    def spread(self, number: Any) -> Any:
        """The number in every lane."""
        nothing = ir.Constant(self.vector, ir.Undefined)
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), self.vector.count), None)
        one = self.builder.insert_element(nothing, number, ir.IntType(32)(0))
        return self.builder.shuffle_vector(one, nothing, zeros)

    def write_tile(self, first: Any, tile: int, floor: Any) -> None:
        """Sum over all inputs for `tile` outputs from `first` on, and store what is above floor."""
        builder = self.builder
        sums = [cgutils.alloca_once(builder, self.vector) for _ in range(tile)]
        for total, bias in zip(sums, self._weights(self.bias, first, tile)):
            builder.store(bias, total)
        with cgutils.for_range(builder, self.inputs) as loop:
            x = builder.load(builder.gep(self.source, [loop.index]), align=self.bytes)
            row = builder.add(builder.mul(loop.index, self.outputs), first)
            for total, weight in zip(sums, self._weights(self.matrix, row, tile)):
                builder.store(builder.call(self.fused, [weight, x, builder.load(total)]), total)
        for k, total in enumerate(map(builder.load, sums)):
            below = builder.fcmp_ordered("<", total, floor)  # not so of NaN, which stays
            place = builder.gep(self.target, [builder.add(first, ir.Constant(first.type, k))])
            builder.store(builder.select(below, floor, total), place, align=self.bytes)

    def _weights(self, array: Any, first: Any, count: int) -> list[Any]:
        """So many numbers of an array, each in every lane."""
        places = [self.builder.add(first, ir.Constant(first.type, k)) for k in range(count)]
        return [self.spread(self.builder.load(self.builder.gep(array, [p]))) for p in places]
