"""The kernels of SO(3) against mpmath: errors in ulp of the result, for angles from 1e-300 to π and past it."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from many_digits import EPS, assert_ulps, exact, length, many_digits, ulps  # noqa: F401
from nontwist.geometry import rotations
from refusals import refused_as

ANGLES = [1e-300, 1e-200, 1e-155, 1e-100, 1e-30, 1e-16, 1e-12, 1e-8, 1e-4, 0.01, 0.1, 0.5]
ANGLES += [np.nextafter(1, 0), 1.0, np.nextafter(1, 2), 1.5, np.pi / 2, 2 * np.pi / 3, 2.5, 3.1]
NEAR_PI = [np.pi - gap for gap in (1e-3, 1e-5, 1e-8, 1e-10, 1e-12, 1e-14, 1e-15)]
PAST_PI = [np.pi, np.nextafter(np.pi, 4), 3.2, 4.0, 6.0, 2 * np.pi - 1e-6, 2 * np.pi + 1e-6, 7.0, 20.0, 100.0]
SINGULAR = [2 * np.pi, 4 * np.pi, 200 * np.pi]


def axes():
    rng = np.random.default_rng(11)
    fixed = [
        [1, 0, 0],
        [0, -1, 0],
        [0, 0, 1],
        [1, 1, 1],
        [-1, 1, 0],
        [1, 1e-8, 1e-200],
        [-0.6, 0, 0.8],
        [0.6, -0.5, -0.62],
    ]
    return [n / np.linalg.norm(n) for n in [*map(np.array, fixed), *rng.normal(size=(6, 3))]]


def vectors(angles):
    return np.array([np.zeros(3), *(angle * n for angle in angles for n in axes())])


def mp_hat(w):
    return mp.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def mp_exp(theta):
    """eq-rodrigues, letter by letter."""
    angle, W = mp.norm(theta), mp_hat(theta)
    if not angle:
        return mp.eye(3)
    return mp.eye(3) + mp.sin(angle) / angle * W + (mp.sin(angle / 2) / (angle / 2)) ** 2 / 2 * W * W


def mp_dexp(theta):
    angle, W = mp.norm(theta), mp_hat(theta)
    if not angle:
        return mp.eye(3)
    return mp.eye(3) + (1 - mp.cos(angle)) / angle**2 * W + (angle - mp.sin(angle)) / angle**3 * W * W


def mp_dexp_inverse(theta):
    angle, W = mp.norm(theta), mp_hat(theta)
    if not angle:
        return mp.eye(3)
    return mp.eye(3) - W / 2 + (1 - angle / 2 * mp.cot(angle / 2)) / angle**2 * W * W


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


def test_hat_is_the_cross_product_and_vee_its_inverse():
    rng = np.random.default_rng(0)
    w, a = rng.normal(size=(2, 4, 5, 3))
    np.testing.assert_allclose(np.einsum("...ij,...j->...i", rotations.hat(w), a), np.cross(w, a), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rotations.hat(w), -rotations.hat(w).mT)
    np.testing.assert_array_equal(rotations.vee(rotations.hat(w)), w)
    np.testing.assert_array_equal(rotations.vee(rotations.hat([1e-300, -2.0, 3e300])), [1e-300, -2.0, 3e300])


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
    with mp.workdps(900):
        pairs = [(exact(x), reference(exact(x))) for x in theta]
    got = getattr(rotations, name)(theta)
    assert_ulps(name, [ulps(g, want, size(x, want)) for g, (x, want) in zip(got, pairs, strict=True)], bound)


def test_exp_keeps_the_digits_of_a_small_skew_part():
    for x in vectors(ANGLES[:9]):
        want = mp.sin(mp.norm(exact(x))) / mp.norm(exact(x)) * exact(x) if x.any() else exact(x)
        R = rotations.exp(x)
        assert length(exact(rotations.vee(R / 2 - R.T / 2)) - want) <= 8 * EPS * length(want)
    R = rotations.exp([3e-300, 0.0, -1e-300])
    np.testing.assert_allclose([R[2, 1], R[1, 2], R[1, 0], R[0, 1]], [3e-300, -3e-300, -1e-300, 1e-300], rtol=2 * EPS)


def test_log_against_mpmath():
    errors = []
    for x in vectors(ANGLES + NEAR_PI + PAST_PI + SINGULAR):
        want, got = mp_shortest(exact(x)), rotations.log(rounded(mp_exp(exact(x))))
        if mp.norm(want) > mp.pi - 4 * EPS and mp.fdot(exact(got), want) < 0:
            want *= 1 - 2 * mp.pi / mp.norm(want)  # rounding R has carried it past the half turn
        # whole turns leave a rest that is an ulp of |x|, rounding R to it costs an ulp of R
        errors.append(ulps(got, want, mp.norm(want) if np.linalg.norm(x) < 4 else max(mp.norm(want), 1e-6)))
    assert_ulps("log", errors)


def test_log_of_half_turns():
    for n in axes():
        R = rounded(2 * exact(n) * exact(n).T - mp.eye(3))
        sign = np.sign(n[np.argmax(np.abs(n))])
        assert ulps(rotations.log(R), sign * mp.pi * exact(n) / mp.norm(exact(n)), mp.pi) <= 8
    np.testing.assert_array_equal(rotations.log(np.diag([-1.0, -1.0, 1.0])), [0, 0, np.pi])
    np.testing.assert_allclose(
        rotations.log([[0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.pi * np.array([1, -1, 0]) / 2**0.5
    )


def test_log_takes_every_column_of_the_quaternion():
    # on both sides of every change of the largest component, and where components are equal
    rng = np.random.default_rng(6)
    q = [rng.normal(size=4) for _ in range(40)]
    for i in range(4):
        for j in range(i):
            for nudge in (-1e-15, 0.0, 1e-15):
                p = rng.uniform(-0.3, 0.3, 4)
                p[i], p[j] = 0.7, -0.7 + nudge
                q += [p, np.abs(p)]
    errors = []
    for p in q:
        p = exact(p / np.linalg.norm(p) * (1 if p[0] > 0 else -1))
        v = mp.matrix(p[1:])
        theta = v * (2 * mp.atan2(mp.norm(v), p[0]) / mp.norm(v))
        errors.append(ulps(rotations.log(rounded(mp_exp(theta))), theta, mp.norm(theta)))
    assert_ulps("log, columns", errors)


def test_coefficients_of_small_angles_keep_their_digits():
    # with θ = (a, b, 0) entry (0, 1) is the last coefficient times a b, alone
    for angle in (1e-140, 1e-8, 1e-3, 0.1, 0.5, 0.9, np.nextafter(1, 0), 1.0, np.nextafter(1, 2)):
        theta = [0.6 * angle, 0.8 * angle, 0.0]
        with mp.workdps(700):
            for kernel, reference, bound in (
                (rotations.dexp, mp_dexp, 8),
                (rotations.dexp_inverse, mp_dexp_inverse, 16),
            ):
                want = reference(exact(theta))[0, 1]
                assert abs(mp.mpf(float(kernel(theta)[0, 1])) - want) <= bound * EPS * want


def test_series_have_the_coefficients_of_taylor_and_bernoulli():
    for k, a in enumerate(rotations._DEXP_SERIES):
        assert abs(mp.mpf(float(a)) * mp.factorial(2 * k + 3) * (-1) ** k - 1) <= EPS
    for k, b in enumerate(rotations._INVERSE_SERIES):
        assert abs(mp.mpf(float(b)) * mp.factorial(2 * k + 2) / abs(mp.bernoulli(2 * k + 2)) - 1) <= 2 * EPS


def test_vectors_of_any_length_give_finite_matrices():
    theta = 1e200 * np.array(axes())
    assert rotations.is_rotation(rotations.exp(theta)).all()
    assert rotations.is_rotation(rotations.cayley(theta)).all()
    assert np.isfinite(rotations.dexp(theta)).all()
    assert np.isfinite(rotations.dexp_inverse(1e-190 * theta)).all()


def test_dexp_is_the_derivative_of_exp():
    for theta, rate in zip(
        vectors([0.3, 2.0, np.pi, 5.0])[1::3], np.random.default_rng(9).normal(size=(30, 3)), strict=False
    ):
        x, r, h = exact(theta), exact(rate), mp.mpf(10) ** -20
        derivative = (mp_exp(x + h * r) - mp_exp(x - h * r)) / (2 * h)
        want = rounded(derivative * mp_exp(x).T)
        np.testing.assert_allclose(rotations.hat(rotations.dexp(theta) @ rate), want, rtol=0, atol=4e-15)


def test_cayley_inverse_against_mpmath():
    errors = []
    for x in vectors([*ANGLES, 2.0, 10.0, 1e3, 1e6, 1e12]):
        n2 = mp.norm(exact(x)) ** 2
        R = mp.eye(3) + (mp_hat(exact(x)) + mp_hat(exact(x)) ** 2 / 2) / (1 + n2 / 4)
        errors.append(ulps(rotations.cayley_inverse(rounded(R)), exact(x), mp.norm(exact(x)) * (1 + n2 / 4) ** 0.5))
    assert_ulps("cayley_inverse", errors)


def moving_frame(t):
    """A frame that turns about a fixed axis, with its rate and its angular velocity."""
    rate = np.array([0.4, -0.3, 0.9])
    q = (rotations.exp([0.2, 0.5, -0.1]) @ rotations.exp(np.multiply.outer(t, rate))).mT
    w = rotations.exp([0.2, 0.5, -0.1]) @ rate
    return q, np.cross(w, q), w


def test_darboux_vector_turns_the_triad_and_has_the_form_of_the_paper():
    q, v, w = moving_frame(np.linspace(0, 3, 7))
    d3, d3_dot = q[:, 2], v[:, 2]
    psi_dot = rotations.twist_rate(q, v)
    np.testing.assert_allclose(psi_dot, q[:, 2] @ w, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rotations.darboux_vector(d3, d3_dot, psi_dot), np.tile(w, (7, 1)), rtol=0, atol=1e-15)
    # eq-w_twist
    terms = [-np.einsum("ij,ij->i", q[:, 1], d3_dot), np.einsum("ij,ij->i", q[:, 0], d3_dot), psi_dot]
    other = sum(term[:, None] * q[:, i] for i, term in enumerate(terms))
    np.testing.assert_allclose(rotations.darboux_vector(d3, d3_dot, psi_dot), other, rtol=0, atol=1e-15)


def test_the_frame_of_the_darboux_vector_does_not_twist():
    q, v, _ = moving_frame(np.linspace(0, 3, 7))
    w = rotations.darboux_vector(q[:, 2], v[:, 2])
    untwisted = np.cross(w[:, None], q)
    np.testing.assert_allclose(rotations.twist_rate(q, untwisted), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.einsum("ni,ni->n", untwisted[:, 0], q[:, 1]), 0.0, atol=1e-15)
    np.testing.assert_allclose(untwisted[:, 2], v[:, 2], rtol=0, atol=1e-15)
    dots = np.einsum("nix,njx->nij", untwisted, untwisted)
    np.testing.assert_allclose(dots[:, 2, :2], 0.0, atol=1e-15)
    a = np.einsum("nix,nx->ni", q, v[:, 2])
    np.testing.assert_allclose(dots[:, 0, 1], a[:, 0] * a[:, 1], rtol=0, atol=1e-15)


def test_twisted_triad_is_the_rotated_one_and_its_twist_rate_is_the_derivative_of_the_angle():
    q, v, _ = moving_frame(np.linspace(0, 3, 7))
    psi, psi_dot = np.linspace(-4, 9, 7), 0.7
    got = rotations.twisted_triad(q, psi)
    turned = np.einsum("nij,nkj->nki", rotations.exp(psi[:, None] * q[:, 2]), q)
    np.testing.assert_allclose(got, turned, rtol=0, atol=4e-15)
    w = rotations.darboux_vector(q[:, 2], v[:, 2])
    # the product rule: the non-twisting frame moves on, and the angle turns it, with a quarter turn as derivative
    rate = rotations.twisted_triad(q, psi + np.pi / 2) * psi_dot * [[1], [1], [0]] + np.cross(w[:, None], got)
    np.testing.assert_allclose(rotations.twist_rate(got, rate), psi_dot, rtol=0, atol=1e-15)
    whole = rotations.darboux_vector(q[:, 2], v[:, 2], psi_dot)
    np.testing.assert_allclose(np.cross(whole[:, None], got), rate, rtol=0, atol=2e-15)
    assert rotations.twisted_triad(q[0], psi).shape == (7, 3, 3)


def test_frame_map_takes_the_initial_frame_to_the_frame():
    q, _, _ = moving_frame(np.linspace(0, 3, 7))
    chi = rotations.frame_map(q, q[0])
    assert rotations.is_rotation(chi).all()
    np.testing.assert_allclose(np.einsum("nxy,iy->nix", chi, q[0]), q, rtol=0, atol=1e-15)
    np.testing.assert_allclose(chi[0], np.eye(3), rtol=0, atol=1e-15)


@pytest.mark.parametrize("turns", [1, 2, -3, 100])
def test_dexp_inverse_is_refused_at_whole_turns_with_the_index(turns):
    theta = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2 * np.pi * turns], [0.0, 1.0, 0.0]])
    with pytest.raises(ValueError, match=r"theta\[1\] is a whole turn"):
        rotations.dexp_inverse(theta)
    with pytest.raises(ValueError, match=r"theta\[1\] is a whole turn"):
        rotations.dexp_inverse(theta * (1 + 4 * EPS))
    assert np.isfinite(rotations.dexp_inverse(theta * (1 + 40 * EPS))).all()


def test_cayley_inverse_is_refused_at_half_turns_with_the_index():
    for n in axes():
        with pytest.raises(ValueError, match=r"R\[1\] is a half turn"):
            rotations.cayley_inverse([np.eye(3), rounded(2 * exact(n) * exact(n).T - mp.eye(3))])
        with pytest.raises(ValueError, match=r"R is a half turn"):
            rotations.cayley_inverse(rotations.exp(np.pi * n))
        assert np.isfinite(rotations.cayley_inverse(rotations.exp((np.pi - 4e-15) * n))).all()


def test_leading_axes_may_be_many_or_empty():
    theta = np.random.default_rng(3).normal(size=(2, 3, 3))
    R = rotations.exp(theta)
    assert R.shape == (2, 3, 3, 3)
    for kernel, argument in (
        (rotations.exp, theta),
        (rotations.dexp, theta),
        (rotations.dexp_inverse, theta),
        (rotations.log, R),
    ):
        np.testing.assert_allclose(kernel(argument)[1, 2], kernel(argument[1, 2]), rtol=0, atol=1e-15)
    assert rotations.exp(np.empty((0, 3))).shape == (0, 3, 3)
    assert rotations.log(np.empty((0, 3, 3))).shape == (0, 3)
    assert rotations.dexp_inverse(np.empty((0, 3))).shape == (0, 3, 3)


def test_variations_of_the_velocity_against_mpmath():
    """δW of Λ(t) = exp(a t) exp(b sin t), varied by exp(ι δθ(t)): d/dι of vee(Λᵀ Λ') in 80 digits, by differences."""
    rng, e = np.random.default_rng(8), mp.mpf(10) ** -20
    for _ in range(25):
        a, b, c, f = (exact(x) for x in rng.normal(size=(4, 3)))
        t = mp.mpf(float(rng.uniform(-1, 1)))

        def velocity(iota, t=t, a=a, b=b, c=c, f=f):
            def Lambda(s):
                theta = iota * (mp.sin(2 * s) * c + s**2 * f)
                return mp.expm(mp_hat(theta)) * mp.expm(mp_hat(s * a)) * mp.expm(mp_hat(mp.sin(s) * b))

            A = Lambda(t).T * (Lambda(t + e) - Lambda(t - e)) / (2 * e)
            return mp.matrix([A[2, 1], A[0, 2], A[1, 0]])

        want = (velocity(e) - velocity(-e)) / (2 * e)
        frame = (mp.expm(mp_hat(t * a)) * mp.expm(mp_hat(mp.sin(t) * b))).T
        rate = 2 * mp.cos(2 * t) * c + 2 * t * f
        q = np.array([[float(frame[i, j]) for j in range(3)] for i in range(3)])
        perp, par = rotations.velocity_variation(q, [float(x) for x in rate])
        got = (*perp[:2], float(par))
        assert perp[2] == 0
        assert max(abs(mp.mpf(float(x)) - y) for x, y in zip(got, want, strict=True)) < 20 * EPS * mp.norm(rate)


def test_variations_of_the_velocity_broadcast():
    frames = rotations.exp(np.random.default_rng(2).normal(size=(4, 1, 3)))
    perp, par = rotations.velocity_variation(frames, np.ones((5, 3)))
    assert perp.shape == (4, 5, 3)
    assert par.shape == (4, 5)


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
