"""What docs/errata.md says, where no other test shows it."""

import re
from pathlib import Path

import numpy as np
import pytest

from conftest import PAPER_J
from nontwist import Continuous, nontwisting, pulse, rotations, second_quotient, simulate, standard
from nontwist.analysis import observables as obs
from nontwist.integrators import reference
from nontwist.models.constraints import constraint_matrices
from nontwist.paper.cases import CASES
from nontwist.paper.tables import printed_tables
from nontwist.validation import GROUPS

ROOT = Path(__file__).parents[1]
EM = {"integrator": "energy-momentum", "order": 2}


def test_every_test_that_the_page_names_exists():
    page = (ROOT / "docs" / "errata.md").read_text(encoding="utf-8")
    named, groups = re.findall(r"`(tests/\w+\.py)::(\w+)`", page), re.findall(r"validation\.md#(\w+)", page)
    assert len(named) + len(groups) >= 19
    assert set(groups) <= set(GROUPS)
    for path, name in named:
        assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8"), name


def test_the_impulse_fixes_the_load_of_case_2():
    """Π(1) = peak/2 in the continuous equations; the table has 1/20 of it (to the O(h²) of the scheme)."""
    peak, table = np.array(CASES[2].printed_peak[:2]), np.array(printed_tables()["case2"]["material_momentum"])
    assert peak / 2 == pytest.approx([-1236.25, -537.5])
    assert peak / 2 / table == pytest.approx(20, abs=0.03)
    fine = Continuous(rtol=1e-13, atol=1e-14)
    run = simulate(nontwisting(PAPER_J), times=[0, 1], load=CASES[2].load(), integrator=fine)
    assert run.material_momentum.values[-1, :2] == pytest.approx(peak / 40, abs=1e-8)


def test_rounded_invariants_would_differ_from_the_printed_ones():
    run = simulate(nontwisting(PAPER_J), t_end=1, step=0.005, load=CASES[2].load(), **EM)
    K = float(run.kinetic_energy[-1])
    assert f"{K:.6f}" == "746.591700"
    assert printed_tables()["case2"]["kinetic_energy"] == 746.591699


def test_three_constraints_let_the_directors_stretch():
    body, q, h = standard(PAPER_J), np.eye(3), 0.01
    v = np.cross(np.array([1.0, 2, 3]), q)
    A, none = constraint_matrices(None), reference.MidpointMoment(np.zeros(3), np.zeros(3))
    stretched, kept = (
        reference.step(0, q, v, h, body.euler_inertia, rows, np.zeros((3, 3)), none) for rows in (A[3:], A)
    )
    assert abs(np.linalg.norm(stretched.directors, axis=1) - 1).max() > 1e-4
    assert abs(np.linalg.norm(kept.directors, axis=1) - 1).max() < 1e-15


def test_the_second_quotient_approaches_four_with_the_square_of_the_step():
    def quotient(h):
        kick = {"t_end": 1, "material_angular_velocity": [1.5, 4.5, 0], "load": pulse((-61.8125, -26.875, 0))}
        return float(
            second_quotient(*(simulate(nontwisting(PAPER_J), step=h / k, **kick, **EM) for k in (1, 2, 4)))[-1]
        )

    assert (4 - quotient(0.02)) / (4 - quotient(0.01)) == pytest.approx(4, abs=0.1)


def test_the_second_twisted_director():
    d1, d2, d3 = np.eye(3)
    turned = rotations.exp(0.7 * d3) @ d2
    assert turned == pytest.approx(-np.sin(0.7) * d1 + np.cos(0.7) * d2)
    assert rotations.twisted_triad(np.eye(3), 0.7)[1] == pytest.approx(turned)


def test_the_directors_are_transported_along_d3():
    """The tangential part of d1', which is ∇_{d3'} d1, vanishes for a non-twisting frame."""
    run = simulate(nontwisting(PAPER_J), t_end=1, step=0.01, material_angular_velocity=[1, -2, 0])
    q, v = run.directors.values, run.director_velocities.values
    for i in (0, 1):
        tangential = v[:, i] - np.sum(v[:, i] * q[:, 2], axis=1)[:, None] * q[:, 2]
        assert abs(tangential).max() < 1e-13


def test_the_discrete_variation_for_the_second_momentum():
    """(-d3, 0, d1) tested with π^i is Π2 = d2·π; the printed (-d3, 0, d2) is not."""
    rng = np.random.default_rng(0)
    body = standard(PAPER_J)
    q = rotations.exp(rng.normal(size=3)).T
    v = np.cross(rng.normal(size=3), q)
    p = body.euler_inertia @ v
    Pi2 = q[1] @ obs.spatial_momentum(q, v, body.euler_inertia)
    assert -q[2] @ p[0] + q[0] @ p[2] == pytest.approx(Pi2, abs=1e-14)
    assert abs(-q[2] @ p[0] + q[1] @ p[2] - Pi2) > 0.1
