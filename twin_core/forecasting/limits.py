"""Paths compared with limits: one path or many, with any number of leading axes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


class LimitCheck(NamedTuple):
    """Paths of some names compared with the levels of their limits; NaN where a path is not known.

    `highest_c`, `highest_s` (..., names): highest temperature of a path and when it has it.
    `margin_k` (..., names, levels): limit minus highest temperature, negative where it is exceeded,
    infinite where there is no limit. `time_s` (..., names, levels): when the path first reaches the
    limit, interpolated between rows; infinite if it does not.
    """

    highest_c: FloatArray
    highest_s: FloatArray
    margin_k: FloatArray
    time_s: FloatArray

    def near(self, band_k: ArrayLike) -> NDArray[np.bool_]:
        """Whether a limit is nearer than a band in K, (...); also where the path is not known.

        `band_k` has any shape that goes with (..., names, levels).
        """
        clear = (self.margin_k > np.asarray(band_k)) | (self.margin_k == np.inf)
        return np.asarray(~clear.all(axis=(-2, -1)))


def check_limits(time_s: ArrayLike, paths_c: ArrayLike, limits_c: ArrayLike) -> LimitCheck:
    """Compare paths with limits: how near they come, and when they reach them.

    `time_s` (n,) times of the rows, or (..., n) each path's own. `paths_c` (..., n, names) in degC.
    Rows behind the end of a path are NaN; a path that is NaN in its first row is not known;
    `limits_c` (names, levels) or (..., names, levels) in degC; infinite where there is none.
    """
    paths = np.moveaxis(np.asarray(paths_c, np.float64), -2, -1)
    times = np.broadcast_to(np.asarray(time_s, np.float64)[..., np.newaxis, :], paths.shape)
    limits = np.asarray(limits_c, np.float64)
    lost = np.isnan(paths[..., :1])
    highest = np.argmax(np.where(np.isnan(paths), -np.inf, paths), axis=-1, keepdims=True)
    highest_c = np.take_along_axis(paths, highest, axis=-1)
    highest_s = np.where(lost, np.nan, np.take_along_axis(times, highest, axis=-1))
    crossing_s = first_crossings(times[..., np.newaxis, :], paths[..., np.newaxis, :], limits)
    none = np.isposinf(limits)
    margin_k = np.where(none, np.inf, limits - highest_c)
    return LimitCheck(
        highest_c[..., 0],
        highest_s[..., 0],
        margin_k,
        np.where(lost & ~none, np.nan, crossing_s),
    )


def first_crossings(time_s: ArrayLike, paths_c: ArrayLike, limit_c: ArrayLike) -> FloatArray:
    """Time (...) at which each path first reaches its limit; infinite if never.

    Interpolated between rows; a path that is over the limit at its first row crosses it there.

    `time_s`, `paths_c` (..., n) times of the rows and temperatures in degC; a row of NaN is not
    over any limit; `limit_c` (...) in degC.
    """
    limit = np.asarray(limit_c, np.float64)
    over = np.asarray(paths_c) >= limit[..., np.newaxis]
    paths, times = (np.broadcast_to(np.asarray(part), over.shape) for part in (paths_c, time_s))
    first = np.argmax(over, axis=-1, keepdims=True)
    before = np.maximum(first - 1, 0)

    def at(rows: NDArray[np.float64], place: NDArray[np.intp]) -> FloatArray:
        return np.take_along_axis(rows, place, axis=-1)[..., 0]

    low, high = at(paths, before), at(paths, first)
    rise = np.where(high > low, high - low, 1.0)
    share = np.where(first[..., 0] > 0, np.clip((limit - low) / rise, 0.0, 1.0), 0.0)
    crossing_s = at(times, before) + share * (at(times, first) - at(times, before))
    return np.where(np.any(over, axis=-1), crossing_s, np.inf)
