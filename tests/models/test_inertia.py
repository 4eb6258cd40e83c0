"""Inertias against quadrature, closed forms and each other; the principal frame, and bodies turned into it."""

import bz2
import os
import re
import sys
import zipfile
from functools import partial

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conftest import random_inertia
from nontwist import damping, inertia, integrate, nontwisting, rotation, simulate, standard, suslov, twist
from nontwist.inertia import principal_frame
from nontwist.models import mesh
from refusals import refused_as

prove = settings(derandomize=True, max_examples=25, deadline=None)
entry = st.floats(-2, 2, allow_subnormal=False)
vectors = st.tuples(entry, entry, entry).map(np.array)
bodies = st.lists(st.tuples(st.floats(0.1, 2), vectors), min_size=4, max_size=8).filter(
    lambda body: np.linalg.svd(np.array([x for _, x in body]))[1][1] > 0.1
)
rotations = vectors.map(Rotation.from_rotvec)


def moment_of_mass(m, x):
    """J of the points x with masses m, term by term."""
    return sum(mi * (xi @ xi * np.eye(3) - np.outer(xi, xi)) for mi, xi in zip(m, x, strict=True))


def close(got, want, rtol=1e-13):
    np.testing.assert_allclose(got, want, rtol=0, atol=rtol * np.abs(want).max())


# Solids, against quadrature that is exact for polynomials of second degree


def inertia_of(euler):
    """J by the second moments of mass."""
    return np.trace(euler) * np.eye(3) - euler


@pytest.mark.parametrize(("axis", "bore"), [((0, 0, 1), 0.0), ((2, 0, 0), 0.3), ((1, -2, 3), 0.3)])
def test_solids_of_textbooks(axis, bore):
    across = np.eye(3) - (along := np.outer(axis, axis) / np.dot(axis, axis))
    got = inertia.of_cylinder(7, 0.4, 2.0, inner_radius=bore, axis=axis)
    close(got, inertia_of(7 * ((0.4**2 + bore**2) / 4 * across + 2.0**2 / 12 * along)))
    close(inertia.of_cuboid(7.0, (0.5, 2, 3)), inertia_of(7 / 12 * np.diag([0.5, 2, 3]) ** 2))
    close(inertia.of_ellipsoid(7, (1, 2, 0.3)), inertia_of(7 / 5 * np.diag([1, 2, 0.3]) ** 2))


def test_thin_rod():
    J = inertia.of_cuboid(1, (1e-6, 1e-6, 1))
    assert J[2, 2] == pytest.approx(1e-12 / 6, rel=1e-15, abs=0)
    assert inertia.shift([1, 1, 1e-12], 3, (0, 0, 2))[2, 2] == principal_frame([1, 1, 1e-12], "smallest")[0][2] == 1e-12
    n = (0, 3, 4)
    assert n @ inertia.of_cylinder(1, 1e-6, 1, axis=n) @ n / 25 == pytest.approx(5e-13, rel=1e-4, abs=0)


# Points, and the parallel axis theorem


@prove
@given(bodies, vectors)
def test_points(body, about):
    m, x = (np.array(part) for part in zip(*body, strict=True))
    close(inertia.of_points(np.append(m, 0), np.append(x, [[9, 9, 9]], axis=0)), moment_of_mass(m, x))
    centre = m @ x / m.sum()
    at_centre = moment_of_mass(m, x - centre)
    if np.linalg.eigvalsh(at_centre)[0] > 1e-3:
        close(inertia.of_points(m, x, about="centre_of_mass"), at_centre)
        about_point = moment_of_mass(m, x - about)
        close(inertia.of_points(m, x, about), about_point)
        close(inertia.shift(at_centre, m.sum(), centre - about), about_point)
        close(inertia.shift(about_point, m.sum(), about - centre, to_centre_of_mass=True), at_centre, 1e-12)


def test_smallest_inertia():
    """Of denormal numbers digits are lost, and their inverses overflow."""
    J, how = np.array([2, 3, 4]), {"t_end": 2, "step": 0.1, "material_angular_velocity": (0.7, 1.1, 0.9)}
    ends = [integrate(standard(J * c), load=damping(0.1 * c), **how).quaternion[-1] for c in (1.0, 1e-300)]
    np.testing.assert_allclose(*ends, atol=1e-15)
    with pytest.raises(ValueError, match=r"^inertia has the trace 9e-310, which is too small"):
        standard(J * 1e-310)


@pytest.mark.parametrize("seed", range(3))
def test_points_on_a_slanted_line(seed):
    """Whatever round-off would leave of the moment about the line."""
    rng = np.random.default_rng(seed)
    n, s, m = rng.normal(size=3), rng.normal(size=20), rng.uniform(0.1, 1, 20)
    beside = inertia.of_points(m, np.outer(s, n) + rng.normal(size=3), about="centre_of_mass")
    for J in (inertia.of_points(m, np.outer(s, n)), beside):
        assert abs(suslov(J, n).inertia @ n).max() < 1e-14 * np.trace(J)
        for size in 10.0 ** np.arange(-9, 12):
            with pytest.raises(ValueError, match="inertia is not positive definite"):
                standard(size * J)
    assert np.linalg.eigvalsh(inertia.of_points(np.ones(20), np.outer(s, n), about=(1, 2, 3)))[0] > 0.01


# Meshes


def box(lengths=(1, 1, 1), corner=(0, 0, 0)):
    """Twelve faces, counter-clockwise seen from outside."""
    x = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return np.array(corner) + x * lengths, np.array([q[:3] for q in quads] + [[q[0], *q[2:]] for q in quads])


def together(one, other):
    return np.concatenate([one[0], other[0]]), np.concatenate([one[1], other[1] + len(one[0])])


def inverted(mesh):
    return mesh[0], mesh[1][:, ::-1]


L_SHAPE = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2]])


def l_shaped_part(height=0.5):
    """The L, non-convex, extruded along z."""
    top = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    side = [[(i, j, j + 6), (i, j + 6, i + 6)] for i, j in zip(range(6), [1, 2, 3, 4, 5, 0], strict=True)]
    x = np.concatenate([np.c_[L_SHAPE, np.zeros(6)], np.c_[L_SHAPE, np.full(6, height)]])
    return x, np.concatenate([top[:, ::-1], top + 6, np.reshape(side, (-1, 3))])


def sum_of_cuboids(*parts):
    """Mass, centre and inertia about it of cuboids (density, lengths, centre); a density may be negative."""
    m = np.array([density * np.prod(lengths) for density, lengths, _ in parts])
    x = np.array([centre for *_, centre in parts], dtype=float)
    c = m @ x / m.sum()
    own = sum(mi * inertia.of_cuboid(1, lengths) for mi, (_, lengths, _) in zip(m, parts, strict=True))
    return m.sum(), c, own + moment_of_mass(m, x - c)


CUBE, FACES = box()
SOLIDS = {
    "box": (box((1, 2, 3), (5, -7, 0.1)), [(2, (1, 2, 3), (5.5, -6, 1.6))]),
    "plate": (box((1, 2, 1e-7)), [(2, (1, 2, 1e-7), (0.5, 1, 5e-8))]),
    "not convex": (l_shaped_part(), [(2, (3, 1, 0.5), (1.5, 0.5, 0.25)), (2, (1, 1, 0.5), (0.5, 1.5, 0.25))]),
    "a vertex that no face uses": (
        (np.append(CUBE, [[1e20, 0, 0]], axis=0), FACES),
        [(2, (1, 1, 1), (0.5, 0.5, 0.5))],
    ),
    "two bodies that share a face": (together(box(), box(corner=(1, 0, 0))), [(2, (2, 1, 1), (1, 0.5, 0.5))]),
    "two bodies that touch in an edge": (
        together(box(), box((1, 2, 1), corner=(1, 1, 0))),
        [(2, (1, 1, 1), (0.5, 0.5, 0.5)), (2, (1, 2, 1), (1.5, 2, 0.5))],
    ),
    "hollow": (  # and less than a cubic metre
        together(box((0.5, 0.5, 0.5)), inverted(box((0.125, 0.25, 0.125), (0.125, 0.125, 0.25)))),
        [(2, (0.5, 0.5, 0.5), (0.25, 0.25, 0.25)), (-2, (0.125, 0.25, 0.125), (0.1875, 0.25, 0.3125))],
    ),
}


@pytest.mark.parametrize("case", SOLIDS)
def test_mesh_of_a_solid(case):
    mesh, parts = SOLIDS[case]
    mass, centre, J = sum_of_cuboids(*parts)
    got = inertia.of_mesh(*mesh, density=2)
    assert got.mass == pytest.approx(mass, rel=1e-14)
    close(got.centre_of_mass, centre, 1e-14)
    close(got.inertia, J, 1e-14)
    assert np.array_equal(got.inertia, got.inertia.T)
    weighed = inertia.of_mesh(*mesh, mass=mass)
    assert weighed.mass == mass
    close(weighed.inertia, J, 1e-14)


def test_body_far_from_its_origin():
    x, f = l_shaped_part()
    here, there = inertia.of_mesh(x, f, density=1), inertia.of_mesh(x + 2.0**30, f, density=1)
    close(there.inertia, here.inertia, 1e-14)
    assert there.centre_of_mass - 2.0**30 == pytest.approx(here.centre_of_mass, abs=1e-6)


@prove
@given(rotations, vectors)
def test_a_turned_and_shifted_mesh(R, shift):
    x, f = l_shaped_part()
    (mass, centre, J), moved = inertia.of_mesh(x, f, density=1), inertia.of_mesh(R.apply(x) + shift, f, density=1)
    assert moved.mass == pytest.approx(mass, rel=1e-14)
    close(moved.centre_of_mass, R.apply(centre) + shift, 1e-12)
    close(moved.inertia, R.as_matrix() @ J @ R.as_matrix().T, 1e-13)


@pytest.mark.parametrize("suffix", ["stl", "glb"])
def test_a_file_in_millimetres(tmp_path, suffix):
    path, (x, f) = tmp_path / f"part.{suffix}", l_shaped_part()
    trimesh.Trimesh(1000 * x, f, process=False).export(path)
    got, want = inertia.of_mesh(path, density=2, scale=1e-3), inertia.of_mesh(x, f, density=2)
    assert got.mass == pytest.approx(want.mass, rel=1e-14)
    close(got.inertia, want.inertia, 1e-14)
    close(inertia.of_mesh(str(path), mass=want.mass).inertia, 1e6 * want.inertia)


def test_a_file_without_trimesh(tmp_path, monkeypatch):
    path = tmp_path / "part.stl"
    path.touch()
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match=re.escape("which is not installed: pip install trimesh")):
        inertia.of_mesh(path, density=1)
    assert inertia.of_mesh(*box(), density=1).mass == pytest.approx(1)


@pytest.mark.parametrize("suffix", ["zip", "stl.bz2"])
def test_packed_file_size(tmp_path, monkeypatch, suffix):
    plain, path = tmp_path / "part.stl", tmp_path / f"part.{suffix}"
    trimesh.Trimesh(*l_shaped_part(), process=False).export(plain)
    path.write_bytes(bz2.compress(plain.read_bytes()))
    if suffix == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(plain, "part.stl")
    size = plain.stat().st_size
    monkeypatch.setattr(mesh, "UNPACKED", size - 1)
    monkeypatch.setattr(trimesh, "load_mesh", None)
    message = f"{path} unpacks to more than {(size - 1) / 1e6:g} MB ({size / 1e6:.3g} MB); unpack it, and name the mesh"
    with pytest.raises(ValueError, match=re.escape(message)):
        inertia.of_mesh(path, density=1)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs here")
def test_a_fifo_is_no_mesh(tmp_path):
    os.mkfifo(tmp_path / "part.stl")
    with pytest.raises(OSError, match=r"part\.stl is not a regular file \(a folder, a FIFO, a device\); copy the mesh"):
        inertia.of_mesh(tmp_path / "part.stl", density=1)


# What is refused


BROKEN = {
    "open": (CUBE * (1, 2, 3), FACES[1:]),
    "turned": (CUBE, np.append(FACES[:1, ::-1], FACES[1:], axis=0)),
    "inside out": inverted(box((1, 2, 3))),
    "a part inside out": together(box((9, 1, 1)), inverted(box((1, 2, 3), (0, 5, 0)))),
    "flat": box((1, 2, 0)),
    "nothing but a cavity": together(box(), inverted(box())),
    "twice": together(box(), box()),
    "faces missing": (np.eye(3),),
    "counted from 1": (CUBE, FACES + 1),
    "half an index": (np.eye(3), [[0, 1, 1.5]]),
}
test_refused_with_reason_and_number = refused_as(
    {
        "too small a mesh": lambda: inertia.of_mesh(*box(), mass=1, scale=1e-100),
        "too large a mesh": lambda: inertia.of_mesh(*box(), mass=1, scale=1e70),
        "too small a mass": lambda: inertia.of_mesh(*box(), mass=1e-250, scale=1e-50),
        "one point": lambda: inertia.of_points([1, 2], np.ones((2, 3)), about=(1, 1, 1)),
        "bore": lambda: inertia.of_cylinder(1, 1, 1, inner_radius=1),
        "shift too far": lambda: inertia.shift([1, 1, 1], 2, (0, 0, 1), to_centre_of_mass=True),
        "shift that leaves nothing": lambda: inertia.shift([1, 1, 1e-12], 1, (0, 0, 1), to_centre_of_mass=True),
        "neither": lambda: inertia.of_mesh(*box()),
        "both": lambda: inertia.of_mesh(*box(), density=1, mass=1),
        **{name: partial(inertia.of_mesh, *given, density=1) for name, given in BROKEN.items()},
    }
)


def test_files_that_hold_no_mesh(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*gone\.stl"):
        inertia.of_mesh(tmp_path / "gone.stl", density=1)
    for name, text, message in (
        ("part.foo", "x", "trimesh cannot read a mesh from .*part.foo: file_type 'foo' not supported"),
        ("part.ply", "ply\nformat ascii 1.0\n", "trimesh cannot read a mesh from .*part.ply"),
        ("part.stl", "garbage", "part.stl contains no triangles"),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            inertia.of_mesh(tmp_path / name, density=1)
    with pytest.raises(ValueError, match="a file brings its own faces; leave faces out"):
        inertia.of_mesh(tmp_path / "part.stl", [[0, 1, 2]], density=1)


# The principal frame

THIRD = ["smallest", "middle", "largest"]
moments = st.sampled_from(
    [(3, 4, 5), (1, 1, 1), (1, 1, 1.5), (1, 2, 2), (1, 1, 2), (1, 1 + 1e-15, 1.3), (1, 1.0001, 2)]
)
wishes = st.one_of(st.sampled_from(THIRD), vectors.filter(lambda n: np.linalg.norm(n) > 0.1))


@prove
@given(moments, rotations, wishes, st.integers(0, 1000))
def test_principal_frame(true, R0, third, seed):
    """And round-off does not turn it."""
    J = R0.as_matrix() @ np.diag(true) @ R0.as_matrix().T
    values, R = principal_frame(J, third)
    close(R.T @ R, np.eye(3), 4e-15)
    assert np.linalg.det(R) == pytest.approx(1, abs=4e-15)
    close(R @ np.diag(values) @ R.T, J, 4e-15)
    close(np.sort(values), true, 4e-15)
    assert values[0] <= values[1] * (1 + 1e-12)
    if isinstance(third, str):
        assert values[2] == pytest.approx(true[THIRD.index(third)], rel=4e-15)
    else:
        nearest = [np.linalg.norm(third @ R0.as_matrix()[:, np.isclose(true, v, rtol=1e-12)]) for v in true]
        assert third @ R[:, 2] == pytest.approx(max(nearest), abs=1e-9)
    noise = 1e-15 * np.random.default_rng(seed).normal(size=(3, 3))
    assert abs(R - principal_frame(J + noise + noise.T, third)[1]).max() < 1e-6


FRAMES = [
    ((3, 4, 5), "smallest", "+y+z+x"),
    ((3, 4, 5), "middle", "+x-z+y"),
    ((5, 4, 3), "largest", "+z-y+x"),
    ((3, 4, 5), (0, 1, 1), "+x+y+z"),
    ((1, 1, 1), "smallest", "+x+y+z"),
    ((1, 2, 2), "largest", "+x+y+z"),
    ((2, 2, 1), (0, 0, -1), "+x-y-z"),
]


@pytest.mark.parametrize(("J", "third", "axes"), FRAMES)
def test_frames_of_diagonal_inertias(J, third, axes):
    values, R = principal_frame(J, third)
    assert np.array_equal(R, np.eye(3)[["xyz".index(a) for a in axes[1::2]]].T * [int(s + "1") for s in axes[::2]]), R
    assert np.array_equal(values, [J["xyz".index(a)] for a in axes[1::2]])
    assert not np.signbit(R[R == 0]).any()


def test_nontwisting_about_principal_axes():
    """Turned into the principal frame; against the Suslov body blocked about the same axis, in the former axes."""
    J = random_inertia(np.random.default_rng(8))
    values, R = principal_frame(J, "middle")
    start = {"t_end": 2, "step": 0.01, "project": True}
    run = simulate(nontwisting(values), rotation=R, material_angular_velocity=R.T @ [0.5, 1, 2], **start)
    assert abs(run.twist_rate).max() < 1e-14
    assert abs(twist(run).twist_angle).max() < 1e-12
    blocked = simulate(suslov(J, R[:, 2]), material_angular_velocity=[0.5, 1, 2], **start)
    former = rotation(run) * Rotation.from_matrix(R).inv()
    assert (former.inv() * rotation(blocked)).magnitude().max() < 1e-13
    assert (former[-1] * former[0].inv()).magnitude() > 1
