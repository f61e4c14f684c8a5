"""Sensor noise from a counter: the value depends on seed, frame and pixel alone, not on the order of
drawing."""

from functools import cache
from statistics import NormalDist

import numpy as np

from taichi_eye.lang import ti

QUANTILES = 4096


@ti.func
def hash_u32(x: ti.u32) -> ti.u32:
    """A 32-bit mixing function of low bias (C. Wellons, "Prospecting for hash functions", 2018)."""
    x ^= x >> ti.u32(16)
    x = multiply_low(x, 0x7FEB352D)
    x ^= x >> ti.u32(15)
    x = multiply_low(x, 0x846CA68B)
    x ^= x >> ti.u32(16)
    return x


@ti.func
def multiply_low(x: ti.u32, factor: ti.template()) -> ti.u32:
    """Product modulo 2^32, taken in 64 bits: debug mode reports a 32-bit overflow as an error."""
    return ti.cast((ti.cast(x, ti.u64) * ti.u64(factor)) & ti.u64(0xFFFFFFFF), ti.u32)


def noise_key(seed: int, frame: int) -> int:
    """32-bit key of one frame's noise."""
    return int(np.random.SeedSequence([seed, frame]).generate_state(1)[0])


@cache
def gaussian_table() -> np.ndarray:
    """Standard normal quantiles at the midpoints of 4096 equal shares, scaled to unit variance, shape
    [4096]."""
    normal = NormalDist()
    table = np.array([normal.inv_cdf((k + 0.5) / QUANTILES) for k in range(QUANTILES)])
    return table / table.std()
