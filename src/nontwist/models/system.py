"""A rigid body described by directors, as data.

With directors as rows of ``q[i, x]`` the kinetic energy (eq-director-K) is ``K = 1/2 <v, E v>`` with one symmetric
3×3 matrix ``E``, the Euler inertia (eq-euler-inertia). It determines the convected inertia and is determined by it,

    J = tr(E) I - E,        E = 1/2 tr(J) I - J,

so the eigenvalues of E are ``1/2 (J_j + J_k - J_i)``: they are non-negative exactly when the principal moments obey
the triangle inequality, that is when a mass distribution with this J exists.

The equations ask for less. Of a rigid motion ``v_i = w × d_i`` the form ``<v, E v>`` is ``W·J W``, whatever the sign of
E, so J positive definite is enough for each velocity, momentum and multiplier to be determined, in both descriptions;
`physical` = False takes such a J as it stands. What is lost is that K bounds velocities of directors that are not
rigid, those of the energy-momentum scheme: it keeps K + V and momentum, but they grow (`integrators.energy_momentum`).
About a constrained axis n with ``J n = 0`` nothing turns: J need be positive definite across n.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_direction, as_flag, as_floats, as_tensor
from ..geometry.values import short_repr, vector_text
from ..machine import cached_property
from .spin import as_spin

if TYPE_CHECKING:
    from .stack import SystemStack

SYMMETRY, TRIANGLE, PRINCIPAL = 1e-12, 1e-9, 1e-9
CLEARLY = 1e-9  # determinant of a definite matrix, of the cube of its largest entry
SMALLEST = 1e-300  # trace, kg m², of whose inverse no digit is lost


def convected_inertia(E: ArrayLike) -> Array:
    """Return the convected inertia ``J = tr(E) I - E`` of an Euler inertia (eq-euler-inertia).

    Parameters
    ----------
    E : (3, 3) array, kg m²

    Returns
    -------
    (3, 3) array, kg m²

    Raises
    ------
    ValueError
        The argument is not an array of finite numbers of this shape.

    Examples
    --------
    >>> from nontwist.inertia import convected_inertia
    >>> convected_inertia([[3, 0, 0], [0, 2, 0], [0, 0, 1]]).diagonal()
    array([3., 4., 5.])
    """
    E = as_array(E, "euler inertia", (3, 3))
    J: Array = 0.0 - E
    d = E.diagonal()
    J.flat[::4] = d[[1, 2, 0]] + d[[2, 0, 1]]  # J11 = E22 + E33: of a thin rod the trace would lose its small moment
    return J


def euler_inertia(J: ArrayLike, *, physical: bool = True, axis: ArrayLike | None = None) -> Array:
    """Return the Euler inertia ``E = 1/2 tr(J) I - J`` (eq-euler-inertia) of a convected inertia.

    Parameters
    ----------
    J : (3, 3) array or 3 principal values, kg m²
    physical : bool
        False: J may violate the triangle inequality; E is then indefinite.
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z", optional
        A constrained axis, of any length but zero, about which J may vanish.

    Returns
    -------
    (3, 3) array, kg m²
        Positive semidefinite where physical; eigenvalues between -1e-9 tr J and 0 (plates, rods) are set to 0.

    Raises
    ------
    ValueError
        J has the wrong shape, is not finite, not symmetric or not positive definite, or violates the triangle
        inequality; `physical` is not True or False, or `axis` has length 0.

    Examples
    --------
    >>> from nontwist.inertia import euler_inertia
    >>> euler_inertia([3, 4, 5]).diagonal()
    array([3., 2., 1.])
    >>> euler_inertia([1, 1, 3])
    Traceback (most recent call last):
        ...
    ValueError: inertia violates the triangle inequality: principal moments 1, 1, 3, but 3 > 1 + 1; ...
    """
    J = checked_inertia(J, physical, None if axis is None else as_direction(axis, "axis"))
    E = np.trace(J) / 2 * np.eye(3) - J
    return _semidefinite(E) if physical else E


def checked_inertia(J: ArrayLike, physical: bool = True, axis: Array | None = None) -> Array:
    """Return `J`, (3, 3) or 3 principal values, as a symmetric (3, 3) array; errors as in `euler_inertia`."""
    J = _symmetric(as_tensor(J, "inertia", "3 principal moments or a (3, 3) array"), "inertia")
    physical = as_flag(physical, "physical")
    if 0 < np.trace(J) < SMALLEST:
        raise ValueError(
            f"inertia has the trace {np.trace(J):g}, which is too small; the smallest accepted is {SMALLEST}"
        )
    if _is_definite(np.trace(J) / 2 * np.eye(3) - J):  # E, so that J is definite, and its moments are those of a body
        return J
    a, b, c = principal = np.linalg.eigvalsh(J)
    is_massless_about_axis = axis is not None and max(abs(J @ axis)) <= SYMMETRY * c
    if (b if is_massless_about_axis else a) <= 4 * np.finfo(float).eps * abs(principal).max():
        but = " (0 is accepted about the third axis of nontwisting without a spin)" * bool(
            b > 0 and abs(a) < SYMMETRY * c
        )
        raise ValueError(f"inertia is not positive definite: its smallest principal moment is {a:.6g}{but}")
    if not physical:
        return J
    if a + b < c - 2 * TRIANGLE * principal.sum():
        raise ValueError(
            f"inertia violates the triangle inequality: principal moments {a:.6g}, {b:.6g}, {c:.6g}, but {c:.6g} > "
            f"{a:.6g} + {b:.6g}; no distribution of mass has such moments, physical=False accepts them"
        )
    return J


def split_inertia(J: ArrayLike) -> tuple[Array, float]:
    """Split ``J = J_perp + J_par D3 ⊗ D3`` (eq-irho-decomp).

    Parameters
    ----------
    J : (3, 3) array, kg m²

    Returns
    -------
    J_perp : (3, 3) array, kg m², with ``J_perp D3 = 0``
    J_par : float, kg m²

    Raises
    ------
    ValueError
        D3 is not principal (beyond 1e-9 relative).

    Examples
    --------
    >>> from nontwist.split_form import split_inertia
    >>> J_perp, J_par = split_inertia([[3, 0.1, 0], [0.1, 4, 0], [0, 0, 5]])
    >>> J_perp
    array([[3. , 0.1, 0. ],
           [0.1, 4. , 0. ],
           [0. , 0. , 0. ]])
    >>> J_par
    5.0
    """
    J = as_array(J, "inertia", (3, 3))
    require_principal(J, np.array([0.0, 0.0, 1.0]))
    J_perp = np.zeros((3, 3))
    J_perp[:2, :2] = J[:2, :2]
    return J_perp, float(J[2, 2])


def across(J: Array, n: Array) -> Array:
    """Return the part of J n orthogonal to unit vectors n, (..., 3), kg m²: 0 where n is principal."""
    Jn = np.sum(J * n[..., None, :], axis=-1)
    return Jn - np.sum(Jn * n, axis=-1, keepdims=True) * n


def require_principal(J: Array, axis: Array) -> None:
    """Raise a ValueError unless D3 = `axis` is a principal direction of `J` (eq-irho-decomp)."""
    off = across(J, axis)
    k = int(np.argmax(abs(off)))
    if abs(off[k]) > PRINCIPAL * np.linalg.norm(J, 2):
        raise ValueError(
            f"D3 is not a principal direction of the inertia: J[{k},2] = {off[k]:.6g}; "
            "suslov(inertia, (0, 0, 1)) accepts such a body"
        )


def require_mass(E: Array, m: float, rho: Array) -> None:
    """Raise a ValueError unless `E`, about a point, is large enough for the mass m at ρ from it.

    About the point ``E = E_com + m ρ ⊗ ρ``, and E_com is positive semidefinite.
    """
    if _is_definite(about_centre := E - m * np.outer(rho, rho)):
        return
    smallest = float(np.linalg.eigvalsh(about_centre)[0])
    if smallest < -2e-9 * np.trace(E):
        raise ValueError(
            f"inertia is too small for a mass of {m:g} kg at {rho.tolist()} m: the Euler inertia about the centre of "
            f"mass would have the eigenvalue {smallest:.6g} kg m²; is the inertia about the fixed point? If m g ρ "
            "alone is known, a smaller mass and larger gravity make the same top; physical=False accepts any mass"
        )


def _symmetric(A: Array, name: str) -> Array:
    gap = abs(A - A.T)
    if gap.any() and gap.max() > SYMMETRY * abs(A).max():
        i, j = divmod(int(gap.argmax()), 3)
        raise ValueError(f"{name} is not symmetric: [{i},{j}] = {A[i, j]!s}, but [{j},{i}] = {A[j, i]!s}")
    return (A + A.T) / 2


def _is_definite(A: Array) -> bool:
    """Whether a symmetric matrix (3, 3) is positive definite, clearly, by its minors: quicker than by eigenvalues."""
    (a, b, c), (_, d, e), (_, _, f) = A.tolist()
    minor, determinant = a * d - b * b, a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return bool(a > 0 and minor > 0 and determinant > CLEARLY * max(a, d, f) ** 3)


def _semidefinite(E: Array) -> Array:
    if _is_definite(E):
        return E
    values, vectors = np.linalg.eigh(E)
    return E if values[0] >= 0 else (vectors * np.maximum(values, 0)) @ vectors.T


@dataclass(frozen=True, eq=False, repr=False)
class DirectorSystem:
    """A body with a fixed point, in the form that all integrators accept.

    Parameters
    ----------
    euler_inertia : (3, 3) array, kg m²
        Euler inertia about the fixed point (eq-euler-inertia), symmetric, positive semidefinite, in body components.
    axis : (3,) array, "x", "y", "z", "-x", "-y", "-z", or None
        Body axis n about which the body may not turn, ``w·Λn = 0``; it is normalised. None: no constraint.
    dead_force : (3, 3) array, N m
        Rows: the constant forces f^i that act on the directors. Potential energy ``V = -Σ f^i·d_i``.
    name : str
    spin : float, or (times, values), optional
        The prescribed rate c(t) about the axis, ``w·Λn = c``, rad/s: a number, or a table, piecewise linear between its
        times and constant outside. The axis must be principal. Stored as a table with `times` and `values`, or None if
        it is zero.
    physical : bool
        As in `nontwist.standard`. With an axis and no spin the moment of inertia about the axis may be 0.

    Raises
    ------
    ValueError
        As `nontwist.standard`; or the axis has length 0, the name is not a string, or a spin is given without an axis
        or about one that is not principal.

    Examples
    --------
    >>> from nontwist import DirectorSystem
    >>> body = DirectorSystem([[3, 0, 0], [0, 2, 0], [0, 0, 1]], axis=(0, 0, 2))
    >>> body
    <DirectorSystem 'body': inertia diag(3, 4, 5) kg m², axis (0, 0, 1)>
    >>> body.inertia.diagonal()
    array([3., 4., 5.])
    >>> body.axis
    array([0., 0., 1.])
    """

    euler_inertia: Array
    axis: Array | None = None
    dead_force: Array = field(default_factory=lambda: np.zeros((3, 3)))
    name: str = "body"
    spin: Any = None
    physical: bool = True
    weight: ClassVar[dict[str, Any]] = {}  # keys of a run file, where `with_gravity` made it; copies do not have them

    def __post_init__(self) -> None:
        E = _symmetric(as_array(self.euler_inertia, "euler_inertia", (3, 3)), "euler_inertia")
        axis = None if self.axis is None else as_direction(self.axis, "axis")
        dead = as_array(self.dead_force, "dead_force", (3, 3))
        if not isinstance(self.name, str):
            raise ValueError(f"name must be a string, got {short_repr(self.name)}")
        spin = as_spin(self.spin)
        checked_inertia(convected_inertia(E), self.physical, None if spin is not None else axis)
        E = _semidefinite(E) if self.physical else E
        if spin is not None:
            if axis is None:
                raise ValueError("spin needs the axis that it is about: axis=")
            J = convected_inertia(E)
            off = across(J, axis)
            if abs(off).max() > PRINCIPAL * abs(J).max():
                raise ValueError(
                    f"spin needs an axis that is principal, but J n differs from its part along n by "
                    f"{np.linalg.norm(off):.3g} kg m²"
                )
        keep(self, euler_inertia=E, axis=axis, dead_force=dead, spin=spin)

    @cached_property
    def convected_inertia(self) -> Array:
        """Convected inertia J about the fixed point, (3, 3), kg m², read-only."""
        J = convected_inertia(self.euler_inertia)
        J.flags.writeable = False
        return J

    @property
    def inertia(self) -> Array:
        """The convected inertia J, as passed to `standard` and other bodies."""
        return self.convected_inertia

    def __repr__(self) -> str:
        axis = "" if self.axis is None else f", axis {vector_text(self.axis)}"
        if self.spin is not None:
            constant = self.spin.is_constant
            axis += f", spin {f'{self.spin.values[0]:.6g} rad/s' if constant else 'by a table'}"
        forces = ", dead forces" if self.dead_force.any() else ""
        note = "" if self.physical else ", physical=False"
        return (
            f"<DirectorSystem {short_repr(self.name)}: inertia {inertia_text(self.inertia)} kg m²{axis}{forces}{note}>"
        )

    @staticmethod
    def stack(systems: Sequence[DirectorSystem]) -> SystemStack:
        """Return bodies as one stack with a leading member axis, for `nontwist.simulate_ensemble`.

        Parameters
        ----------
        systems : sequence of DirectorSystem
            Either all have a constrained axis or none has.

        Returns
        -------
        SystemStack

        Raises
        ------
        ValueError
            There is no body, something is not a body, or only some bodies have a constrained axis.
        """
        from .stack import SystemStack

        return SystemStack.of(systems)

    @cached_property
    def _key(self) -> str:
        return self.to_json()

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, DirectorSystem) and self._key == other._key)

    def __hash__(self) -> int:
        return hash(self._key)

    def to_json(self) -> str:
        """Return the body as a JSON string; `from_json` reads it without loss."""
        axis = None if self.axis is None else self.axis.tolist()
        force = self.dead_force.tolist()
        data = {"name": self.name, "euler_inertia": self.euler_inertia.tolist(), "axis": axis, "dead_force": force}
        if self.spin is not None:
            data["spin"] = [self.spin.times.tolist(), self.spin.values.tolist()]
        if not self.physical:
            data["physical"] = False
        return json.dumps(data)

    @classmethod
    def from_json(cls, text: str) -> DirectorSystem:
        """Return the body that `to_json` wrote.

        Parameters
        ----------
        text : str

        Returns
        -------
        DirectorSystem

        Raises
        ------
        ValueError
            The text was not written by `to_json`, or is damaged.
        """
        try:
            data = json.loads(text)
            system = {key: data[key] for key in ("euler_inertia", "axis", "dead_force", "name")}
            if (spin := data.get("spin")) is not None:
                times, values = (as_floats(part, "spin") for part in spin)
                system["spin"] = values[0] if times.size == 1 else (times, values)
            system["physical"] = data.get("physical", True)
        except (TypeError, ValueError, KeyError, IndexError, AttributeError, RecursionError) as error:
            raise ValueError(f"a body as JSON is what DirectorSystem.to_json writes; got {short_repr(text)}") from error
        return cls(**system)


def keep(body: Any, **values: Any) -> None:
    """Set fields of a frozen body; arrays become read-only."""
    for key, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(body, key, value)


def inertia_text(J: Array) -> str:
    """Return an inertia in four digits: "diag(3, 4, 5)", or its rows."""
    if np.array_equal(J, np.diag(J.diagonal())):
        return f"diag{vector_text(J.diagonal())}"
    return f"[{', '.join(map(vector_text, J))}]"


def as_system(value: Any) -> DirectorSystem:
    """Return `value` where it is a body; a ValueError says what is taken."""
    if not isinstance(value, DirectorSystem):
        raise ValueError(
            "system must be a body (standard, nontwisting, suslov, heavy_top, with_gravity, DirectorSystem), "
            f"got {short_repr(value)}"
        )
    return value


@dataclass(frozen=True, eq=False, repr=False)
class HingedSystem(DirectorSystem):
    """A body that a second constraint leaves one axis d to turn about, across the first one, ``d·J d ω' = d·M``.

    In the frame (d, e, n), n the constrained axis, 1/J22 is 0, as if nothing could turn it about e. Of the equations
    of a body with a constrained axis the first is then this one, whatever J12 is.
    """

    hinge: Array = field(default_factory=lambda: np.eye(3)[0])

    @property
    def frame(self) -> Array:
        """The frame, as columns in body components."""
        n = np.asarray(self.axis, np.float64)
        return np.stack([self.hinge, np.cross(n, self.hinge), n], axis=1)

    @cached_property
    def _key(self) -> str:
        return f"{self.to_json()} {self.hinge.tolist()}"
