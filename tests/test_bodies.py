import json
import re

import numpy as np
import pytest

from conftest import PAPER_J, random_inertia
from nontwist import DirectorSystem, heavy_top, inertia, nontwisting, standard, suslov, with_gravity
from nontwist.inertia import convected_inertia, euler_inertia
from nontwist.split_form import split_inertia
from refusals import refused_as


def test_euler_inertia_of_the_paper():
    assert euler_inertia(PAPER_J) == pytest.approx(np.array([[3, 1 / 7, 0], [1 / 7, 2, 0], [0, 0, 1]]), abs=1e-15)


def test_euler_inertia_is_the_second_moment_of_mass():
    rng = np.random.default_rng(1)
    x, m = rng.normal(size=(50, 3)), rng.uniform(0.1, 1, 50)
    J = sum(mi * (xi @ xi * np.eye(3) - np.outer(xi, xi)) for mi, xi in zip(m, x, strict=True))
    assert euler_inertia(J) == pytest.approx((x.T * m) @ x, rel=1e-13, abs=1e-13)


def test_inertias_are_inverse_to_each_other():
    J = random_inertia(np.random.default_rng(2))
    assert convected_inertia(euler_inertia(J)) == pytest.approx(J, rel=1e-15, abs=1e-15)


def test_split_of_the_inertia():
    J_perp, J_par = split_inertia(PAPER_J)
    assert J_par == 5
    assert np.array_equal(J_perp + J_par * np.outer([0, 0, 1], [0, 0, 1]), PAPER_J)
    assert np.array_equal(J_perp @ [0, 0, 1], np.zeros(3))
    with pytest.raises(ValueError, match=re.escape("J[0,2] = 0.6")):
        split_inertia([[3, 0, 0.6], [0, 4, 0], [0.6, 0, 5]])


test_refused_with_reason_and_number = refused_as(
    {
        "shape": lambda: standard([[1, 2], [2, 1]]),
        "asymmetric": lambda: standard([[3, 0.1, 0], [0.2, 4, 0], [0, 0, 5]]),
        "indefinite": lambda: standard([1, 2, -1]),
        "rod of no thickness": lambda: standard([1, 1, 0]),
        "rod with a spin": lambda: nontwisting([1, 1, 0], spin=2.0),
        "triangle": lambda: standard([1, 1, 3]),
        "D3": lambda: nontwisting([[3, 0, 0.6], [0, 4, 0], [0.6, 0, 5]]),
        "axis zero": lambda: suslov([1, 1, 1], [0, 0, 0]),
        "inertia of the centre of mass": lambda: heavy_top([1, 1, 1], 5, [0, 0, 1]),
    }
)


def test_plates_and_thin_rods_are_bodies():
    assert np.linalg.eigvalsh(standard([1, 1, 2]).euler_inertia)[0] == 0
    assert np.linalg.eigvalsh(standard([1, 1, 1e-9]).euler_inertia)[0] == pytest.approx(5e-10)
    tiny = standard([1, 1, 2 + 3e-9]).euler_inertia
    assert np.diag(tiny) == pytest.approx([1 + 1.5e-9, 1 + 1.5e-9, 0], abs=1e-15)
    with pytest.raises(ValueError, match="triangle"):
        standard([1, 1, 2 + 1e-8])


@pytest.mark.parametrize("asymmetry", [1e-13, 1e-11])
def test_symmetry_is_asked_to_1e_12(asymmetry):
    J = PAPER_J.copy()
    J[0, 1] += 5 * asymmetry
    if asymmetry < 1e-12:
        assert np.array_equal(standard(J).euler_inertia, standard(J).euler_inertia.T)
    else:
        with pytest.raises(ValueError, match="not symmetric"):
            standard(J)


def test_a_nearly_principal_direction_is_made_principal():
    J = PAPER_J.copy()
    J[0, 2] = J[2, 0] = 1e-10
    assert nontwisting(J).euler_inertia[0, 2] == 0


def test_suslov_normalises_its_axis():
    assert suslov(PAPER_J, [0, 3, 4]).axis == pytest.approx([0, 0.6, 0.8], abs=1e-16)


def test_a_system_is_frozen():
    body = standard(PAPER_J)
    with pytest.raises(AttributeError):
        body.axis = None
    with pytest.raises(ValueError, match="read-only"):
        body.euler_inertia[0, 0] = 1


def test_gravity_adds_to_every_body():
    body = with_gravity(suslov(PAPER_J, [0, 0, 1]), 0.5, [0, 0.1, 0.2], (0, 0, -10))
    assert body.dead_force == pytest.approx(np.array([[0, 0, 0], [0, 0, -0.5], [0, 0, -1.0]]))
    assert body.axis is not None


def test_json_round_trip_is_exact():
    body = heavy_top(random_inertia(np.random.default_rng(3)), 0.01, [0.1, 0.2, 0.3])
    copy = DirectorSystem.from_json(body.to_json())
    assert np.array_equal(copy.euler_inertia, body.euler_inertia)
    assert np.array_equal(copy.dead_force, body.dead_force)
    assert copy.axis is None
    assert copy.name == body.name == json.loads(body.to_json())["name"]


@pytest.mark.parametrize("size", [1e-161, 1e-200, 1e90, 3.0])
def test_an_axis_of_any_length_becomes_a_unit_vector(size):
    assert suslov([2, 3, 4], np.array([0.36, 0.48, 0.8]) * size).axis == pytest.approx([0.36, 0.48, 0.8], rel=1e-15)


def test_a_body_is_short_to_show_and_has_its_inertia():
    body = with_gravity(nontwisting(PAPER_J), 2.0, [0, 0, 0.1])
    rows = "[(3, −0.1429, 0), (−0.1429, 4, 0), (0, 0, 5)] kg m²"
    assert repr(body) == f"<DirectorSystem 'nontwisting under gravity': inertia {rows}, axis (0, 0, 1), dead forces>"
    assert np.array_equal(body.inertia, body.convected_inertia)
    stack = DirectorSystem.stack([standard([3, 4, 5])] * 1000)
    assert repr(stack) == "<SystemStack 'standard': 1000 bodies, the first of inertia diag(3, 4, 5) kg m²>"
    assert np.array_equal(stack.inertia, stack.convected_inertia)


def test_axes_have_letters():
    assert np.array_equal(suslov([3, 4, 5], "-y").axis, [0, -1, 0])
    assert np.array_equal(inertia.of_cylinder(1, 2, 3, axis="x"), inertia.of_cylinder(1, 2, 3, axis=(1, 0, 0)))
    with pytest.raises(ValueError, match=r"^axis must be x, y or z, with a minus or without, or 3 numbers; got 'w'$"):
        suslov([3, 4, 5], "w")
