"""The bodies of the package: each a function that returns a `DirectorSystem`, and an entry of `BODIES`.

Run files, sweeps, the viewer, `nontwist validate` and the tests read `BODIES` on every call, so a kind that is added at
run time counts from then on.

Gravity acts on the centre of mass ``r = Σ ρ_i d_i`` with ρ in body components, so its potential ``-m g·r`` is linear
in the directors and its director forces ``f^i = m ρ_i g`` are constant: a dead force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import warn
from ..geometry.arrays import Array, as_array, as_axis, as_positive
from ..geometry.values import hinted, short_repr
from ..machine import cached_property
from ..spec import Spec, specs
from .spin import Spin
from .system import DirectorSystem, as_system, convected_inertia, euler_inertia, keep, require_mass, require_principal

D3 = np.array([0.0, 0.0, 1.0])


@hinted
def standard(inertia: ArrayLike, *, physical: bool = True) -> DirectorSystem:
    """Return the standard rigid body, free to turn about a fixed point (eq-standard, eq_weak_form_rigid_body).

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point, in body components.
    physical : bool
        False accepts principal moments that violate the triangle inequality, as some published problems do: the
        equations need J positive definite only. Every integrator keeps what it keeps of other bodies.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        `inertia` is not (3, 3) or (3,), not finite, not symmetric (beyond 1e-12 relative), not positive definite, or
        violates the triangle inequality (beyond 1e-9 tr J; plates and rods are accepted); or `physical` is not True or
        False.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> run = simulate(standard([3, 4, 5]), t_end=2, material_angular_velocity=(0.1, 2, 0.1))
    >>> run.spatial_momentum.values[[0, -1]].round(9)  # constant in free motion
    array([[0.3, 8. , 0.5],
           [0.3, 8. , 0.5]])
    """
    return DirectorSystem(euler_inertia(inertia, physical=physical), name="standard", physical=physical)


@hinted
def nontwisting(
    inertia: ArrayLike, spin: float | tuple[ArrayLike, ArrayLike] | Spin | None = None, *, physical: bool = True
) -> DirectorSystem:
    """Return the body on a non-twisting frame (eq-nonholonomic, eq_weak_form_rigid_body_alternative).

    The body may not turn about its own third director, ``w·d3 = 0``, or turns about it at a prescribed rate,
    ``w·d3 = c(t)``. The constraint exerts the moment -μ, recorded in the run, with the power -μ c. With a spin, energy
    is not conserved, even if c is constant; free motion conserves ``2 J3 K - |Π|²``. If J3 is the middle moment of
    inertia, a constant spin is unstable: W1, W2 grow like exp(σt), ``σ = |c| sqrt((J3 - J1)(J2 - J3)/(J1 J2))``.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point; D3 must be a principal direction (eq-irho-decomp). J3 may be 0
        without a spin: a point mass on a massless rod, the spherical pendulum.
    spin : float, rad/s; or a pair of (k,) arrays, times in s and values in rad/s, optional
        c(t): constant, or piecewise linear between the times and constant outside. `gauss`, `lie-midpoint` and
        `continuous` support it. The component of the initial angular velocity along d3 must be c or zero.
    physical : bool
        As in `standard`.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        As `standard`; or D3 is not principal, beyond 1e-9 relative (`suslov` accepts such a body); or `spin` is neither
        a number nor a table, or is not finite.

    Examples
    --------
    >>> from nontwist import nontwisting, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=2, material_angular_velocity=(6, -18, 0))
    >>> run.material_momentum.values[[0, -1], :2].round(9)  # constant in free motion
    array([[ 18., -72.],
           [ 18., -72.]])

    A body that is spun up to 2 rad/s in the first second:

    >>> body = nontwisting([3, 4, 5], spin=([0, 1], [0, 2]))
    >>> run = simulate(body, t_end=2, step=0.5, material_angular_velocity=(0.1, 0, 0))
    >>> run.twist_rate.values.round(12)
    array([0., 1., 2., 2., 2.])
    """
    E = euler_inertia(inertia, physical=physical, axis=D3)
    require_principal(convected_inertia(E), D3)
    E[:2, 2] = E[2, :2] = 0.0
    return DirectorSystem(E, D3, name="nontwisting", spin=spin, physical=physical)


@hinted
def suslov(inertia: ArrayLike, axis: ArrayLike, *, physical: bool = True) -> DirectorSystem:
    """Return the Suslov body, which may not turn about a given body axis, principal or not.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point.
    axis : (3,) array, or "x", "y", "z", "-x", "-y", "-z"
        The constrained axis n in body components, any length but zero: ``W·n = 0``. ``J n = 0`` is accepted.
    physical : bool
        As in `standard`.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        As `standard`; or `axis` is zero or not finite.

    Examples
    --------
    The motion approaches a steady rotation and conserves energy:

    >>> from nontwist import simulate, suslov
    >>> body = suslov([[2, 0, 0.3], [0, 2.5, -0.2], [0.3, -0.2, 3]], axis=(0, 0, 1))
    >>> run = simulate(body, t_end=100, material_angular_velocity=(-1, 0.4, 0))
    >>> run.kinetic_energy.values[[0, -1]].round(9)
    array([1.2, 1.2])
    >>> run.material_angular_velocity.values[[0, -1], :2].round(3)
    array([[-1.   ,  0.4  ],
           [ 0.561,  0.842]])
    """
    n = as_axis(axis, "axis")
    return DirectorSystem(euler_inertia(inertia, physical=physical, axis=n), n, name="suslov", physical=physical)


@hinted
def heavy_top(
    inertia: ArrayLike,
    mass: float,
    centre_of_mass: ArrayLike,
    gravity: ArrayLike = (0, 0, -9.81),
    *,
    physical: bool = True,
) -> DirectorSystem:
    """Return the heavy top: a standard body under gravity.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the **fixed point** (not the centre of mass).
    mass : float, kg
    centre_of_mass : (3,) array, m
        From the fixed point, in body components.
    gravity : (3,) array, m/s²
        In space.
    physical : bool
        As in `standard`. False also accepts a mass that is too large for the inertia: the motion depends on m ρ g only.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        As `standard` and `with_gravity`.

    Examples
    --------
    A top spinning at 10 rad/s, released with its axis horizontal:

    >>> from nontwist import heavy_top, simulate
    >>> top = heavy_top([2, 2, 1], mass=1.5, centre_of_mass=(0, 0, 0.6))
    >>> horizontal = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # d3 along x
    >>> run = simulate(top, t_end=1, rotation=horizontal, material_angular_velocity=(0, 0, 10))
    >>> (run.kinetic_energy + run.potential_energy).values[[0, -1]].round(9)
    array([50., 50.])
    """
    body = standard(inertia, physical=physical)
    top = with_gravity(body, mass, centre_of_mass, gravity)
    keep(top, name="heavy_top")
    return top


@hinted
def with_gravity(
    system: DirectorSystem, mass: float, centre_of_mass: ArrayLike, gravity: ArrayLike = (0, 0, -9.81)
) -> DirectorSystem:
    """Return `system`, any body, under gravity in addition to its other dead forces.

    Parameters
    ----------
    system : DirectorSystem
    mass : float, kg
    centre_of_mass : (3,) array, m
        From the fixed point, in body components.
    gravity : (3,) array, m/s²
        In space.

    Returns
    -------
    DirectorSystem

    Raises
    ------
    ValueError
        The mass is not positive or not finite, or the inertia of a body made without ``physical=False`` is smaller than
        ``mass |centre_of_mass|²`` requires.

    Warns
    -----
    UserWarning
        The centre of mass is the fixed point: gravity has no moment about it.

    Examples
    --------
    A pendulum that cannot twist, released at 60° from the upright:

    >>> from scipy.spatial.transform import Rotation
    >>> from nontwist import nontwisting, simulate, with_gravity
    >>> pendulum = with_gravity(nontwisting([2, 2, 1]), mass=1.5, centre_of_mass=(0, 0, 0.6))
    >>> run = simulate(pendulum, t_end=1, rotation=Rotation.from_euler("x", 60, degrees=True))
    >>> (run.kinetic_energy + run.potential_energy).values[[0, -1]].round(9)
    array([4.4145, 4.4145])
    """
    system = as_system(system)
    m = float(as_positive(mass, "mass", (), "kg"))
    if np.isscalar(gravity):
        raise ValueError(f"gravity must be a vector in space, as (0, 0, -9.81), got {short_repr(gravity)}")
    rho, g = as_array(centre_of_mass, "centre_of_mass", (3,)), as_array(gravity, "gravity", (3,))
    if system.physical:
        require_mass(system.euler_inertia, m, rho)
    if not rho.any():
        warn("the centre of mass is the fixed point, so gravity has no moment about it")
    force: Array = system.dead_force + m * np.outer(rho, g)
    heavy = replace(system, dead_force=force, name=f"{system.name} under gravity")
    if not system.dead_force.any():
        keep(heavy, weight={"mass": m, "centre_of_mass": rho.tolist(), "gravity": g.tolist()})
    return heavy


KEYS = ("inertia", "axis", "mass", "centre_of_mass", "gravity", "spin", "physical")  # of the table [body]


@dataclass(frozen=True)
class BodyKind:
    """A kind of body.

    Attributes
    ----------
    make : callable
        Returns a `DirectorSystem` whose name is the key of this entry. Its parameters are keys of a run file: any of
        `inertia`, `axis`, `mass`, `centre_of_mass`, `gravity`, `spin`, `physical`, and others whose annotation
        describes them, as ``Annotated[float, Spec("of the wheel", unit="m", rule="positive")]``. Parameters with a
        default are optional there.
    words : str
        Its name in the viewer and in `nontwist validate`.
    sample : dict
        Arguments of `make`, without symmetry if possible: the body that `nontwist validate` and the tests check.
    principal : bool
        Whether the third director must be a principal direction.
    at_once : callable, optional
        Returns the Euler inertias of many inertias, both (m, 3, 3), for bodies with a given axis, the same axis, or
        none: with it, sweeps make all members together instead of one by one. Members whose Euler inertia is not
        ½ tr(J) I - J are made by `make`.

    Raises
    ------
    ValueError
        `make` has a parameter that is neither a key of run files nor described.
    """

    make: Callable[..., DirectorSystem]
    words: str
    sample: dict[str, Any]
    principal: bool = False
    at_once: Callable[[Array], Array] | None = None

    def __post_init__(self) -> None:
        if unknown := [key for key in self.takes if key not in KEYS and key not in self.own]:
            raise ValueError(
                f"{self.words!r} takes {unknown[0]!r}, which is not a key of [body]: a body accepts any of "
                f"{', '.join(KEYS)}; describe another, as {unknown[0]}: Annotated[float, Spec(...)]"
            )

    @cached_property
    def takes(self) -> tuple[str, ...]:
        """The parameters of `make`."""
        return tuple(signature(self.make).parameters)

    @cached_property
    def own(self) -> dict[str, tuple[Any, Any, Spec]]:
        """Type, default and description of the parameters of `make` that other kinds do not have."""
        return {name: one for name, one in specs(self.make).items() if name not in KEYS}

    @cached_property
    def has_default(self) -> frozenset[str]:
        """The parameters of `make` that have a default."""
        parameters = signature(self.make).parameters.items()
        return frozenset(name for name, one in parameters if one.default is not one.empty)


def many_euler(J: Array) -> Array:
    """Return ½ tr(J) I - J of inertias (m, 3, 3), which are not checked."""
    return (J[:, 0, 0] + J[:, 1, 1] + J[:, 2, 2])[:, None, None] / 2 * np.eye(3) - J


def _many_block(J: Array) -> Array:
    E = many_euler(J)
    E[:, :2, 2] = E[:, 2, :2] = 0.0
    return E


FULL, BLOCK = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]], [[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]]
TILTED = [0.3, 0.2, 1.0]  # neither principal nor in a plane of symmetry
TOP = {"inertia": [2.0, 2.2, 1.0], "mass": 1.5, "centre_of_mass": [0.1, 0.0, 0.6]}

BODIES = {
    "standard": BodyKind(standard, "standard body", {"inertia": FULL}, at_once=many_euler),
    "nontwisting": BodyKind(nontwisting, "non-twisting body", {"inertia": BLOCK}, True, _many_block),
    "suslov": BodyKind(suslov, "Suslov body", {"inertia": FULL, "axis": TILTED}, at_once=many_euler),
    "heavy_top": BodyKind(heavy_top, "heavy top", TOP),
}


def sample_bodies() -> dict[str, DirectorSystem]:
    """Return a body of every kind, made of its sample.

    Raises
    ------
    ValueError
        The bodies of a kind bear another name than its key.
    """
    made = {name: kind.make(**kind.sample) for name, kind in BODIES.items()}
    for name, body in made.items():
        if body.name != name:
            raise ValueError(f"BODIES[{name!r}] makes bodies with the name {body.name!r}; name= must be the key")
    return made
