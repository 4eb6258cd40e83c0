"""What several groups share: bodies, starts, reference integrators, and the reduction of arrays to one number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from ..analysis import variables as obs
from ..analysis.trajectory import Trajectory
from ..geometry.arrays import Array
from ..integrators import Continuous
from ..loads import Load, body_moment, space_moment
from ..models.bodies import BODIES, FULL, sample_bodies, with_gravity
from ..models.system import DirectorSystem
from ..paper.tables import INERTIA
from .checks import Check, Kind

FINE, SHARP = Continuous(rtol=1e-13, atol=1e-14), Continuous(rtol=3e-14, atol=1e-15)  # DOP853
Arguments = dict[str, Any]  # of `integrate`
PAPER_J = np.array(INERTIA)
FULL_J = np.array(FULL)
SCHEMES = (("gauss", 4), ("lie-midpoint", 2), ("energy-momentum", 2))
KICK = (1.0, -2.0, 0.1)  # rad/s, without spin about TILTED

SAMPLES = sample_bodies()  # checks of all kinds call sample_bodies() again, as kinds may be added


def push(t: float) -> tuple[float, float, float]:
    """Return a smooth moment, N m, at the time `t`, for every body."""
    return 3 * np.sin(3 * t), 1.0, 0.3


def pushed(frame: str) -> Load:
    """Return the load `push` along the moving directors ("body") or fixed axes ("space")."""
    return body_moment(push) if frame == "body" else space_moment(push)


def own_kinds() -> list[str]:
    """Return the kinds of body that modules outside the package have added."""
    package = __name__.split(".")[0]
    return [name for name, kind in BODIES.items() if (kind.make.__module__ or "").split(".")[0] != package]


def random_kinds() -> dict[str, tuple[str, bool]]:
    """Return the kinds of random bodies by name, each with whether gravity is added.

    The heavy top is left out, as other checks have it; a heavy Suslov body is added.
    """
    own = own_kinds()
    free = {kind.words: (name, False) for name, kind in BODIES.items() if "mass" not in kind.takes or name in own}
    return free | {"heavy Suslov body": ("suslov", True)}


def random_body(kind: str, heavy: bool, rng: np.random.Generator) -> DirectorSystem:
    """Return a random body of a kind: a positive definite Euler inertia, D3 principal where it must be.

    A kind that takes no inertia has that of its sample.
    """
    entry, a = BODIES[kind], rng.normal(size=(3, 3))
    E = a @ a.T + 0.3 * np.eye(3)
    if entry.principal:
        E[:2, 2] = E[2, :2] = 0
    J = np.trace(E) * np.eye(3) - E
    given = {name: value for name, value in entry.sample.items() if name not in entry.has_default}
    if "inertia" in given:
        given["inertia"] = J
    if "axis" in entry.takes:
        given["axis"] = rng.normal(size=3)
    if "centre_of_mass" in given:
        given |= {"mass": 0.05, "centre_of_mass": rng.normal(size=3) / 10}
    body = entry.make(**given)
    return with_gravity(body, 0.05, rng.normal(size=3) / 10) if heavy else body


def random_start(rng: np.random.Generator) -> Arguments:
    """Return an attitude and an angular velocity, projected on the constraint."""
    return {"rotation": Rotation.random(None, rng), "angular_velocity": 3 * rng.normal(size=3), "project": True}


def energy(run: Trajectory) -> Array:
    """Return K + V, J, at the stored times."""
    kinetic = obs.kinetic_energy(run.director_velocities, run.system.euler_inertia)
    held = 0.0 if run.potentials is None else run.potentials.potential_energy(run.directors, run.time)
    return kinetic + obs.potential_energy(run.directors, run.system) + held


def momentum(run: Trajectory) -> Array:
    """Return the spatial momentum π, kg m² s⁻¹, at the stored times."""
    return obs.spatial_momentum(run.directors, run.director_velocities, run.system.euler_inertia)


def velocity(run: Trajectory) -> Array:
    """Return the material angular velocity W, rad/s, at the stored times."""
    return obs.material(run.directors, obs.angular_velocity(run.directors, run.director_velocities))


def attitude(run: Trajectory) -> Array:
    """Return Λ, columns d_i, at the stored times."""
    return np.swapaxes(run.directors, 1, 2)


def spun(angles: Any, axis: Any) -> Rotation:
    """Return the rotations by the `angles`, rad per unit of the axis, about one axis."""
    return Rotation.from_rotvec(np.outer(angles, axis))


def solved(rates: Callable[[float, Array], Any], times: ArrayLike, start: ArrayLike) -> Array:
    """Return the solution of ``y' = rates(t, y)`` at the `times`, (k, n), from the first one on, by SciPy alone."""
    t = np.asarray(times, dtype=np.float64)
    return solve_ivp(rates, (t[0], t[-1]), start, "DOP853", t, rtol=FINE.rtol, atol=FINE.atol).y.T


# Reduction of arrays to the number of a check.


def error(name: str, errors: ArrayLike, tolerance: float, source: str, kind: Kind) -> Check:
    """Return the check that the largest absolute value of `errors` is 0."""
    return Check(name, 0.0, float(np.max(np.abs(errors))), tolerance, source, kind)


def drift(values: Array) -> float:
    """Return the largest change from the first value along the first axis, relative to the largest value."""
    return float(abs(values - values[0]).max() / abs(values).max())


def all_are(name: str, expected: float, values: ArrayLike, tolerance: float, source: str, kind: Kind) -> Check:
    """Return the check that each of `values` is the expected one: of the one furthest off."""
    flat = np.ravel(np.asarray(values, dtype=np.float64))
    return Check(name, expected, float(flat[np.argmax(abs(flat - expected))]), tolerance, source, kind)


def order(name: str, k: float, counts: ArrayLike, errors: ArrayLike, tolerance: float, source: str) -> Check:
    """Return the check that `errors`, (..., n), of runs with `counts` steps have the order k from each to the next."""
    e, n = np.asarray(errors, dtype=np.float64), np.asarray(counts, dtype=np.float64)
    slopes = np.log(e[..., :-1] / e[..., 1:]) / np.log(n[1:] / n[:-1])
    return all_are(name, k, slopes, tolerance, source, "order")


def turns_apart(one: ArrayLike, other: ArrayLike) -> Array:
    """Return the difference of angles, rad, modulo a turn, in [-π, π)."""
    return np.remainder(np.asarray(one) - np.asarray(other) + np.pi, 2 * np.pi) - np.pi
