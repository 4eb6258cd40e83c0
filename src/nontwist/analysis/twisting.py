"""Twist of any motion: how much a body turned about its own axis, whatever way the axis went.

Let d3(t) = Λ(t) n be the axis, and let the non-twisting frame start as the body's triad and be carried along d3 without
twist (eq-non-twisting). The twist ψ is the angle about d3 from that frame to the body's triad; its rate is the twist
rate ψ' = w·d3 (eq-w_twist). ψ is computed from the frame, of order 4 in the spacing of the samples, not by integrating
rates, so that its error does not grow with noise; whole turns are counted from sample to sample.

The swing-twist angle τ of the relative rotation Λ(0)ᵀΛ(t) compares the triad with one carried along the single great
circle from d3(0) to d3(t). Carrying a frame forth along the path and back along that circle turns it by the enclosed
solid angle Ω, so

    τ - ψ = Ω        modulo 2π.

For an axis fixed in space the twist is ∫ w·n dt: minus the twist of the inverse motion about its body axis n.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array
from ..geometry.directors import first_d1
from ..geometry.frames import frame_error_estimate, nontwisting_frame
from ..geometry.values import among, shown
from .samples import Samples, samples
from .trajectory import FORMAT_VERSION

if TYPE_CHECKING:
    import xarray
    from scipy.spatial.transform import Rotation

ANTIPODAL = 1e-7


def twist(
    motion: Any,
    time: ArrayLike | None = None,
    *,
    axis: ArrayLike = (0, 0, 1),
    axis_frame: Literal["body", "space"] = "body",
    relative_to: Any = None,
    scalar_first: bool | None = None,
    order: int = 4,
) -> xarray.Dataset:
    """Return the twist of a motion about an axis, with an error estimate.

    Parameters
    ----------
    motion : Rotation, (n, 3, 3) Λ, (n, 4) quaternions, run, trajectory, DataArray or DataFrame
        Attitudes, body to space; all forms of `nontwist.rotation`. Signs of quaternions do not matter.
    time : (n,) array, optional
        s, or dates or durations. Taken from `motion` where it has times. Without times there is no `twist_rate`.
    axis : (3,) array
        Any length but zero.
    axis_frame : "body" or "space"
        Whether the axis is fixed in the body or in space.
    relative_to : motion, optional
        Twist of `motion` relative to this second body, at the same times: of a joint. "space" is then its body.
    scalar_first : bool, optional
        Order of quaternions given as a plain array.
    order : 4 or 2
        Of the frames; 2 for a path with corners at its samples (geodesic in between).

    Returns
    -------
    Dataset on `time`
        twist_angle
            ψ, rad, unwrapped, 0 at the start.
        twist_rate
            ψ', rad/s, by central differences of ψ (absent without times).
        swing_twist_angle
            τ, rad, in (-π, π], of the rotation relative to the first.
        solid_angle
            Ω, sr, enclosed by the path of the axis and the great circle back to its start; every area counts as often
            as it is encircled, with the antipode of the start outside.
        path_length
            Way of the axis on the sphere, rad, along great circles.
        error_estimate
            Of ψ, rad, from the sampling alone: noise of the samples is not in it.
        frame
            The non-twisting frame, rows d1, d2, d3 (an axis fixed in space: in body components).

    Raises
    ------
    ValueError
        Too few samples, something that is no rotation, axes antipodal from one sample to the next: with the row.

    Warns
    -----
    UserWarning
        Rows left out (not finite; doubled times), rows sorted, gaps, samples more than a right angle apart: with
        their number and the first row.

    Examples
    --------
    An axis goes once around a cone of half-angle 60°, as in a gimbal. The body comes back as it was, and has turned by
    2π cos 60° about its axis on the way:

    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> from nontwist import twist
    >>> longitude = np.linspace(0, 360, 201)
    >>> motion = Rotation.from_euler("ZY", np.stack([longitude, np.full(201, 60)], axis=1), degrees=True)
    >>> round(float(np.degrees(twist(motion).twist_angle[-1])), 3)
    180.0
    """
    n = as_array(axis, "axis", (3,))
    if not n.any():
        raise ValueError("axis is zero: it must be a direction")
    if not among(axis_frame, ("body", "space")):
        raise ValueError(f"axis_frame must be 'body' or 'space', got {shown(axis_frame)}")
    data = samples(motion, time, relative_to, scalar_first)
    n, sign = n / np.linalg.norm(n), 1.0 if axis_frame == "body" else -1.0
    R = data.rotation if axis_frame == "body" else data.rotation.inv()
    triad = _triads(R, n)
    d3 = np.ascontiguousarray(triad[:, 2])
    length, turn = _steps(R, d3, data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # wide steps are reported by _steps, with the row
        frame, flat = (nontwisting_frame(d3, triad[0, 0], order=k) for k in (order, 2))
    psi = np.unwrap(np.arctan2(_dot(triad[:, 0], frame[:, 1]), _dot(triad[:, 0], frame[:, 0])))
    psi -= psi[0]
    variables = {
        "twist_angle": sign * psi,
        "swing_twist_angle": sign * _swing_twist(R, n),
        "solid_angle": sign * _swept(d3, frame, flat),
        "path_length": np.append(0.0, np.cumsum(length)),
        "error_estimate": frame_error_estimate(d3, order=order),
        "frame": frame,
    }
    if data.time is not None:
        variables["twist_rate"] = np.gradient(sign * psi, data.time, edge_order=2 if psi.size > 2 else 1)
    return _dataset(variables, data, turn, n, axis_frame, order)


def _triads(R: Rotation, n: Array) -> Array:
    """Triads fixed in the body with third director Λn, rows, (k, 3, 3)."""
    e1 = first_d1(None, n[None], ())[0]
    body = np.stack([e1, np.cross(n, e1), n])
    triads: Array = body @ np.swapaxes(R.as_matrix(), 1, 2)
    return triads


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.einsum("ki,ki->k", a, b)
    return product


def _steps(R: Rotation, d3: Array, data: Samples) -> tuple[Array, Array]:
    """Return the angles between neighbouring axes and attitudes.

    Warns of wide steps and refuses antipodal axes, naming their rows.
    """
    chord = np.linalg.norm(np.diff(d3, axis=0), axis=1)
    angle = 2 * np.arcsin(np.minimum(chord / 2, 1.0))
    flat = np.flatnonzero(angle > np.pi - ANTIPODAL)
    if flat.size:
        a, b = data.rows[flat[0]], data.rows[flat[0] + 1]
        raise ValueError(f"the axis turns by half a turn from row {a} to row {b}: no way between them is shortest")
    p = R.as_quat()
    turn = 2 * np.arccos(np.minimum(abs(_dot(p[1:], p[:-1])), 1.0)).astype(np.float64)
    wide = np.flatnonzero(turn > np.pi / 2)
    if wide.size:
        warnings.warn(
            f"{wide.size} step(s) turn by more than a right angle, the first from row {data.rows[wide[0]]} to row "
            f"{data.rows[wide[0] + 1]} ({np.degrees(turn[wide[0]]):.0f}°): the motion in between is a guess",
            stacklevel=3,
        )
    return angle, turn


def _swing_twist(R: Rotation, n: Array) -> Array:
    """Twist angle about the body axis n of the rotation relative to the first, in (-π, π]."""
    p = (R[0].inv() * R).as_quat()
    p = np.where(p[:, 3:] < 0, -p, p)
    tau = np.array(2 * np.arctan2(p[:, :3] @ n, p[:, 3]))
    tau[tau <= -np.pi] = np.pi
    return tau


def _swept(d3: Array, frame: Array, flat: Array) -> Array:
    """Solid angle between the path so far and the great circle back to its start.

    Triangles from the start to each step (A. Van Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125-126);
    and the areas between great circles and path, by which `frame` is turned from the frame `flat` of order 2.
    """
    a, b, c = d3[0], d3[:-1], d3[1:]
    triple = np.einsum("i,ki->k", a, np.cross(b, c - b))
    area = np.append(0.0, np.cumsum(2 * np.arctan2(triple, 1 + b @ a + _dot(b, c) + c @ a)))
    area += np.unwrap(np.arctan2(_dot(frame[:, 0], flat[:, 1]), _dot(frame[:, 0], flat[:, 0])))
    return area


def _dataset(
    variables: dict[str, Array], data: Samples, turn: Array, n: Array, axis_frame: str, order: int
) -> xarray.Dataset:
    import xarray

    if data.time is None:
        time, attrs = data.rows.astype(np.float64), {"units": "1", "long_name": "row"}
    else:
        time, attrs = data.time, {"units": "s", "long_name": "time", "symbol": "t"}
    described = {
        name: (("time", "director", "axis") if name == "frame" else ("time",), array, _ATTRS[name])
        for name, array in variables.items()
    }
    coordinates = {"time": ("time", time, attrs), "director": [1, 2, 3], "axis": ["x", "y", "z"]}
    record = {
        "format_version": FORMAT_VERSION,
        "title": f"twist about the axis {np.round(n, 12).tolist()} fixed in {axis_frame}",
        "axis": n.tolist(),
        "axis_frame": axis_frame,
        "order": order,
        "samples": data.rows.size,
        "samples_left_out": data.left_out,
        "largest_turn_between_samples": float(turn.max()),
        "notes": "; ".join(data.notes),
        "conventions": "Λ maps body to space; the rows of frame are d1, d2, d3; swing_twist_angle - twist_angle = "
        "solid_angle modulo 2π",
    }
    return xarray.Dataset(described, coordinates, record)


_ATTRS = {
    "twist_angle": {"units": "rad", "long_name": "twist angle", "symbol": "ψ"},
    "twist_rate": {"units": "rad s-1", "long_name": "twist rate", "symbol": "ψ'"},
    "swing_twist_angle": {"units": "rad", "long_name": "swing-twist angle", "symbol": "τ"},
    "solid_angle": {"units": "sr", "long_name": "solid angle of the path, closed by a great circle", "symbol": "Ω"},
    "path_length": {"units": "rad", "long_name": "way of the axis on the sphere", "symbol": "s"},
    "error_estimate": {"units": "rad", "long_name": "estimated error of the twist angle by sampling", "symbol": "ε"},
    "frame": {"units": "1", "long_name": "non-twisting frame, rows d1, d2, d3", "symbol": "χ"},
}
