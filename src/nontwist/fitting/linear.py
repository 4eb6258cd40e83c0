r"""Starting values without an iteration: two methods that are linear in the inertia.

**Weak form.** A free body has ``J W' = J W × W``. Times a smooth function φ that vanishes at the ends of a window and
integrated by parts, this needs no derivative of the recording,

    J ∫φ' W dt + ∫φ (J W × W) dt = 0 ,

and it is linear in the six entries of J. Many windows make a least-squares problem on tr J = 1. With
``φ = (1 - s²)⁴`` the trapezoidal rule is exact to high order. White noise does not bias the second term, since
``I × I`` vanishes; it biases the first a little towards a sphere.

**Energy and momentum.** ``W·J W`` and ``W·J² W`` are constant. A quadratic form that is constant along the recording is
found without any time: the two smallest singular vectors of the centred products W_i W_j span J and J². J is the
member of this pencil whose square lies in it too, and of the few that do, the one that the weak form likes best. Noise
harms it more, coarse sampling does not harm it at all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.arrays import Array
from .bodies import BASIS, ENTRIES, LEVI, entries, symmetric
from .chart import TRACELESS

WIDTHS = (1.0, 2.0, 4.0)  # of a window, rad
FEWEST = 8  # samples in a window
SPHERE = entries(np.eye(3) / 3)
ANGLES = 360  # of a pencil
CROSS = np.einsum("abc,kbd->kadc", LEVI, BASIS).reshape(6, 3, 9)


def weak_rows(time: Array, rates: Array, width: float) -> Array:
    """Return the equations of the weak form, (m, 3, 6), over windows of so many radians."""
    speed = np.sqrt((rates**2).sum(axis=1).mean())
    interval = np.median(np.diff(time))
    half = min(max(width / max(speed, 1e-300), FEWEST * interval), time[-1] - time[0]) / 2
    centres = np.arange(time[0] + half, time[-1] - half * (1 - 1e-9), half / 2)
    rows = []
    for centre in centres if len(centres) else [(time[0] + time[-1]) / 2]:
        inside = np.flatnonzero(abs(time - centre) <= half)
        if len(inside) < FEWEST or np.diff(time[inside]).max() > 3 * interval:
            continue
        s, W = (time[inside] - centre) / half, rates[inside]
        weight = np.gradient(time[inside])
        bump = (1 - s**2) ** 4 * weight
        slope = -8 * s * (1 - s**2) ** 3 / half * weight
        products = (W.T * bump) @ W
        rows.append((BASIS @ (slope @ W) + CROSS @ products.ravel()).T / (half * speed**2 + 1e-300))
    return np.array(rows).reshape(-1, 3, 6)


def weak_form(stretches: Sequence[tuple[Array, Array]], width: float = WIDTHS[1]) -> tuple[Array, float] | None:
    """Return J of trace 1 by the weak form, and how large its residual is; None where there are too few samples."""
    rows = np.concatenate([weak_rows(time, rates, width) for time, rates in stretches]).reshape(-1, 6)
    if len(rows) < 6:
        return None
    w, *_ = np.linalg.lstsq(rows @ TRACELESS, -rows @ SPHERE, rcond=1e-6)
    v = SPHERE + TRACELESS @ w
    return symmetric(v), float(np.sqrt(np.mean((rows @ v) ** 2)))


def pencil(stretches: Sequence[tuple[Array, Array]]) -> Array | None:
    """Return J of trace 1 by energy and momentum, or None where they do not tell."""
    centred = []
    for _, W in stretches:
        products = np.stack([W[:, i] * W[:, j] * (1 if i == j else 2) for i, j in ENTRIES], axis=1)
        centred.append(products - products.mean(axis=0))
    rows = np.concatenate(centred)
    if len(rows) < 6:
        return None
    found = np.linalg.svd(rows, full_matrices=False)[2]
    first, second = symmetric(found[-1]), symmetric(found[-2])
    angle = np.linspace(0, np.pi, ANGLES, endpoint=False)
    J = np.cos(angle)[:, None, None] * first + np.sin(angle)[:, None, None] * second
    trace = np.trace(J, axis1=1, axis2=2)
    J = J[abs(trace) > 0.1] / trace[abs(trace) > 0.1, None, None]
    E = np.eye(3) / 2 - J
    J = J[np.linalg.eigvalsh(E)[:, 0] > -0.05] if len(J) else J
    if not len(J):
        return None
    plane = np.stack([entries(first), entries(second)])
    squares = entries(J @ J)
    squares = squares / np.linalg.norm(squares, axis=1, keepdims=True)
    outside = np.linalg.norm(squares - squares @ np.linalg.pinv(plane) @ plane, axis=1)
    best = J[np.argsort(outside)[:20]]
    weak = np.concatenate([weak_rows(time, rates, WIDTHS[1]) for time, rates in stretches]).reshape(-1, 6)
    return np.asarray(best[0] if not len(weak) else best[np.argmin(np.linalg.norm(entries(best) @ weak.T, axis=1))])
