"""Jacobi's theta function θ1 of complex arguments, its size apart, for arrays.

With q = e^(iπτ) and an argument v that is brought to |Im v| <= π Im τ/2 by θ1(v + π τ) = -e^(-iπτ - 2iv) θ1(v) (DLMF
20.2.8), the series over sin((2n + 1) v) = sin v (1 + 2 Σ cos 2jv, j <= n) is

    θ1(v)/(2 q^(1/4)) = sin v (1 + T_0 + Σ_j T_j (e^(ij(πτ + 2v)) + e^(ij(πτ - 2v)))),
    T_j = Σ_(n >= max(j, 1)) (-1)^n q^(n(n + 1) - j),

where no power exceeds 1 and no difference is small but that of sin v at its zeros. The size |Im v| of sin v is kept as
a logarithm, so that nothing overflows, and τ may be i∞. For |q| <= e^(-π/2) the terms left out are below 1e-24.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np

from ..geometry.arrays import Array

_TERMS, _FLAT = 6, 200.0  # from this Im τ on, θ1 is a sine


class Theta:
    """θ1(v|τ)/(2 q^(1/4)), for Re τ of 0 or 1/2 and Im τ >= 1/2."""

    def __init__(self, tau: complex) -> None:
        self.tau, self.is_flat = tau, tau.imag > _FLAT
        self.exponent = 0j if self.is_flat else 1j * math.pi * tau
        q = 0j if self.is_flat else cmath.exp(self.exponent)
        powers = [[(-1) ** n * q ** (n * (n + 1) - j) for n in range(max(j, 1), _TERMS + 1)] for j in range(_TERMS + 1)]
        self.weights = [sum(terms, 0j) for terms in powers]
        self.slope = complex(1 + self.weights[0] + 2 * sum(w * q**j for j, w in enumerate(self.weights) if j))

    def at(self, v: Any) -> tuple[Any, Array, Any]:
        """Return the value over e^size, the size, and the logarithmic derivative, at complex `v`, an array or one."""
        v = np.asarray(v, complex)
        k = np.zeros(v.shape) if self.is_flat else np.round(v.imag / (math.pi * self.tau.imag))
        if not self.is_flat:
            v = v - k * (math.pi * self.tau)
        size = abs(v.imag)
        c, s = 0.5 * (1 + np.exp(-2 * size)), np.copysign(-0.5 * np.expm1(-2 * size), v.imag)
        sine, cosine = np.sin(v.real) * c + 1j * np.cos(v.real) * s, np.cos(v.real) * c - 1j * np.sin(v.real) * s
        series, slope = np.full(v.shape, 1 + self.weights[0]), np.zeros(v.shape, complex)
        if not self.is_flat:
            up, down = np.exp(self.exponent + 2j * v), np.exp(self.exponent - 2j * v)
            a, b = up, down
            for j in range(1, _TERMS + 1):
                series += self.weights[j] * (a + b)
                slope += 2j * j * self.weights[j] * (a - b)
                a, b = a * up, b * down
            shift = -self.exponent * k * k - 2j * k * v + 1j * math.pi * k
            sine, cosine, size = sine * np.exp(1j * shift.imag), cosine * np.exp(1j * shift.imag), size + shift.real
        with np.errstate(divide="ignore", invalid="ignore"):
            return sine * series, size, cosine / sine + slope / series - 2j * k
