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
def combine_wide(
    _typing: Any, out: Any, first: Any, first_rows: Any, second: Any, second_rows: Any
) -> Any:
    """``combine_wide(out, first, first_rows, second, second_rows)``: two sums of `combine` in one.

    For long rows: m is a multiple of 16.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target, weight, row, other_weight, other_row = (
            make_array(kind)(context, builder, arg) for kind, arg in _paired(signature, args)
        )
        _accumulate(builder, target, weight, row, lambda _: None, 2)
        _accumulate(
            builder,
            target,
            other_weight,
            other_row,
            lambda place: _load(builder, target.data, place),
            2,
        )
        return context.get_dummy_value()

    return types.void(out, first, first_rows, second, second_rows), generate


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


def _accumulate(
    builder: Any, out: Any, weights: Any, rows: Any, begin: Any, columns: int = 1
) -> None:
    """Emit the loops: over blocks of columns, within them over rows, four sums at a time."""
    (width,) = cgutils.unpack_tuple(builder, out.shape)
    (count,) = cgutils.unpack_tuple(builder, weights.shape)
    number, index = width.type, ir.IntType(32)
    undefined = ir.Constant(_vector(), ir.Undefined)
    first_lane = ir.Constant(ir.VectorType(index, LANES), [0] * LANES)
    zero = ir.Constant(_vector(), [0.0] * LANES)
    together = STRIDE // columns
    sums = [
        [cgutils.alloca_once(builder, _vector()) for _ in range(columns)] for _ in range(together)
    ]
    block = number(LANES * columns)
    with cgutils.for_range_slice(builder, number(0), width, block, number) as (first, _):
        places = [builder.add(first, number(LANES * c)) for c in range(columns)]
        for r in range(together):
            for c in range(columns):
                initial = begin(places[c]) if r == 0 else None
                builder.store(zero if initial is None else initial, sums[r][c])
        step = number(together)
        with cgutils.for_range_slice(builder, number(0), count, step, number) as (row, _):
            for r in range(together):
                here = builder.add(row, number(r))
                weight = builder.load(builder.gep(weights.data, [here], inbounds=True))
                wide = builder.shuffle_vector(
                    builder.insert_element(undefined, weight, index(0)), undefined, first_lane
                )
                start = builder.mul(here, width)
                for place, total in zip(places, sums[r], strict=True):
                    values = _load(builder, rows.data, builder.add(start, place))
                    product = builder.fmul(wide, values, flags=_FAST)
                    builder.store(builder.fadd(builder.load(total), product, flags=_FAST), total)
        for c, place in enumerate(places):
            parts = [builder.load(sums[r][c]) for r in range(together)]
            while len(parts) > 1:
                parts = [
                    builder.fadd(parts[r], parts[r + 1], flags=_FAST)
                    for r in range(0, len(parts), 2)
                ]
            pointer = builder.gep(out.data, [place], inbounds=True)
            builder.store(parts[0], builder.bitcast(pointer, _vector().as_pointer()), align=8)
