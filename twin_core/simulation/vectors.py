"""Small products on vector registers, for compiled code.

numba's own loops over a dozen numbers spend more time on finding out whether their arrays overlap
than on the numbers.
"""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

LANES = 8
"""Rows given to these functions have a multiple of this many columns."""
STRIDE = 4
"""The number of rows is a multiple of this."""

_FAST = ("contract", "reassoc", "nsz")


@intrinsic
def combine(_typing: Any, out: Any, weights: Any, rows: Any) -> Any:
    """``combine(out, weights, rows)``: out (m,) becomes the sum of weights[q] rows[q].

    weights (n,) and rows (n, m) are contiguous float64; n and m are multiples of 4 and 8. Nothing
    is checked, and out must not overlap the others.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target, weight, row = (
            make_array(kind)(context, builder, arg) for kind, arg in _paired(signature, args)
        )
        _accumulate(builder, target, weight, row, lambda _: None)
        return context.get_dummy_value()

    return types.void(out, weights, rows), generate


@intrinsic
def advance(_typing: Any, out: Any, factor: Any, start: Any, weights: Any, rows: Any) -> Any:
    """``advance(out, factor, start, weights, rows)``: as `combine`, plus factor * start (m,).

    Here out may be start.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target, scale, old, weight, row = (
            make_array(kind)(context, builder, arg) for kind, arg in _paired(signature, args)
        )

        def begin(column: Any) -> Any:
            scaled = _load(builder, scale.data, column)
            return builder.fmul(scaled, _load(builder, old.data, column), flags=_FAST)

        _accumulate(builder, target, weight, row, begin)
        return context.get_dummy_value()

    return types.void(out, factor, start, weights, rows), generate


def _paired(signature: Any, args: Any) -> Any:
    return zip(signature.args, args, strict=True)


def _vector() -> Any:
    return ir.VectorType(ir.DoubleType(), LANES)


def _load(builder: Any, base: Any, offset: Any) -> Any:
    pointer = builder.gep(base, [offset], inbounds=True)
    return builder.load(builder.bitcast(pointer, _vector().as_pointer()), align=8)


def _accumulate(builder: Any, out: Any, weights: Any, rows: Any, begin: Any) -> None:
    """Emit the loops: over blocks of columns, within them over rows, four sums at a time."""
    (width,) = cgutils.unpack_tuple(builder, out.shape)
    (count,) = cgutils.unpack_tuple(builder, weights.shape)
    number, index = width.type, ir.IntType(32)
    undefined = ir.Constant(_vector(), ir.Undefined)
    first_lane = ir.Constant(ir.VectorType(index, LANES), [0] * LANES)
    zero = ir.Constant(_vector(), [0.0] * LANES)
    sums = [cgutils.alloca_once(builder, _vector()) for _ in range(STRIDE)]
    with cgutils.for_range_slice(builder, number(0), width, number(LANES), number) as (column, _):
        initial = begin(column)
        for place, total in enumerate(sums):
            builder.store(zero if place or initial is None else initial, total)
        with cgutils.for_range_slice(builder, number(0), count, number(STRIDE), number) as (row, _):
            for place, total in enumerate(sums):
                here = builder.add(row, number(place))
                weight = builder.load(builder.gep(weights.data, [here], inbounds=True))
                spread = builder.shuffle_vector(
                    builder.insert_element(undefined, weight, index(0)), undefined, first_lane
                )
                values = _load(builder, rows.data, builder.add(builder.mul(here, width), column))
                product = builder.fmul(spread, values, flags=_FAST)
                builder.store(builder.fadd(builder.load(total), product, flags=_FAST), total)
        parts = [builder.load(total) for total in sums]
        low = builder.fadd(parts[0], parts[1], flags=_FAST)
        high = builder.fadd(parts[2], parts[3], flags=_FAST)
        pointer = builder.gep(out.data, [column], inbounds=True)
        builder.store(
            builder.fadd(low, high, flags=_FAST),
            builder.bitcast(pointer, _vector().as_pointer()),
            align=8,
        )
