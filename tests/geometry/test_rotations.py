"""The kernels of SO(3) against mpmath: errors in ulp of the result, for angles from 1e-300 to π and past it."""

from __future__ import annotations

from itertools import product

import mpmath as mp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from many_digits import EPS, assert_ulps, exact, length, many_digits, ulps  # noqa: F401
from nontwist.geometry import rotations
from refusals import refused_as

ANGLES = [1e-300, 1e-155, 1e-30, 1e-12, 1e-8, 1e-4, 0.1, 0.5]
ANGLES += [np.nextafter(1, 0), 1.0, np.nextafter(1, 2), np.pi / 2, 2.5, 3.1]
NEAR_PI = [np.pi - gap for gap in (1e-3, 1e-8, 1e-12, 1e-14, 1e-15)]
PAST_PI = [np.pi, np.nextafter(np.pi, 4), 3.2, 4.0, 6.0, 2 * np.pi - 1e-6, 2 * np.pi + 1e-6, 7.0, 20.0, 100.0]
SINGULAR = [2 * np.pi, 4 * np.pi, 200 * np.pi]


def axes():
    fixed = [[1, 0, 0], [0, -1, 0], [1, 1, 1], [-1, 1, 0], [1, 1e-8, 1e-200], [-0.6, 0, 0.8], [0.6, -0.5, -0.62]]
    return [n / np.linalg.norm(n) for n in [*map(np.array, fixed), *np.random.default_rng(11).normal(size=(3, 3))]]


def vectors(angles):
    return np.array([np.zeros(3), *(angle * n for angle in angles for n in axes())])


def mp_hat(w):
    return mp.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def map_of(first, second):
    """The map I + f(|θ|) θ̂ + g(|θ|) θ̂² of two functions of the angle."""

    def mapped(theta):
        angle, W = mp.norm(theta), mp_hat(theta)
        return mp.eye(3) + first(angle) * W + second(angle) * W * W if angle else mp.eye(3)

    return mapped


mp_exp = map_of(lambda x: mp.sin(x) / x, lambda x: (mp.sin(x / 2) / (x / 2)) ** 2 / 2)  # eq-rodrigues
mp_dexp = map_of(lambda x: (1 - mp.cos(x)) / x**2, lambda x: (x - mp.sin(x)) / x**3)
mp_dexp_inverse = map_of(lambda x: -mp.mpf(1) / 2, lambda x: (1 - x / 2 * mp.cot(x / 2)) / x**2)


def mp_cayley(w):
    half = mp_hat(w) / 2
    return mp.inverse(mp.eye(3) - half) * (mp.eye(3) + half)


def from_whole_turn(theta):
    """|θ| over its distance from the next singular turn, at least 1."""
    angle = mp.norm(theta)
    return max(1, angle / abs(angle - 2 * mp.pi * max(1, mp.nint(angle / (2 * mp.pi)))))


def mp_shortest(theta):
    """The rotation vector of the same rotation with at most half a turn."""
    angle = mp.norm(theta)
    turns = mp.nint(angle / (2 * mp.pi))
    return theta * ((angle - 2 * mp.pi * turns) / angle) if angle else theta


def rounded(M):
    return np.array(M.tolist(), dtype=float)


def test_hat_and_vee():
    w, a = np.random.default_rng(0).normal(size=(2, 4, 5, 3))
    assert_allclose(np.einsum("...ij,...j->...i", rotations.hat(w), a), np.cross(w, a), rtol=0, atol=1e-15)
    assert_array_equal(rotations.hat(w), -rotations.hat(w).mT)
    assert_array_equal(rotations.vee(rotations.hat(w)), w)
    assert_array_equal(rotations.vee(rotations.hat([1e-300, -2.0, 3e300])), [1e-300, -2.0, 3e300])


EVERY, NEXT_TO_TURNS = ANGLES + NEAR_PI + PAST_PI, [2 * np.pi - 1e-3, 2 * np.pi + 1e-9, 4 * np.pi - 1e-12]
CASES = {  # the reference, angles, the size that an ulp is of, and the bound
    "exp": (mp_exp, EVERY + SINGULAR, lambda x, want: max(1, mp.norm(x)), 8),
    "dexp": (mp_dexp, EVERY + SINGULAR, lambda x, want: length(want), 4),
    "dexp_inverse": (mp_dexp_inverse, EVERY + NEXT_TO_TURNS, lambda x, want: length(want) * from_whole_turn(x), 8),
    "cayley": (mp_cayley, [*ANGLES, 2.0, 1e3, 1e8, 1e16, 1e200], lambda x, want: 1, 8),
}


@pytest.mark.parametrize("name", CASES)
def test_against_mpmath(name):
    reference, angles, size, bound = CASES[name]
    theta = vectors(angles)
    pairs = []
    for x in theta:
        with mp.workdps(80 if 1e-5 < abs(x).max() < 1e5 else 900):
            pairs.append((exact(x), reference(exact(x))))
    got = getattr(rotations, name)(theta)
    assert_ulps(name, [ulps(g, want, size(x, want)) for g, (x, want) in zip(got, pairs, strict=True)], bound)
    if name != "dexp_inverse":
        assert_array_equal(getattr(rotations, name)(-theta), got.mT)
    small = name == "dexp_inverse"
    assert np.isfinite(getattr(rotations, name)((1e10 if small else 1e200) * np.array(axes()))).all()


def test_exp_of_small_skew_part():
    for x in vectors(ANGLES[:6])[1:]:
        want = mp.sin(mp.norm(exact(x))) / mp.norm(exact(x)) * exact(x)
        R = rotations.exp(x)
        assert length(exact(rotations.vee(R / 2 - R.T / 2)) - want) <= 8 * EPS * length(want)


def test_logarithms_against_mpmath():
    errors = []
    for x in vectors(ANGLES + NEAR_PI + PAST_PI + SINGULAR):
        want, got = mp_shortest(exact(x)), rotations.log(rounded(mp_exp(exact(x))))
        if mp.norm(want) > mp.pi - 4 * EPS and mp.fdot(exact(got), want) < 0:
            want *= 1 - 2 * mp.pi / mp.norm(want)  # rounding R has carried it past the half turn
        # whole turns leave a rest that is an ulp of |x|, rounding R to it costs an ulp of R
        errors.append(ulps(got, want, mp.norm(want) if np.linalg.norm(x) < 4 else max(mp.norm(want), 1e-6)))
    assert_ulps("log", errors)
    errors = []
    for x in vectors([*ANGLES, 2.0, 10.0, 1e3, 1e6, 1e12]):
        n2, W = mp.norm(exact(x)) ** 2, mp_hat(exact(x))
        got = rotations.cayley_inverse(rounded(mp.eye(3) + (W + W**2 / 2) / (1 + n2 / 4)))
        errors.append(ulps(got, exact(x), mp.norm(exact(x)) * (1 + n2 / 4) ** 0.5))
    assert_ulps("cayley_inverse", errors)


def test_log_of_half_turns():
    for n in axes():
        R = rounded(2 * exact(n) * exact(n).T - mp.eye(3))
        sign = np.sign(n[np.argmax(np.abs(n))])
        assert ulps(rotations.log(R), sign * mp.pi * exact(n) / mp.norm(exact(n)), mp.pi) <= 8
    assert_array_equal(rotations.log(np.diag([-1.0, -1.0, 1.0])), [0, 0, np.pi])


def test_log_of_every_quaternion_column():
    """On both sides of every change of the largest component, and where components are equal."""
    rng, errors = np.random.default_rng(6), []
    q = list(rng.normal(size=(20, 4)))
    for i, j, nudge in product(range(4), range(4), (-1e-15, 0.0, 1e-15)):
        if j < i:
            p = rng.uniform(-0.3, 0.3, 4)
            p[i], p[j] = 0.7, -0.7 + nudge
            q += [p, np.abs(p)]
    for p in q:
        p = exact(p / np.linalg.norm(p) * (1 if p[0] > 0 else -1))
        v = mp.matrix(p[1:])
        theta = v * (2 * mp.atan2(mp.norm(v), p[0]) / mp.norm(v))
        errors.append(ulps(rotations.log(rounded(mp_exp(theta))), theta, mp.norm(theta)))
    assert_ulps("log, columns", errors)


def test_coefficients_at_small_angles():
    """With θ = (a, b, 0) entry (0, 1) is the last coefficient times a b, alone."""
    kernels = (rotations.dexp, mp_dexp, 8), (rotations.dexp_inverse, mp_dexp_inverse, 16)
    for angle in (1e-140, 1e-8, 1e-3, 0.1, 0.5, 0.9, np.nextafter(1, 0), 1.0, np.nextafter(1, 2)):
        theta = [0.6 * angle, 0.8 * angle, 0.0]
        for kernel, reference, bound in kernels:
            with mp.workdps(700):
                want = reference(exact(theta))[0, 1]
                assert abs(mp.mpf(float(kernel(theta)[0, 1])) - want) <= bound * EPS * want


@pytest.fixture(scope="module")
def moving_frame():
    """A frame that turns about a fixed axis, its rate, its angular velocity, and the Darboux vector without twist."""
    rate, start = np.array([0.4, -0.3, 0.9]), rotations.exp([0.2, 0.5, -0.1])
    q = (start @ rotations.exp(np.multiply.outer(np.linspace(0, 3, 7), rate))).mT
    w = start @ rate
    v = np.cross(w, q)
    return q, v, w, rotations.darboux_vector(q[:, 2], v[:, 2])


def test_darboux_vector(moving_frame):
    q, v, w, plain = moving_frame
    psi_dot = rotations.twist_rate(q, v)
    found = rotations.darboux_vector(q[:, 2], v[:, 2], psi_dot)
    close(psi_dot, q[:, 2] @ w)
    close(found, np.tile(w, (7, 1)))
    terms = [-np.sum(q[:, 1] * v[:, 2], axis=1), np.sum(q[:, 0] * v[:, 2], axis=1), psi_dot]  # eq-w_twist
    close(found, sum(term[:, None] * q[:, i] for i, term in enumerate(terms)))
    close(rotations.twist_rate(q, np.cross(plain[:, None], q)), 0)
    chi = rotations.frame_map(q, q[0])
    assert rotations.is_rotation(chi).all()
    close(np.einsum("nxy,iy->nix", chi, q[0]), q)


def test_twisted_triad(moving_frame):
    q, v, _, w = moving_frame
    psi, psi_dot = np.linspace(-4, 9, 7), 0.7
    got = rotations.twisted_triad(q, psi)
    close(got, np.einsum("nij,nkj->nki", rotations.exp(psi[:, None] * q[:, 2]), q), 4e-15)
    # the product rule: the non-twisting frame moves on, and the angle turns it, with a quarter turn as derivative
    rate = rotations.twisted_triad(q, psi + np.pi / 2) * psi_dot * [[1], [1], [0]] + np.cross(w[:, None], got)
    close(rotations.twist_rate(got, rate), psi_dot)
    close(np.cross(rotations.darboux_vector(q[:, 2], v[:, 2], psi_dot)[:, None], got), rate, 2e-15)
    assert_array_equal(got[:, 2], q[:, 2])
    assert rotations.is_rotation(got, tolerance=1e-14).all()
    close(rotations.twisted_triad(got, 3.0), rotations.twisted_triad(q, psi + 3.0), 1e-14)
    assert rotations.twisted_triad(q[0], psi).shape == (7, 3, 3)


def close(got, want, atol=1e-15):
    assert_allclose(got, want, rtol=0, atol=atol)


@pytest.mark.parametrize("turns", [1, -3, 100])
def test_inverses_at_half_turns(turns):
    theta = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2 * np.pi * turns], [0.0, 1.0, 0.0]])
    for scale in (1, 1 + 4 * EPS):
        with pytest.raises(ValueError, match=r"theta\[1\] is a whole turn"):
            rotations.dexp_inverse(theta * scale)
    assert np.isfinite(rotations.dexp_inverse(theta * (1 + 40 * EPS))).all()
    for n in axes():
        with pytest.raises(ValueError, match=r"R\[1\] is a half turn"):
            rotations.cayley_inverse([np.eye(3), rounded(2 * exact(n) * exact(n).T - mp.eye(3))])
        with pytest.raises(ValueError, match=r"R is a half turn"):
            rotations.cayley_inverse(rotations.exp(np.pi * n))
        assert np.isfinite(rotations.cayley_inverse(rotations.exp((np.pi - 4e-15) * n))).all()


def test_leading_axes():
    theta = np.random.default_rng(3).normal(size=(2, 3, 3))
    R = rotations.exp(theta)
    for name, of in (("exp", theta), ("dexp", theta), ("dexp_inverse", theta), ("log", R)):
        kernel = getattr(rotations, name)
        close(kernel(of)[1, 2], kernel(of[1, 2]))
        assert kernel(of[:0]).shape == (0, *kernel(of).shape[1:])
    rate = np.random.default_rng(8).normal(size=(5, 3))
    perp, par = rotations.velocity_variation(R[:, :1], rate)  # of which meaning: nontwist.validation
    close(
        np.einsum("mni,mix->mnx", perp, R[:, 0]) + par[..., None] * R[:, :1, 2],
        np.broadcast_to(rate, perp.shape),
        4e-15,
    )
    assert not perp[..., 2].any()
    assert (R.shape, perp.shape, par.shape) == ((2, 3, 3, 3), (2, 5, 3), (2, 5))


OTHERS = np.array([np.diag([1.0, 1.0, -1.0]), np.eye(3) + 1e-8, 2 * np.eye(3), 1e200 * np.eye(3), np.zeros((3, 3))])
OF_MATRICES = {
    "log": rotations.log,
    "cayley_inverse": rotations.cayley_inverse,
    "twisted_triad": lambda R: rotations.twisted_triad(R, 0.1),
    "frame_map": lambda R: rotations.frame_map(R, np.eye(3)),
    "twist_rate": lambda R: rotations.twist_rate(R, R),
    "velocity_variation": lambda R: rotations.velocity_variation(R, [1, 2, 3]),
}
test_refusals = refused_as(
    {name: lambda f=f: f([np.eye(3), OTHERS[0]]) for name, f in OF_MATRICES.items()}
    | {"vee": lambda: rotations.vee([np.zeros((3, 3)), np.diag([1e-300, 0, 0])])}
)


def test_what_is_no_rotation():
    assert not rotations.is_rotation(OTHERS).any()
    for kernel in (rotations.exp, rotations.cayley):
        assert rotations.is_rotation(kernel(1e200 * np.array(axes()))).all()
