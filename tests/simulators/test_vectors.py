"""Vectors of numba against numpy, lane by lane."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numba import njit

from cyclofeat.simulators.batch import _vectors as vectors

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="vectors exist in compiled functions only")
KINDS = [(np.float32, 16), (np.float64, 8), (np.float32, 1)]


@njit(fastmath=vectors.FASTMATH)
def elementwise(lanes, a_, b_, out_):
    a, b, out = vectors.addresses((a_, b_, out_))
    x, y = vectors.load(a, 0, lanes), vectors.load(b, 0, lanes)
    vectors.store(out, 0, x + y)
    vectors.store(out, 1, x - 2.0 * y)
    vectors.store(out, 2, x * y)
    vectors.store(out, 3, 1.0 / y)
    vectors.store(out, 4, -x)
    vectors.store(out, 5, vectors.smaller(x, y))
    vectors.store(out, 6, vectors.larger(x, 0.5))
    vectors.store(out, 7, vectors.choose((x < y) & ~(x > 0.3) | (y >= 1.0), 1.0, y))
    vectors.store(out, 8, vectors.root(vectors.magnitude(x)))
    vectors.store(out, 9, vectors.whole_below(3 * x))
    vectors.store(out, 10, vectors.load_from(b, 1, lanes))
    vectors.store(out, 11, vectors.fill_lanes(vectors.largest_lane(x), a, lanes))


def elementwise_in_numpy(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x, y, ahead = x, y[:-1], y[1:]
    chosen = np.where((x < y) & ~(x > 0.3) | (y >= 1), 1, y)
    return np.array(
        [
            x + y, x - 2 * y, x * y, 1 / y, -x, np.minimum(x, y), np.maximum(x, 0.5), chosen,
            np.sqrt(np.abs(x)), np.floor(3 * x), ahead, np.full_like(x, x.max()),
        ]
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "n"), KINDS)
def test_operators_and_functions(dtype: type, n: int) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=n).astype(dtype), rng.normal(size=n + 1).astype(dtype)
    out = np.zeros((12, n), dtype)
    elementwise(vectors.lane_tuple(n), x, y, out)
    np.testing.assert_allclose(out, elementwise_in_numpy(x, y), rtol=3 * np.finfo(dtype).eps)


@njit(fastmath=vectors.FASTMATH)
def masks(lanes, a_, out_, wide_):
    a, out, wide = vectors.addresses((a_, out_, wide_))
    x = vectors.load(a, 0, lanes)
    mask = vectors.bits_of(x > 0.0)
    out[0] = mask
    out[1] = vectors.first_bit(mask)
    out[2] = np.uint64(vectors.lane_count(lanes))
    vectors.store(wide, 0, vectors.join_lanes(x, -x))


def test_masks_and_halves() -> None:
    x = np.array([-1, 2, -3, 4, -5, 6, 7, -8], dtype=np.float32)
    out, wide = np.zeros(3, np.uint64), np.zeros(16, np.float32)
    masks(vectors.lane_tuple(8), x, out, wide)
    assert out.tolist() == [0b01101010, 1, 8]
    assert wide.tolist() == [*x, *-x]


@njit(fastmath=vectors.FASTMATH)
def rounded(lanes, a_, out_):
    a, out = vectors.addresses((a_, out_))
    vectors.store(out, 0, vectors.round_to(vectors.load(a, 0, lanes) - 1e9, out))


def test_differences_form_before_rounding() -> None:
    a = 1e9 + np.array([0.25, 1e-3, -0.5, 3.0])
    for dtype in (np.float32, np.float64):
        out = np.zeros(4, dtype)
        rounded(vectors.lane_tuple(4), a, out)
        assert np.array_equal(out, (a - 1e9).astype(dtype))


@njit(fastmath=vectors.FASTMATH)
def not_numbers(lanes, a_, out_):
    a, out = vectors.addresses((a_, out_))
    x = vectors.load(a, 0, lanes)
    out[0] = vectors.bits_of(x < 1.0)
    out[1] = vectors.bits_of(~(x < 1.0))


def test_comparisons_with_nan_are_false() -> None:
    a, out = np.array([np.nan, 0.0, 2.0, np.nan]), np.zeros(2, np.uint64)
    not_numbers(vectors.lane_tuple(4), a, out)
    assert out.tolist() == [0b0010, 0b1101]


@njit(fastmath=vectors.FASTMATH)
def mixed(lanes, a_, b_):
    a, b = vectors.addresses((a_, b_))
    return vectors.bits_of(vectors.load(a, 0, lanes) < vectors.load(b, 0, lanes))


def test_kinds_do_not_mix() -> None:
    assert mixed(vectors.lane_tuple(4), np.zeros(4), np.ones(4)) == 0b1111
    with pytest.raises(numba.TypingError):
        mixed(vectors.lane_tuple(4), np.zeros(4), np.ones(4, np.float32))
