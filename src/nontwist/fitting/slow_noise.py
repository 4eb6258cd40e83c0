r"""Noise that goes on from one sample to the next, as residuals show it, and what it does to what is fitted.

With A the derivatives, residuals are ``r = (1 - H) e``, where ``H = A (AᵀA)⁻¹ Aᵀ``: the fit has taken up a part of a
slow noise e, so that r is less correlated than e. The restricted likelihood of r allows for it (Patterson and Thompson,
Biometrika 58, 1971, 545-554). With the covariance σ² S of n values of e, and p columns of A, it is, but for a constant,

    -2 log L = log|σ² S| + log|Aᵀ S⁻¹ A/σ² + P| + ρ/σ² ,     ρ = min_x (r - A x)ᵀ S⁻¹ (r - A x) .

P is the information of all else that tells the unknowns. With ``AᵀA + P = 1`` it tells tr P of the p unknowns, and
``σ² = ρ/(n - p + tr P)``.

Of e the part s is slow, and goes on as φᵏ after k samples; the rest is white. All axes and recordings are alike. Cosine
transforms of the recordings make S diagonal, but for their ends, with the spectrum

    S(ω) = 1 - s + s (1 - φ²)/(1 - 2 φ cos ω + φ²)

(Whittle, Arkiv för Matematik 2, 1953, 423-434). So the products of A and r in bands of ω tell L for all φ and s. The
fit itself weighs all samples alike; in these unknowns its covariance is ``σ² Aᵀ S A + P``.

**Effective samples.** The variance of n samples of slow noise is as well known as that of ``n (1 - φ²)/(1 + φ²)``
samples of white noise (Bayley and Hammersley, Journal of the Royal Statistical Society, Supplement 8, 1946, 184-197).
Where slow noise makes the part q of a variance and white noise the rest, these are (Welch and Satterthwaite)

    1/m = q² (1 + φ²)/(1 - φ²)/n + (1 - q)²/n .

**Degrees of freedom.** The variance of what changes slowly is in proportion to ``σ² (1 + φ)/(1 - φ)``. With that of φ,
``(1 - φ²)/n``, its logarithm has the variance ``(2 + 4 (1 + φ)/(1 - φ))/n``, which tends to 8/m, that of m/4 squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import Array
from .shooting import WHITE

SINGLE, BAND = 12, 1.1  # lowest frequencies, each by itself; ratio of the ends of the others' bands
SURE = WHITE**2  # twice the logarithm of the likelihood over that of white noise: as many standard errors
PARTS, PLACES = (0.1, 0.3, 0.6, 0.9, 0.99), 15  # where a search begins: s, and how many φ
CLOSE, CALLS = 0.01, 200  # of a search: accuracy, and trials


class SlowNoise(NamedTuple):
    """The correlation φ of neighbours in slow noise, and the covariance of what is fitted, over that of white noise.

    The unknowns are those in which white noise has the covariance 1; `part` is what slow noise makes of `covariance`.
    """

    phi: float
    covariance: Array
    part: Array


def noise_of_residuals(recordings: Sequence[Array], others: Array) -> SlowNoise | None:
    """Return the noise of residuals; None where they are as likely to be white.

    Parameters
    ----------
    recordings : sequence of (n, 3, p + 1) arrays
        Derivatives by the unknowns, and residuals, of the samples of each.
    others : (k, p) array
        Derivatives of what has white noise of variance 1 in any case.
    """
    from scipy.fft import dct
    from scipy.optimize import minimize

    spectra = np.concatenate([dct(one, axis=0, norm="ortho") for one in recordings])
    frequencies = np.concatenate([np.pi / len(one) * np.arange(len(one)) for one in recordings])
    order, n = np.argsort(frequencies, kind="stable"), len(frequencies)
    above = np.geomspace(SINGLE, n, 2 + int(np.log(n / SINGLE) / np.log(BAND)))
    ends = np.unique(np.append(np.arange(SINGLE), np.round(above))).astype(int)
    bands = [order[a:b] for a, b in pairwise(ends)]
    products = np.stack([np.einsum("nai,naj->ij", spectra[one], spectra[one]) for one in bands])
    cosines = np.cos([frequencies[one].mean() for one in bands])
    counts, known = 3 * np.diff(ends), np.pad(others.T @ others, (0, 1))
    free, longest = 3 * n - len(known) + 1 + np.trace(known), max(map(len, recordings))

    def spectrum(x: Array) -> tuple[Array, Array, Array]:
        """Return φ and the slow and the white part of S where artanh φ and the logit of s are x, (..., 2)."""
        phi = np.minimum(np.tanh(x[..., :1]), np.exp(-1 / longest))
        s = 1 / (1 + np.exp(-x[..., 1:]))
        return phi[..., 0], s * (1 - phi**2) / (1 - 2 * phi * cosines + phi**2), 1 - s

    def likelihood(S: Array) -> tuple[Array, Array]:
        """Return -2 log L and σ² for values of S, (..., bands)."""

        def diagonal(S: Array) -> Array:
            D = np.linalg.cholesky(np.tensordot(1 / S, products, 1) + known)
            return np.diagonal(D, axis1=-2, axis2=-1)

        variance = diagonal(S)[..., -1] ** 2 / free
        S = variance[..., None] * S
        D = diagonal(S)
        return np.log(S) @ counts + 2 * np.log(D[..., :-1]).sum(axis=-1) + D[..., -1] ** 2, variance

    def unlikely(x: Array) -> Array:
        _, slow, rest = spectrum(x)
        return likelihood(slow + rest)[0]

    white, variance = likelihood(np.ones(len(counts)))
    top = float(np.arctanh(np.exp(-1 / longest)))
    starts = np.stack(np.meshgrid(np.linspace(-1, top, PLACES), np.log(np.divide(PARTS, 1 - np.array(PARTS)))), axis=-1)
    tried = unlikely(starts)
    if tried.min() > white - SURE:
        return None
    how = {"xatol": CLOSE, "fatol": CLOSE, "maxfev": CALLS}
    best = minimize(
        unlikely, starts[np.unravel_index(np.argmin(tried), tried.shape)], method="Nelder-Mead", options=how
    )
    phi, slow, rest = spectrum(best.x)
    size = likelihood(slow + rest)[1] / variance
    part, whole = (size * np.tensordot(one, products[:, :-1, :-1], 1) for one in (slow, slow + rest))
    return SlowNoise(float(phi), whole + known[:-1, :-1], part)
