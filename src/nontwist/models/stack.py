"""Many bodies as arrays, with the member axis first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import UNIT, Array, as_array
from ..geometry.values import as_list, short_repr
from ..machine import cached_property
from .spin import Spin, as_spin
from .system import PRINCIPAL, SYMMETRY, DirectorSystem, across, as_system, inertia_text, keep

PARALLEL = 1e-12


@dataclass(frozen=True, eq=False, repr=False)
class SystemStack:
    """Bodies along a member axis; either all have a constrained axis or none has.

    Returned by `DirectorSystem.stack([...])`, or made from arrays, which is much faster for many bodies.

    Parameters
    ----------
    euler_inertia : (m, 3, 3) array, kg m²
    axis : (m, 3) array or None
        Constrained body axes; normalised.
    dead_force : (m, 3, 3) array, N m, optional
        Dead forces, as in `DirectorSystem`. None: no forces.
    name : str
    spin : float, or (times, values), optional
        Prescribed spin, as in `DirectorSystem`, the same for all members.
    spin_factor : (m,) array, optional
        Factors that multiply the spin of each member; by default 1.
    physical : bool
        As in `DirectorSystem`; False accepts all members.

    Raises
    ------
    ValueError
        As `DirectorSystem`; the message states the number of the member.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import SystemStack, simulate_ensemble
    >>> bodies = SystemStack(np.linspace(1, 2, 5)[:, None, None] * np.diag([3.0, 2.0, 1.0]))
    >>> bodies
    <SystemStack 'body': 5 bodies, the first of inertia diag(3, 4, 5) kg m²>
    >>> bodies.inertia[[0, -1]].diagonal(axis1=1, axis2=2)
    array([[ 3.,  4.,  5.],
           [ 6.,  8., 10.]])
    >>> simulate_ensemble(bodies, t_end=1, material_angular_velocity=(1, 2, 0)).sizes["member"]
    5
    """

    euler_inertia: Array
    axis: Array | None = None
    dead_force: Array = None  # type: ignore[assignment]  # an array from here on
    name: str = "body"
    spin: Any = None
    spin_factor: Array | None = None
    physical: bool = True

    def __post_init__(self) -> None:
        E = as_array(self.euler_inertia, "euler_inertia", (None, 3, 3))
        m = len(E)
        if not isinstance(self.name, str):
            raise ValueError(f"name must be a string, got {short_repr(self.name)}")
        if not m:
            raise ValueError("a stack needs at least one body")
        dead = np.zeros((m, 3, 3)) if self.dead_force is None else as_array(self.dead_force, "dead_force", (m, 3, 3))
        axis = None if self.axis is None else as_array(self.axis, "axis", (m, 3))
        for i in np.flatnonzero(doubtful(E, axis)):
            try:
                n, spin = None if axis is None else axis[i], None if self.spin is None or axis is None else 1.0
                body = DirectorSystem(E[i], n, spin=spin, physical=self.physical)
            except ValueError as error:
                raise ValueError(f"member {i}: {error}") from error
            E[i] = body.euler_inertia
            if axis is not None:
                axis[i] = body.axis
        E = (E + E.swapaxes(1, 2)) / 2
        keep(self, euler_inertia=E, axis=axis, dead_force=dead)
        self._set_spin(m, axis)

    def _set_spin(self, m: int, axis: Array | None) -> None:
        """Keep a spin that members share as a table, and what it is multiplied by for each."""
        spin = as_spin(self.spin)
        factor = np.ones(m) if self.spin_factor is None else as_array(self.spin_factor, "spin_factor", (m,))
        if spin is not None and not factor.any():
            spin = None
        if spin is not None:
            if axis is None:
                raise ValueError("spin needs the axes that it is about: axis=")
            if not is_principal(self).all():
                k = int(np.argmin(is_principal(self)))
                raise ValueError(f"member {k}: spin needs an axis that is principal")
        keep(self, spin=spin, spin_factor=None if spin is None else factor)

    def spin_of(self, member: int) -> Spin | None:
        """Return the spin of a member, or None if it has none."""
        if self.spin is None or self.spin_factor is None:
            return None
        return as_spin(Spin(self.spin.times, self.spin_factor[member] * self.spin.values))

    def spin_at(self, time: float) -> Array:
        """Return the prescribed spin of all members at a time, (m,), rad/s; 0 if there is none."""
        if self.spin is None or self.spin_factor is None:
            return np.zeros(len(self))
        return self.spin_factor * self.spin.at([time])

    @classmethod
    def of(cls, systems: Sequence[DirectorSystem]) -> SystemStack:
        """Return the stack of `systems`: `DirectorSystem.stack`.

        Parameters
        ----------
        systems : sequence of DirectorSystem

        Raises
        ------
        ValueError
            As `DirectorSystem.stack`.
        """
        bodies = as_list(systems, "systems")
        for k, body in enumerate(bodies):
            if not isinstance(body, DirectorSystem):
                raise ValueError(f"stack requires bodies, but the entry {k} is {short_repr(body)}")
        constrained = [body.axis is not None for body in bodies]
        if any(constrained) and not all(constrained):
            k, other = constrained.index(True), constrained.index(False)
            raise ValueError(
                f"a stack is of bodies with a constrained axis or of bodies without; body {k} has one, body {other} "
                "has none: run them as two ensembles"
            )
        names = list(dict.fromkeys(body.name for body in bodies))
        spin, factor = _shared_spin(bodies)
        E, dead = (
            np.array([getattr(body, name) for body in bodies]).reshape(len(bodies), 3, 3)
            for name in ("euler_inertia", "dead_force")
        )
        axes = np.array([body.axis for body in bodies]) if any(constrained) else None
        name, physical = names[0] if len(names) == 1 else "mixed", all(body.physical for body in bodies)
        found = cls(E, axes, dead, name, spin, factor, physical)
        keep(found, _bodies=tuple(bodies))
        return found

    def __len__(self) -> int:
        return len(self.euler_inertia)

    def __repr__(self) -> str:
        first = inertia_text(self.inertia[0])
        return f"<SystemStack {short_repr(self.name)}: {len(self)} bodies, the first of inertia {first} kg m²>"

    def __getitem__(self, member: int) -> DirectorSystem:
        if "_bodies" in vars(self):
            return vars(self)["_bodies"][member]
        axis = None if self.axis is None else self.axis[member]
        return DirectorSystem(
            self.euler_inertia[member], axis, self.dead_force[member], self.name, self.spin_of(member), self.physical
        )

    @cached_property
    def convected_inertia(self) -> Array:
        """Convected inertia J about the fixed point, (m, 3, 3), kg m², read-only."""
        E = self.euler_inertia
        J: Array = np.trace(E, axis1=1, axis2=2)[:, None, None] * np.eye(3) - E
        J.flags.writeable = False
        return J

    @property
    def has_dead_force(self) -> bool:
        """Whether gravity or another dead force acts on a body."""
        return bool(np.any(self.dead_force))

    @property
    def inertia(self) -> Array:
        """The convected inertia J."""
        return self.convected_inertia

    @property
    def vertical(self) -> Array:
        """Direction in space common to all dead forces of a body, about which they have no moment, (m, 3).

        0 if their directions differ or there are no dead forces.
        """
        scale = -np.frexp(abs(self.dead_force).max(axis=(1, 2)))[1]
        dead = np.ldexp(self.dead_force, scale[:, None, None])  # whose squares are numbers
        length = np.sqrt((dead * dead).sum(axis=2))
        largest, size = dead[range(len(self)), length.argmax(axis=1)], length.max(axis=1)[:, None]
        e: Array = np.divide(largest, size, out=np.zeros_like(largest), where=size > 0)
        across = dead - (dead * e[:, None]).sum(axis=2)[:, :, None] * e[:, None]
        return np.where(abs(across).max(axis=(1, 2))[:, None] <= PARALLEL * size, e, 0.0)


def _shared_spin(bodies: Sequence[DirectorSystem]) -> tuple[Spin | None, Array | None]:
    """Return the spin that bodies share, and what it is multiplied by for each; a ValueError where tables differ."""
    spins = [body.spin for body in bodies]
    known = [spin for spin in spins if spin is not None]
    if not known:
        return None, None
    if all(len(spin.times) == 1 for spin in known):
        return as_spin(1.0), np.array([0.0 if spin is None else spin.values[0] for spin in spins])
    for k, spin in enumerate(spins):
        if spin is not None and not spin.is_like(known[0]):
            raise ValueError(f"bodies of a stack share one table of spin, that of body {k} is another: run them apart")
    return known[0], np.array([float(spin is not None) for spin in spins])


def stacked(system: DirectorSystem | SystemStack) -> SystemStack:
    """Return `system` as a stack, of one where it is a body."""
    return system if isinstance(system, SystemStack) else _stack_of_one(as_system(system))


@lru_cache(maxsize=64)
def _stack_of_one(system: DirectorSystem) -> SystemStack:
    return SystemStack.of([system])


def members_of(systems: SystemStack, first: int, last: int) -> SystemStack:
    """Return the stack of some members; a stack of one is that of all."""
    if len(systems) == 1:
        return systems
    E, dead = systems.euler_inertia[first:last], systems.dead_force[first:last]
    axis, factor = (None if array is None else array[first:last] for array in (systems.axis, systems.spin_factor))
    return SystemStack(E, axis, dead, systems.name, systems.spin, factor, systems.physical)


def transverse_momentum(systems: SystemStack) -> Array:
    """Return the part of J n orthogonal to the constrained axis n, (m, 3), kg m²: 0 where n is principal."""
    assert systems.axis is not None
    return across(systems.convected_inertia, systems.axis)


def is_principal(systems: SystemStack) -> NDArray[np.bool_]:
    """Whether the constrained axes are principal, to 1e-9 of the largest entry of J, (m,)."""
    largest = abs(systems.convected_inertia).max(axis=(1, 2))
    return np.asarray(abs(transverse_momentum(systems)).max(axis=1) <= PRINCIPAL * largest)


def doubtful(E: Array, axis: Array | None) -> NDArray[np.bool_]:
    """Whether members need the checks of a single body: not symmetric, not far from its limits, no unit axis."""
    doubt: NDArray[np.bool_] = abs(E - E.swapaxes(1, 2)).max(axis=(1, 2)) > SYMMETRY * abs(E).max(axis=(1, 2)) / 2
    doubt |= np.linalg.eigvalsh(E)[:, 0] <= 1e-6 * np.trace(E, axis1=1, axis2=2)
    if axis is not None:
        doubt |= abs(np.sqrt((axis * axis).sum(1)) - 1) > UNIT
    return doubt
