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

**Other moments.** What acts beside enters the weak form as columns of its own. Damping is ``-∫φ W dt`` times C. A rotor
of momentum h is ``∫φ h × W dt + ∫φ' h dt`` over the unit of J, which follows; where its axis is fitted there is one for
each axis of the body, and the length of the three is 1 over the unit. The
direction of gravity in the body is ``γ = Rᵀ γ_0``, where R is the turn since the start by the recorded angular
velocity, so with ``a = m g c`` the moment ``a × Rᵀ γ_0`` is linear in the nine products ``a γ_0ᵀ``. For all recordings
side by side these make a matrix of rank one, whose singular vectors are a and the γ_0; as |γ_0| = 1, its size is |a|.
Where the direction n of c is known the three numbers |a| γ_0 are found instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np

from ..geometry.arrays import Array
from ..geometry.tensors import BASIS, ENTRIES, LEVI
from .bodies import TRACELESS, Model, entries, symmetric, unit_vector
from .quality import haste_of

WIDTHS = (1.0, 2.0, 4.0)  # of a window, rad
ROUND = ((1.0, 0.0), (2.0, 0.03), (4.0, 0.03), (2.0, 0.3), (2.0, 0.0), (4.0, 0.0))  # widths; weights of a sphere
FEWEST, TOGETHER = 8, 8  # samples in a window; windows at once
SPHERE = entries(np.eye(3) / 3)
ANGLES = 360  # of a pencil
CROSS = np.einsum("abc,kbd->kadc", LEVI, BASIS).reshape(6, 3, 9)


def weak_rows(
    time: Array,
    rates: Array,
    width: float,
    moments: Array | None = None,
    momenta: Array | None = None,
    haste: float = 1.0,
) -> Array:
    """Return the equations of the weak form over windows of so many radians, (m, 3, 6 + q).

    `moments`, (n, 3, q), are those that act per unit of q more unknowns, and `momenta`, (n, 3, q), are those of rotors;
    W changes `haste` times as fast as the body turns.
    """
    n = len(time)
    acting = np.zeros((n, 3, 0)) if moments is None else moments
    speed = np.sqrt((rates**2).sum(axis=1).mean())
    steps = np.diff(time)
    interval = np.median(steps)
    half = min(max(width / max(speed * haste, 1e-300), FEWEST * interval), time[-1] - time[0]) / 2
    centres = np.arange(time[0] + half, time[-1] - half * (1 - 1e-9), half / 2)
    centres = centres if len(centres) else np.array([(time[0] + time[-1]) / 2])
    first, last = np.searchsorted(time, centres - half), np.searchsorted(time, centres + half, "right")
    gaps = steps > 3 * interval
    lost = np.concatenate([[0], np.cumsum(gaps)])  # before each sample
    whole = (last - first >= FEWEST) & (lost[last - 1] == lost[np.minimum(first, n - 1)])
    weight = np.gradient(np.concatenate([[0.0], np.cumsum(np.where(gaps, interval, steps))]))
    rows = [np.zeros((0, 3, 6 + acting.shape[2]))]
    centres, first, last = centres[whole], first[whole], last[whole]
    for group in (slice(k, k + TOGETHER) for k in range(0, len(centres), TOGETHER)):
        inside = slice(first[group][0], last[group][-1])
        s, W = (time[inside] - centres[group, None]) / half, rates[inside]
        rest = np.maximum(1 - s**2, 0.0)
        bump, slope = rest**4 * weight[inside], -8 * s * rest**3 / half * weight[inside]
        products = np.einsum("mn,ni,nj->mij", bump, W, W).reshape(-1, 9)
        turning = np.einsum("kij,mj->mik", BASIS, np.einsum("mn,nj->mj", slope, W)) + np.einsum(
            "kia,ma->mik", CROSS, products
        )
        more = np.einsum("mn,niq->miq", bump, acting[inside])
        if momenta is not None:
            more += np.einsum("mn,niq->miq", slope, momenta[inside])
        rows.append(np.concatenate([turning, more], axis=2) / (half * speed**2 * haste + 1e-300))
    return np.concatenate(rows)


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


def turns(time: Array, rates: Array) -> Array:
    """Return the rotations since the first sample by angular velocities that are linear between samples, (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    steps = Rotation.from_rotvec((rates[1:] + rates[:-1]) / 2 * np.diff(time)[:, None]).as_matrix()
    n, size = len(time), int(np.sqrt(len(time))) + 1
    found = np.broadcast_to(np.eye(3), (size * size, 3, 3)).copy()  # blocks of so many, each from its own beginning
    found[1:n] = steps
    blocks = found.reshape(size, size, 3, 3)
    for k in range(1, size):
        blocks[:, k] = blocks[:, k - 1] @ blocks[:, k]
    for k in range(1, size):
        blocks[k] = blocks[k - 1, -1] @ blocks[k]
    return found[:n]


@dataclass(frozen=True)
class Guess:
    """Values to start from: the model with its unit, J, what is fitted beside it, and γ at the first samples."""

    model: Model
    inertia: Array
    more: Array
    downs: Sequence[Array] = ()
    misfit: float = 0.0  # of the weak form, r.m.s., of the moments that turning by a radian takes


def with_moments(
    stretches: Sequence[tuple[Array, Array]],
    model: Model,
    width: float,
    round_by: float,
    speeds: Sequence[Array | None] = (),
) -> Guess | None:
    """Return what the weak form gives with all that acts on the body, J of trace 1; None where it does not tell.

    `round_by` is how much J costs that is not a sphere, over what it does to the equations. Without that, noise makes
    the moments large that a swing in a plane does not tell, and so all else small beside the trace.
    """
    pivot, wheel, count = model.pivot, model.wheel, len(stretches)
    own = 0 if pivot is None else 3 if pivot.direction is not None else 9
    axes = np.zeros((3, 0)) if wheel is None else np.eye(3) if wheel.axis is None else wheel.axis[:, None]
    spun, rows = own * count + model.damping, []
    for k, ((time, rates), speed) in enumerate(zip(stretches, speeds or repeat(None), strict=False)):
        acting = np.zeros((len(time), 3, spun + axes.shape[1]))
        momenta = np.zeros_like(acting)
        if pivot is not None:
            by = np.einsum("ijk,nlk->nijl", LEVI, turns(time, rates))
            if pivot.direction is not None:
                by = np.einsum("nijl,j->nil", by, pivot.direction)
            acting[:, :, own * k : own * (k + 1)] = by.reshape(len(time), 3, own)
        if model.damping:
            damping = -rates[:, :, None] if model.damping == 1 else -rates[:, :, None] * np.eye(3)
            acting[:, :, spun - model.damping : spun] = damping
        if wheel is not None and speed is not None:
            momenta[:, :, spun:] = wheel.inertia * np.multiply.outer(speed, axes)
            acting[:, :, spun:] = np.cross(momenta[:, :, spun:], rates[:, :, None], axis=1)
        weak = weak_rows(time, rates, width, acting, momenta, haste_of(model, time, rates))
        if model.constraint is not None:  # whose moment is along n
            weak = weak - np.einsum("i,j,mjq->miq", model.constraint, model.constraint, weak)
        rows.append(weak.reshape(-1, 6 + acting.shape[2]))
    every = np.concatenate(rows)
    if len(every) < every.shape[1]:
        return None
    A = np.concatenate([every[:, :6] @ TRACELESS, every[:, 6:]], axis=1)
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    size[:5] = size[:5].max()
    aims = np.concatenate([-every[:, :6] @ SPHERE, np.zeros(5)])
    whole, rcond = np.concatenate([A / size, round_by * np.eye(5, A.shape[1])]), 1e-6 if model.is_free else 1e-4
    w = np.linalg.lstsq(whole, aims, rcond=rcond)[0] / size
    misfit = float(np.sqrt(np.mean((every[:, :6] @ SPHERE + A @ w) ** 2)))
    J = symmetric(SPHERE + TRACELESS @ w[:5])
    arms, damping, momentum = np.split(w[5:], [own * count, spun])  # the latter over the unit
    axis = unit_vector(momentum) if "axis" in model.places else np.zeros(0)
    centre, downs, unit = np.zeros(0), np.zeros((0, 3)), 1.0
    if pivot is None and wheel is not None:
        per_unit = float(np.linalg.norm(momentum)) if len(axis) else float(momentum[0])
        unit = 1 / per_unit if per_unit > 0 else np.nan
    elif pivot is not None:
        if pivot.direction is not None:
            downs = arms.reshape(count, 3)
            arm = float(np.sqrt((downs**2).sum(axis=1).mean()))
        else:
            U, sizes, V = np.linalg.svd(np.concatenate(arms.reshape(count, 3, 3), axis=1))
            sign = np.sign(U[np.argmax(abs(U[:, 0])), 0])  # a choice: both have the same motion
            arm, centre, downs = float(sizes[0] / np.sqrt(count)), sign * U[:, 0], sign * V[0].reshape(count, 3)
        unit = pivot.moment / arm if arm > 0 else np.nan
    if np.isnan(unit):
        return None
    more = np.concatenate([centre, axis, np.ones(int("factor" in model.places)), damping])
    return Guess(replace(model, unit=unit), J, more, [unit_vector(one) for one in downs], misfit)
