"""Noise of sampled axes, from the samples alone, and what it does to the twist.

**The level.** A divided difference of order m over m + 1 neighbouring samples, its weights scaled to the sum of squares
1, is free of every polynomial motion of degree below m, and has the variance σ² where each component of the samples has
independent errors of standard deviation σ. The component normal to the path is taken: errors of the times, or unknown
times, shift samples along the path. The orders 2, 4, 6 and 8 give estimates which all are σ plus what is left of the
motion, so that the smallest counts; of those within a fifth of it the one of lowest order, which scatters least. Where
there are no times, the parameter is the number of the sample or, as far as noise is small beside the steps, the length
of the path. Motion that the samples do not resolve counts as noise.

**What it does.** `twisting` derives the two areas. With steps x_i+1 - x_i-1 of which noise makes 4 σ² of the mean
square, up to sample k

    σ² Σ max(|x_i+1 - x_i-1|² - 4 σ², 0)/4  +  f² σ⁴ k/2  +  2 σ²,

the variance of the area that grows with the path, of the one that grows with the number of samples (f = 1; 1.5 at order
4 where σ exceeds the mean step), and of the attitudes at both ends.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..geometry.stacks import norm

ORDERS = (2, 4, 6, 8)
LEAST = 12  # samples
_NEAR, _SMALL = 1.2, 0.1
_BLOCK = 8192  # windows at a time, so that what is made of them stays small


def noise_level(d3: Array, time: Array | None) -> float:
    """Estimated standard deviation of each component of sampled unit vectors (n, 3), rad; NaN for fewer than 12."""
    if len(d3) < LEAST:
        return float("nan")
    found = _levels(d3, np.arange(len(d3), dtype=np.float64) if time is None else time)
    if time is None:
        steps = norm(np.diff(d3, axis=0))
        along = _levels(d3, np.append(0.0, np.cumsum(steps)))
        found += [level if level < _SMALL * steps.mean() else float("inf") for level in along]
    levels = np.array(found)
    if not np.isfinite(levels).any():
        return 0.0
    return float(levels[np.flatnonzero(levels <= _NEAR * np.nanmin(levels))[0]])


def _levels(d3: Array, parameter: Array) -> list[float]:
    if not np.diff(parameter).all():
        return [float("inf")] * len(ORDERS)
    return [_level(d3, parameter, m) for m in ORDERS]


def _level(d3: Array, parameter: Array, m: int) -> float:
    """Root mean square of the divided differences of order m across the path."""
    blocks = range(0, len(d3) - m, _BLOCK)
    across = np.concatenate([_across(d3[k : k + _BLOCK + m], parameter[k : k + _BLOCK + m], m) for k in blocks])
    return float(np.sqrt(np.mean(across**2))) if across.size else 0.0


def _across(d3: Array, parameter: Array, m: int) -> Array:
    """Components normal to the path of the divided differences over m + 1 samples, where the path has a direction."""
    windows, samples = (np.lib.stride_tricks.sliding_window_view(each, m + 1, axis=0) for each in (parameter, d3))
    x = windows.T
    scale, products = np.abs(x[-1] - x[0]), np.ones_like(x)
    for i in range(m + 1):
        for j in range(i):
            gap = (x[i] - x[j]) / scale
            products[i] *= gap
            products[j] *= -gap
    smallest = np.abs(products).min(axis=0)
    weights = np.divide(smallest, products, out=np.zeros_like(products), where=products != 0).T.copy()
    length = np.linalg.norm(weights, axis=1, keepdims=True)
    weights /= np.where(length > 0, length, 1.0)  # 0 where two are so close that their difference, nothing, is all
    rest = np.einsum("kxj,kj->kx", samples, weights)
    normal = np.cross(samples[:, :, m // 2], samples[:, :, -1] - samples[:, :, 0])
    size = norm(normal)
    across: Array = np.einsum("kx,kx->k", rest, normal)[size > 0] / size[size > 0]
    return across


def noise_of_twist(d3: Array, sigma: float, order: int) -> Array:
    """Return the standard deviation of the twist (n,), rad, by independent errors of d3 of `sigma` each."""
    n = len(d3)
    wide = np.zeros(n)
    wide[1:-1] = np.maximum(norm(d3[2:] - d3[:-2]) ** 2 - 4 * sigma**2, 0.0) / 4
    step = float(np.mean(norm(np.diff(d3, axis=0)))) if n > 1 else 0.0
    factor = 1.5 if order == 4 and sigma > step else 1.0
    counted = np.arange(n)
    variance = sigma**2 * np.cumsum(wide) + factor**2 * sigma**4 * counted / 2 + 2 * sigma**2 * (counted > 0)
    return np.asarray(np.sqrt(variance))
