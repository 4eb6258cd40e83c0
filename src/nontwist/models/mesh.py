"""Mass, centre of mass and inertia of a body given by its surface, a closed mesh of triangles.

Each triangle (a, b, c), counter-clockwise seen from outside, spans with the origin a tetrahedron of signed volume

    V = a·(b × c)/6 = a·((b - a) × (c - a))/6,        ∫ x dV = V s/4,        ∫ x ⊗ x dV = V/20 (aaᵀ + bbᵀ + ccᵀ + ssᵀ),

s = a + b + c. By the divergence theorem the sums over the surface are the integrals over the enclosed body, exactly,
whatever the origin, when the surface has no boundary: every edge is run through equally often in both directions. The
origin is put at the mean vertex, so that a body far from the origin of its file loses no digits. A surface turned
inwards inside another subtracts its volume: a cavity. The Euler inertia is the density times the second integral,
about the centre of mass less ``m c ⊗ c``.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import Array, as_array, as_positive, refuse
from ..machine import library
from .system import convected_inertia

Indices = NDArray[np.int64]
NO_VOLUME = 1e-13  # of surface times size: below it is round-off
TINY = 1e-300
SMALLEST, LARGEST = 1e-60, 1e60  # m: fifth powers of sizes are floats
UNPACKED = 200_000_000  # bytes that a packed file may unpack to; they take three times as much memory


class MassProperties(NamedTuple):
    """Mass, centre of mass and inertia, returned by `of_mesh`.

    Examples
    --------
    >>> from nontwist import inertia
    >>> vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> body = inertia.of_mesh(vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], mass=6)
    >>> body.mass, body.centre_of_mass.round(6)
    (6.0, array([0.25, 0.25, 0.25]))
    >>> body.inertia.diagonal().round(6)
    array([0.45, 0.45, 0.45])
    """

    mass: float  #: kg
    centre_of_mass: Array  #: (3,), m, in the axes of the mesh
    inertia: Array  #: (3, 3), kg m², convected inertia J about the centre of mass, in the axes of the mesh


def of_mesh(
    vertices: ArrayLike | str | os.PathLike[str],
    faces: ArrayLike | None = None,
    *,
    density: float | None = None,
    mass: float | None = None,
    scale: float = 1.0,
) -> MassProperties:
    """Return the exact mass, centre of mass and inertia of a body of uniform density with the given surface.

    Parameters
    ----------
    vertices : (n, 3) array, or path of a file
        Vertices of the surface, in m (see `scale`). Coincident vertices are merged. A file (STL, OBJ, PLY, OFF, GLB,
        ...) is read by trimesh: ``pip install trimesh``.
    faces : (k, 3) array of int
        Three vertices each, counter-clockwise seen from outside. Omit it for a file.
    density : float, kg/m³
        Give either the density or the mass.
    mass : float, kg
        See `density`.
    scale : float, m
        Length of the unit of the vertices: 1e-3 for mm, as in most STL files. A unit stated in a file is ignored.

    Returns
    -------
    MassProperties
        ``mass, centre_of_mass, inertia``; the inertia is about the centre of mass. About the origin of the mesh it is
        ``shift(inertia, mass, centre_of_mass)``.

    Raises
    ------
    ValueError
        The mesh is open; faces have an orientation opposite to that of their neighbours or occur twice (the message
        states their number); the mesh or a part of it is inside out; the body has no volume; an array is malformed; a
        file contains no mesh, or unpacks to more than 200 MB; or the inertia is not finite.
    OSError
        The file does not exist (FileNotFoundError) or is not a regular file.
    ImportError
        A file is given and trimesh is not installed.

    Notes
    -----
    The mesh may have several parts, and cavities: surfaces that face inwards, within the bounding box of a part. Where
    two parts overlap, mass counts twice.

    Examples
    --------
    >>> from nontwist import inertia
    >>> vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> mass, centre, J = inertia.of_mesh(vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], density=600)
    >>> round(mass, 6), centre.round(6), J.round(3)
    (100.0, array([0.25, 0.25, 0.25]), array([[7.5 , 1.25, 1.25],
           [1.25, 7.5 , 1.25],
           [1.25, 1.25, 7.5 ]]))
    """
    choice = [(name, value) for name, value in (("density", density), ("mass", mass)) if value is not None]
    if len(choice) != 1:
        raise ValueError("give either density= (kg/m³) or mass= (kg)")
    ((name, value),) = choice
    given = float(as_positive(value, name, (), "kg/m³" if name == "density" else "kg"))
    x, f = _surface(vertices, faces)
    x *= as_positive(scale, "scale", (), "m")
    size = float(np.ptp(x, axis=0).max())
    if size and not SMALLEST <= size <= LARGEST:
        raise ValueError(f"the mesh is {size:.3g} m large, from {SMALLEST:g} to {LARGEST:g} m are taken; change scale=")
    _require_closed(x, f)
    origin = x.mean(axis=0)
    t = (x - origin)[f]
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    v, s = (t[:, 0] * normal).sum(axis=1) / 6, t.sum(axis=1)
    round_off = NO_VOLUME * float(np.linalg.norm(normal, axis=1).sum() * size)
    _require_outward(x, f, v, round_off)
    volume = float(v.sum())
    if volume <= round_off:
        raise ValueError(f"the mesh encloses no volume: the sum over its faces is {volume:.3g} m³")
    m, c = given * volume if name == "density" else given, v @ s / (4 * volume)
    second = np.tensordot(t * v[:, None, None], t, axes=((0, 1), (0, 1))) + (s * v[:, None]).T @ s
    E = m / volume * second / 20 - m * np.outer(c, c)
    if E.max() < TINY:
        raise ValueError(f"the inertia of {m:.3g} kg in {size:.3g} m is too small for a float; give a larger {name}=")
    return MassProperties(m, origin + c, convected_inertia((E + E.T) / 2))


def _surface(vertices: ArrayLike | str | os.PathLike[str], faces: ArrayLike | None) -> tuple[Array, Indices]:
    """Vertices of the faces, each place once, and the faces, checked."""
    if isinstance(vertices, (str, os.PathLike)):
        if faces is not None:
            raise ValueError("a file brings its own faces; leave faces out")
        vertices, faces = read_mesh(vertices)
    elif faces is None:
        raise ValueError("faces is missing: give the triangles, (k, 3) indices into vertices, or the path of a file")
    x = as_array(vertices, "vertices", (None, 3))
    index = as_array(faces, "faces", (None, 3))
    if len(index) == 0:
        raise ValueError("the mesh has no faces")
    bad = (index < 0) | (index >= len(x)) | (index != np.floor(index))
    refuse(bad, "faces", lambda at: f"= {index[at]:g} names none of the {len(x)} vertices, counted from 0")
    used, f = np.unique(index.astype(np.int64), return_inverse=True)
    x = x[used]
    order, new = _sorted_rows(x)
    where = np.empty(len(x), dtype=np.int64)
    where[order] = np.cumsum(new) - 1
    return x[order[new]], where[f].reshape(index.shape)


def _sorted_rows(rows: NDArray[Any]) -> tuple[Indices, NDArray[np.bool_]]:
    """Return the order that sorts `rows`, and where in it a row begins that differs from the one before."""
    order = np.lexsort(rows.T)
    rows = rows[order]
    return order, np.append(True, (rows[1:] != rows[:-1]).any(axis=1))


def read_mesh(path: str | os.PathLike[str]) -> tuple[ArrayLike, ArrayLike]:
    """Return the vertices and the faces of a file; errors as `of_mesh`."""
    if not os.path.exists(path):
        raise FileNotFoundError(f"no such file: {path}")
    if not os.path.isfile(path):
        raise OSError(f"{path} is not a regular file (a folder, a FIFO, a device); copy the mesh into a file")
    trimesh = library("trimesh", "mesh files are read through trimesh, which is not installed: pip install trimesh")
    if (unpacked := _unpacked_size(path)) > UNPACKED:
        raise ValueError(
            f"{path} unpacks to more than {UNPACKED / 1e6:g} MB ({unpacked / 1e6:.3g} MB); unpack it, and name the mesh"
        )
    try:
        mesh = trimesh.load_mesh(os.fspath(path), process=False)  # vertices as in the file
    except Exception as error:  # each format raises its own exceptions
        raise ValueError(f"trimesh cannot read a mesh from {path}: {error}") from error
    if len(mesh.faces) == 0:
        raise ValueError(f"{path} contains no triangles")
    return mesh.vertices, mesh.faces


def _unpacked_size(path: str | os.PathLike[str]) -> int:
    """Return the size of what a packed file holds, in bytes, read no farther than `UNPACKED`; 0 of another file."""
    import bz2
    import gzip
    import zipfile

    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return sum(one.file_size for one in archive.infolist())
    with open(path, "rb") as file:
        head = file.read(3)
    unpack: Any = {b"\x1f\x8b": gzip.open, b"BZ": bz2.open}.get(head[:2])
    size = 0
    if unpack is not None:
        with unpack(path, "rb") as content:
            while size <= UNPACKED and (block := content.read(2**20)):
                size += len(block)
    return size


def _require_closed(x: Array, f: Indices) -> None:
    """Every edge must be run through equally often in both directions, and no face be there twice."""
    tail, head = f.ravel(), np.roll(f, -1, axis=1).ravel()
    key = np.minimum(tail, head) * len(x) + np.maximum(tail, head)
    edges, which, times = np.unique(key, return_inverse=True, return_counts=True)
    net = np.bincount(which, weights=np.sign(head - tail))
    odd, turned = times[net != 0] % 2 == 1, edges[net != 0]
    if odd.any():
        a, b = x[list(divmod(int(turned[odd][0]), len(x)))].tolist()
        raise ValueError(
            f"the mesh is not closed: {odd.sum()} of its {len(edges)} edges do not join two faces, the first from {a} "
            f"to {b} m; fill the holes, or give vertices that are meant to be one the same coordinates"
        )
    if len(turned):
        a, b = x[list(divmod(int(turned[0]), len(x)))].tolist()
        raise ValueError(
            f"faces are turned unlike their neighbours: {len(turned)} of {len(edges)} edges are run through twice in "
            f"the same direction, the first from {a} to {b} m; all faces must be counter-clockwise seen from outside"
        )
    first = np.argmin(f, axis=1)[:, None]
    _, new = _sorted_rows(np.take_along_axis(f, (first + np.arange(3)) % 3, axis=1))
    if not new.all():
        raise ValueError(f"{(~new).sum()} of {len(f)} faces occur twice: parts of the surface coincide")


def _require_outward(x: Array, f: Indices, v: Array, round_off: float) -> None:
    """Every part must be turned outwards, but for cavities: parts within the box around another that is."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(f.size), (f.ravel(), np.roll(f, 1, axis=1).ravel())), shape=(len(x), len(x)))
    count, part = connected_components(links, directed=False)
    volume = np.bincount(part[f[:, 0]], weights=v, minlength=count)
    box: Array = np.full((2, count, 3), np.inf)  # the corners low and -high
    np.minimum.at(box[0], part, x)
    np.minimum.at(box[1], part, -x)
    out = volume > 0
    inside = (box[:, :, None] >= box[:, None, out]).all(axis=(0, 3))
    wrong = np.flatnonzero((volume < -round_off) & ~np.any(inside, axis=1))
    if len(wrong):
        what = "the mesh is inside out" if count == 1 else f"{len(wrong)} of {count} parts of the mesh lie inside out"
        raise ValueError(f"{what}: volume {volume[wrong].sum():.6g} m³; reverse each face, faces[:, ::-1]")
