"""What docs/errata.md says, where no other test shows it."""

import re
from pathlib import Path

import numpy as np
import pytest

from conftest import PAPER_J
from nontwist import integrate, nontwisting, rotation, rotations, simulate, standard
from nontwist.analysis import variables as obs
from nontwist.models.equations import constraint_matrices
from nontwist.paper.tables import CASES, printed_tables
from nontwist.validation import GROUPS
from nontwist.validation import compiled_steps as reference

ROOT = Path(__file__).parents[2]
EM = {"integrator": "energy-momentum", "order": 2}


def test_named_tests_exist():
    page = (ROOT / "docs" / "errata.md").read_text(encoding="utf-8")
    named, groups = re.findall(r"`(tests/\w+/\w+\.py)::(\w+)`", page), re.findall(r"\[validation, (\w+)\]", page)
    assert len(named) + len(groups) >= 19
    assert set(groups) <= set(GROUPS)
    for path, name in named:
        assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8"), name


def test_rounded_invariants():
    run = simulate(nontwisting(PAPER_J), t_end=1, step=0.005, load=CASES[2].load(), **EM)
    K = float(run.kinetic_energy[-1])
    assert f"{K:.6f}" == "746.591700"
    assert printed_tables()["case2"]["kinetic_energy"] == 746.591699


def test_three_constraints():
    body, q, h = standard(PAPER_J), np.eye(3), 0.01
    v = np.cross(np.array([1.0, 2, 3]), q)
    A, none = constraint_matrices(None), reference.MidpointLoad(np.zeros(3), np.zeros(3))
    stretched, kept = (
        reference.director_step(q, v, h, body.euler_inertia, rows, np.zeros((3, 3)), none) for rows in (A[3:], A)
    )
    assert abs(np.linalg.norm(stretched.directors, axis=1) - 1).max() > 1e-4
    assert abs(np.linalg.norm(kept.directors, axis=1) - 1).max() < 1e-15


def test_the_second_twisted_director():
    d1, d2, d3 = np.eye(3)
    turned = rotations.exp(0.7 * d3) @ d2
    assert turned == pytest.approx(-np.sin(0.7) * d1 + np.cos(0.7) * d2)
    assert rotations.twisted_triad(np.eye(3), 0.7)[1] == pytest.approx(turned)


def test_second_momentum_variation():
    """(-d3, 0, d1) tested with π^i is Π2 = d2·π; the printed (-d3, 0, d2) is not."""
    rng = np.random.default_rng(0)
    body = standard(PAPER_J)
    q = rotations.exp(rng.normal(size=3)).T
    v = np.cross(rng.normal(size=3), q)
    p = body.euler_inertia @ v
    Pi2 = q[1] @ obs.spatial_momentum(q, v, body.euler_inertia)
    assert -q[2] @ p[0] + q[0] @ p[2] == pytest.approx(Pi2, abs=1e-14)
    assert abs(-q[2] @ p[0] + q[1] @ p[2] - Pi2) > 0.1


def test_product_of_rates():
    """d1'·d2' = (d1·d3')(d2·d3') is minus the product of the velocities W1 W2, and depends on the choice of d1."""
    rng = np.random.default_rng(1)
    q = rotations.exp(rng.normal(size=3))
    d3_dot = np.cross(rng.normal(size=3), q[2])
    w = rotations.darboux_vector(q[2], d3_dot)
    v, W = np.cross(w, q), q @ w
    assert v[2] == pytest.approx(d3_dot, abs=1e-13)
    assert q @ w == pytest.approx([-q[1] @ d3_dot, q[0] @ d3_dot, 0], abs=1e-13)
    assert v[0] @ v[1] == pytest.approx((q[0] @ v[2]) * (q[1] @ v[2]), abs=1e-13)
    assert v[0] @ v[1] == pytest.approx(-W[0] * W[1], abs=1e-13)
    turned = np.cross(w, rotations.twisted_triad(q, np.pi / 4))  # another non-twisting frame of the same d3
    assert turned[0] @ turned[1] == pytest.approx((W[0] ** 2 - W[1] ** 2) / 2, abs=1e-13)


def test_left_handed_triads():
    """The set Q of the directors is O(3), not SO(3); a motion stays on its side, as det is continuous."""
    mirrored = np.diag([1.0, 1, -1])
    A = constraint_matrices(None)
    assert [float(np.sum((a @ mirrored) * mirrored) - np.sum((a @ np.eye(3)) * np.eye(3))) for a in A] == [0] * 6
    with pytest.raises(ValueError, match="left-handed"):
        rotation(mirrored)
    body, none = standard(PAPER_J), reference.MidpointLoad(np.zeros(3), np.zeros(3))
    v = np.cross([1.0, 2, 3], mirrored)
    step = reference.director_step(mirrored, v, 0.01, body.euler_inertia, A, np.zeros((3, 3)), none)
    assert np.linalg.det(step.directors.astype(float)) == pytest.approx(-1, abs=1e-14)


def varied(a, b, c, f, iota, t):
    """The motion exp(ι δθ(t)) Λ(t) with δθ = c sin 2t + f t², its rate by central differences, and δθ, δθ'."""
    e = 1e-3

    def attitude(t):
        still = rotations.exp(a + b * np.sin(t)) @ rotations.exp(c * t)
        return rotations.exp(iota * (c * np.sin(2 * t) + f * t**2)) @ still

    rate = sum(k * attitude(t + j * e) for k, j in ((1, -2), (-8, -1), (8, 1), (-1, 2))) / (12 * e)
    return attitude(t), rate, c * np.sin(2 * t) + f * t**2, 2 * c * np.cos(2 * t) + 2 * f * t


def test_rate_of_a_varied_motion():
    """eq-d-lambdaprime lacks it in the first; at ι = 0, where eq-var-lambdaprime needs it, both agree."""
    given = np.random.default_rng(2).normal(size=(4, 3))
    still, still_rate, theta, theta_dot = varied(*given, 0.0, 0.4)
    _, rate, *_ = varied(*given, 0.5, 0.4)
    turn, spin = rotations.exp(theta / 2), rotations.hat(rotations.dexp(theta / 2) @ theta_dot / 2)
    assert rate == pytest.approx(spin @ turn @ still + turn @ still_rate, abs=1e-9)
    assert abs(rate - (spin @ still + turn @ still_rate)).max() > 0.05
    e = 1e-4
    forth, back = varied(*given, e, 0.4), varied(*given, -e, 0.4)
    assert (forth[0] - back[0]) / (2 * e) == pytest.approx(rotations.hat(theta) @ still, abs=1e-6)
    variation = rotations.hat(theta_dot) @ still + rotations.hat(theta) @ still_rate
    assert (forth[1] - back[1]) / (2 * e) == pytest.approx(variation, abs=1e-6)


def test_variations_in_the_proof():
    """Line by line (eq-str-proof-0, eq-str-proof-2, eq-str-proof-3) with the vector δθ' in the place of its hat."""
    given = np.random.default_rng(3).normal(size=(4, 3))
    R, R_dot, theta, theta_dot = varied(*given, 0.0, 0.4)
    W = rotations.vee((R.T @ R_dot - R_dot.T @ R) / 2)
    D3, q, v = np.eye(3)[2], R.T, R_dot.T
    assert np.cross(D3, R.T @ v[2]) == pytest.approx([*W[:2], 0], abs=1e-10)
    assert q[1] @ v[0] == pytest.approx(W[2], abs=1e-10)
    delta = rotations.hat(theta) @ R
    delta_dot = rotations.hat(theta_dot) @ R + rotations.hat(theta) @ R_dot
    second = np.cross(D3, delta.T @ R_dot @ D3 + R.T @ delta_dot @ D3)
    third = R.T @ np.cross(q[2], np.cross(theta_dot, q[2]))
    perp, par = rotations.velocity_variation(q, theta_dot)
    assert second == pytest.approx(third, abs=1e-12)
    assert third == pytest.approx(perp, abs=1e-12)
    assert delta[:, 1] @ R_dot[:, 0] + q[1] @ delta_dot[:, 0] == pytest.approx(float(par), abs=1e-12)
    double = np.cross(rotations.hat(theta_dot), q[2])  # a matrix: no vector of the tangent plane
    assert double.shape == (3, 3)


def test_discrete_variations_have_all_blocks():
    """Nine numbers δq and six δλ; tested with (0, d3, -d2) the free step gives eq-discrete-nonholonomic-1."""
    body, h = nontwisting(PAPER_J), 0.005
    run = integrate(body, t_end=10 * h, step=h, material_angular_velocity=(6, -18, 0), **EM)
    q, p = run.directors, body.euler_inertia @ run.director_velocities
    middle, change = (q[1:] + q[:-1]) / 2, p[1:] - p[:-1]
    zero = np.zeros_like(middle[:, 0])
    for blocks in ((zero, middle[:, 2], -middle[:, 1]), (-middle[:, 2], zero, middle[:, 0])):
        variation = np.stack(blocks, axis=1)
        assert variation.shape == change.shape
        assert abs(np.sum(variation * change, axis=(1, 2))).max() < 1e-11
    wrong = np.stack((zero, middle[:, 1], middle[:, 2]), axis=1)
    assert abs(np.sum(wrong * change, axis=(1, 2))).max() > 1


def test_sign_in_the_proof():
    """The lines under eq-discrete-nonholonomic-1, on parabolas d(t) and p(t): of d' with a minus, not a plus."""
    a, b, c, p, p_dot = np.random.default_rng(4).normal(size=(5, 3))
    errors = {sign: [] for sign in (-1, 1)}
    for h in (1e-3, 5e-4):
        d, d_dot, after = a + b * h + c * h**2, b + 2 * c * h, p + p_dot * h + c * h**2
        left = a @ after - d @ p - (d @ after - a @ p)
        for sign, found in errors.items():
            found.append(abs(left - sign * h * (b @ after + d_dot @ p)))
    assert np.log2(errors[-1][0] / errors[-1][1]) == pytest.approx(3, abs=0.1)  # better than the O(h²) of the paper
    assert np.log2(errors[1][0] / errors[1][1]) == pytest.approx(1, abs=0.1)
