r"""Noise that goes on from one sample to the next, as residuals show it, and what it does to what is fitted.

With A the derivatives, residuals are ``r = (1 - H) e``, where ``H = A (AᵀA)⁻¹ Aᵀ``: the fit has taken up a part of a
slow noise e, so that r is less correlated than e. The restricted likelihood of r allows for it (Patterson and Thompson,
Biometrika 58, 1971, 545-554). With the covariance V of e it is, but for a constant,

    -2 log L = log|V| + log|Aᵀ V⁻¹ A + P| + ρ ,     ρ = min_x (r - A x)ᵀ V⁻¹ (r - A x) + |r_b - A_b x|² .

The rows b are all else that tells the unknowns, with the information ``P = A_bᵀ A_b``. Of p unknowns n samples tell
``p - tr P (AᵀA + P)⁻¹``, and ``V = σ² S`` has ``σ² = ρ/(n - tr AᵀA (AᵀA + P)⁻¹)``.

Of e the part s is slow, and goes on as φᵏ after k samples; the rest is white. All axes and recordings are alike. Cosine
transforms of the recordings make S diagonal, but for their ends, with the spectrum

    S(ω) = 1 - s + F(ω) ,     F(ω) = s (1 - φ²)/(1 - 2 φ cos ω + φ²)

(Whittle, Arkiv för Matematik 2, 1953, 423-434). So the products of A and r in bands of ω tell L for all φ and s. The
fit itself weighs all samples alike; where ``AᵀA + P = 1`` its covariance is ``Aᵀ V A + P``.

**Two kinds**, angular velocities and attitudes, have σ, s and φ of their own. The residuals of one tell them without
those of the other: what both noises have in common then biases neither, and what the fit has taken from one kind into
the other is along A. Slow noise of one origin has the correlation c: transforms of the same order have the covariance
``c σ₁ σ₂ √(F₁ F₂)``. The likelihood of both kinds together tells c.

**Effective samples.** The variance of n samples of slow noise is as well known as that of ``n (1 - φ²)/(1 + φ²)``
samples of white noise (Bayley and Hammersley, Journal of the Royal Statistical Society, Supplement 8, 1946, 184-197).
Where slow noise makes the part q of a variance and white noise the rest, these are (Welch and Satterthwaite)

    1/m = z² + (1 - q)²/n ,     z² = q² (1 + φ²)/(1 - φ²)/n .

With two kinds there is ``z₁² + 2 c² z₁ z₂ + z₂²``, as squares of normal numbers have the correlation c².

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
SHARED = np.tanh(np.linspace(-3, 3, 121))  # c
LITTLE = 1e-6  # information of unknowns that one kind does not tell


class SlowNoise(NamedTuple):
    """The noise of each kind of residuals, and the covariance of what is fitted, over that of white noise.

    The unknowns are those in which white noise has the covariance 1.
    """

    counts: Array  # how many numbers of each kind there are
    phi: Array  # φ of each, 0 of white noise
    shared: float  # c
    covariance: Array
    parts: Array  # what the slow noise of each makes of the covariance


def noise_of_residuals(kinds: Sequence[Sequence[Array]], others: Array) -> SlowNoise | None:
    """Return the noise of residuals of one or two kinds; None where they are as likely to be white.

    Parameters
    ----------
    kinds : sequence of sequences of (n, 3, p + 1) arrays
        Derivatives by the unknowns, and residuals, of the samples of each recording.
    others : (k, p) array
        Derivatives of what has white noise of variance 1 in any case.
    """
    from scipy.fft import dct

    many, lengths = len(kinds), np.array([[len(one) for one in kind] for kind in kinds])
    most, known = lengths.max(axis=0), np.pad(others.T @ others, (0, 1))
    spectra = np.zeros((many, most.sum(), 3, len(known)))  # 0 beyond the last order of a kind
    for k, kind in enumerate(kinds):
        for one, first in zip(kind, np.cumsum(most) - most, strict=True):
            spectra[k, first : first + len(one)] = dct(one, axis=0, norm="ortho")
    orders, n = np.concatenate([np.arange(length) for length in most]), most.sum()
    frequencies = np.pi * orders / np.repeat(lengths, most, axis=1)
    above = np.geomspace(SINGLE, n, 2 + int(np.log(n / SINGLE) / np.log(BAND)))
    ends = np.unique(np.append(np.arange(SINGLE), np.round(above))).astype(int)
    order = np.argsort(frequencies.min(axis=0), kind="stable")
    bands = [order[a:b] for a, b in pairwise(ends)]
    products = np.stack([np.einsum("knai,lnaj->klij", spectra[:, one], spectra[:, one]) for one in bands])
    cosines = np.cos([frequencies[:, one].mean(axis=1) for one in bands]).T
    counts = 3 * np.array([(frequencies[:, one] < np.pi).sum(axis=1) for one in bands]).T
    found = [
        _own_noise(products[:, k, k], known, cosines[k], counts[k], np.exp(-1 / lengths[k].max())) for k in range(many)
    ]
    phi, slow, S = (np.array(one) for one in zip(*found, strict=True))
    if not phi.any():
        return None
    V, shared = S.T[:, :, None] * np.eye(many), 0.0
    paired = 3 * np.array([(frequencies[:, one] < np.pi / 2).all(axis=0).sum() for one in bands])  # without aliases
    mixed = np.multiply.outer(np.sqrt(slow.prod(axis=0)) * (paired > 0), 1 - np.eye(many))
    if mixed.any():
        each = V + SHARED[:, None, None, None] * mixed
        D = _triangle(np.einsum("cbkl,bklij->cij", np.linalg.inv(each), products) + known)
        unlikely = np.log(np.linalg.det(each)) @ paired + 2 * np.log(D[:, :-1]).sum(axis=1) + D[:, -1] ** 2
        shared = float(SHARED[np.argmin(unlikely)])
    numbers, every = counts.sum(axis=1), products.sum(axis=0)[range(many), range(many)]
    white = every[:, -1, -1] / (numbers - np.trace(every[:, :-1, :-1], axis1=1, axis2=2))
    of_white = products[..., :-1, :-1] / np.sqrt(np.multiply.outer(white, white))[..., None, None]
    common = np.einsum("bkl,bklij->ij", shared * mixed, of_white)
    parts = np.einsum("kb,bkij->kij", slow, of_white[:, range(many), range(many)])
    covariance = np.einsum("bkl,bklij->ij", V, of_white) + common + known[:-1, :-1]
    return SlowNoise(numbers, phi, shared, covariance, parts + common / 2)


def _triangle(M: Array) -> Array:
    """Return the diagonals of Cholesky factors."""
    return np.diagonal(np.linalg.cholesky(M), axis1=-2, axis2=-1)


def _own_noise(
    products: Array, known: Array, cosines: Array, counts: Array, longest: float
) -> tuple[float, Array, Array]:
    """Return φ, σ² F and σ² S of one kind; φ is 0 where white noise is as likely."""
    from scipy.optimize import minimize

    known, told = known + LITTLE * np.eye(len(known)), products.sum(axis=0)[:-1, :-1]
    free = counts.sum() - np.trace(np.linalg.solve(told + known[:-1, :-1], told))

    def spectrum(x: Array) -> tuple[Array, Array, Array]:
        """Return φ and the slow and the white part of S where artanh φ and the logit of s are x, (..., 2)."""
        phi = np.minimum(np.tanh(x[..., :1]), longest)
        s = 1 / (1 + np.exp(-x[..., 1:]))
        return phi[..., 0], s * (1 - phi**2) / (1 - 2 * phi * cosines + phi**2), 1 - s

    def likelihood(S: Array) -> tuple[Array, Array]:
        """Return -2 log L and σ² for values of S, (..., bands)."""

        def triangle(S: Array) -> Array:
            return _triangle(np.einsum("...b,bij->...ij", 1 / S, products) + known)  # no BLAS, whose threads wait

        variance = triangle(S)[..., -1] ** 2 / free
        S = variance[..., None] * S
        D = triangle(S)
        return np.log(S) @ counts + 2 * np.log(D[..., :-1]).sum(axis=-1) + D[..., -1] ** 2, variance

    def unlikely(x: Array) -> Array:
        _, slow, rest = spectrum(x)
        return likelihood(slow + rest)[0]

    white, variance = likelihood(np.ones(len(counts)))
    top = float(np.arctanh(longest))
    starts = np.stack(np.meshgrid(np.linspace(-1, top, PLACES), np.log(np.divide(PARTS, 1 - np.array(PARTS)))), axis=-1)
    tried = unlikely(starts)
    if tried.min() > white - SURE:
        return 0.0, np.zeros(len(counts)), np.full(len(counts), variance)
    how = {"xatol": CLOSE, "fatol": CLOSE, "maxfev": CALLS}
    best = minimize(
        unlikely, starts[np.unravel_index(np.argmin(tried), tried.shape)], method="Nelder-Mead", options=how
    )
    phi, slow, rest = spectrum(best.x)
    size = likelihood(slow + rest)[1]
    return float(phi), size * slow, size * (slow + rest)
