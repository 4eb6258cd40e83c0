"""What errors of the samples do to a twist: noise, its level, and rounding.

**Noise.** Independent errors of standard deviation σ in each component of n attitudes shift d3 by ε_i at the points x_i
of a path of length s. They turn the frame by the area between the noisy polygon and the true one,

    ½ Σ (x_i+1 - x_i-1) × ε_i + ½ Σ ε_i × ε_i+1,

of standard deviation σ s/√n for the first sum, which falls with n, and σ² √(n/2) for the second, which **grows** with n
(at order 4 it is 1.5 times as large once σ exceeds the spacing). The attitudes at both ends add σ √2. The integral of a
rate with independent errors σ_w is off by σ_w √n times the time between samples. `noise_estimate` is what noise does to
ψ, apart from the error by sampling: with steps x_i+1 - x_i-1 of which noise makes 4 σ² of the mean square, to sample k

    σ² Σ max(|x_i+1 - x_i-1|² - 4 σ², 0)/4  +  f² σ⁴ k/2  +  2 σ²,

the variance of the area that grows with the path, of the one that grows with the number of samples (f = 1; 1.5 at order
4 where σ exceeds the mean step), and of the attitudes at both ends.

**The level of noise** σ is estimated from the samples alone. A divided difference of order m over m + 1 neighbouring
samples, its weights scaled to the sum of squares 1, is free of every polynomial motion of degree below m, and has the
variance σ². The component normal to the path is taken: errors of the times, or unknown times, shift samples along the
path. The orders 2, 4, 6 and 8 give estimates which all are σ plus what is left of the motion, so that the smallest
counts; of those within a fifth of it the one of lowest order, which scatters least. Where there are no times, the
parameter is the number of the sample or, as far as noise is small beside the steps, the length of the path. Motion that
the samples do not resolve counts as noise.

**Rounding** to a unit r shows in quaternions as recorded, all multiples of r. It moves d3 by σ = r/√3 in each
component; of matrices by r/√24. A number that is rounded to c has the same error whenever it recurs, and -c the
opposite one: what rests has no new errors, and those of a periodic motion add up from period to period. An error ε of
the component j of a quaternion turns the body by 2 ε t_j, t_j = (e_j q*)_vec. With the samples i in which it is ±c the
variance is

    σ² Σ_j Σ_c (½ Σ_i ± (x_i+1 - x_i-1) · t_j,i)²  +  2 σ².

`noise_estimate` is the larger of this and of that of independent errors.
"""

from __future__ import annotations

import math

import numpy as np

from ..geometry.arrays import Array, norm

ORDERS = (2, 4, 6, 8)
LEAST = 12  # samples
_NEAR, _SMALL = 1.2, 0.1
FINEST, COARSEST = 1e-6, 0.1  # units of rounding
MULTIPLE = 1e-3  # of the unit: how far numbers may be off its multiples
EXACT = 0.05  # of the unit: how far lengths of exact rotations may be off 1
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
    """Root mean squares of the divided differences of each order across the path; infinite where points coincide."""
    found = list[float]()
    for m in ORDERS if np.diff(parameter).all() else ():
        blocks = range(0, len(d3) - m, _BLOCK)
        across = np.concatenate([_across(d3[k : k + _BLOCK + m], parameter[k : k + _BLOCK + m], m) for k in blocks])
        found.append(float(np.sqrt(np.mean(across**2))) if across.size else 0.0)
    return found or [float("inf")] * len(ORDERS)


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
    return np.einsum("kx,kx->k", rest, normal)[size > 0] / size[size > 0]


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


@np.errstate(invalid="ignore")  # of rows that are not finite
def rounding(values: Array) -> float:
    """Return the deviation of each component of d3 by rounding of quaternions or matrices, 0.0 where they are not."""
    if len(values) < LEAST:
        return 0.0
    rows = values.reshape(len(values), -1)
    some = rows[:: 1 + len(rows) // _BLOCK]
    some = some[np.isfinite(some).all(axis=1)]
    gaps = np.diff(np.unique(abs(some)))
    unit = float(gaps[gaps > FINEST].min(initial=np.inf))
    if unit > COARSEST:
        return 0.0
    is_matrix = rows.shape[1] == 9
    size = np.sqrt((some**2).sum(axis=1) / (3 if is_matrix else 1))
    blocks = (rows[k : k + _BLOCK] / unit for k in range(0, len(rows), _BLOCK))
    is_rounded = np.sqrt(np.mean((size - 1) ** 2)) >= EXACT * unit
    if not is_rounded or any((abs(one - np.round(one)) > MULTIPLE).any() for one in blocks):
        return 0.0
    return unit / math.sqrt(24 if is_matrix else 3)


def noise_of_rounding(d3: Array, p: Array, sigma: float) -> Array:
    """Return the standard deviation of the twist (n,), rad, by errors of attitudes p that equal numbers share."""
    n = len(d3)
    step, (v, s), growth = np.zeros((n, 3)), np.split(p, [3], axis=1), np.zeros(n)
    step[1:-1] = (d3[2:] - d3[:-2]) / 2
    shares = np.column_stack([s * step - np.cross(v, step), -np.einsum("ki,ki->k", v, step)])
    for share, number in zip((shares * np.sign(p)).T, p.T, strict=True):
        cell = np.round(abs(number) / FINEST)
        order = np.argsort(cell, kind="stable")
        cell, share = cell[order], share[order]
        first = np.maximum.accumulate(np.where(np.append(True, cell[1:] != cell[:-1]), np.arange(n), 0))
        before = np.cumsum(share) - share
        growth[order] += share * (share + 2 * (before - before[first]))
    variance = np.maximum(np.cumsum(growth), 0.0) + 2 * (np.arange(n) > 0)
    return np.asarray(sigma * np.sqrt(variance))
