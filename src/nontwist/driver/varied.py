"""A run as a function of some of its numbers, with its derivatives along and against them: what autodiff needs.

The numbers are those that `sensitivities` takes derivatives by, here as arrays of the shape in which they are given to
the package. Attitudes and symmetric matrices are not free, so what a change t of their entries means is agreed on:

    rotation Λ, (3, 3)    the nearest rotation: a turn by δ = vee(skew(Λᵀ t)) in the body
    inertia J, (3, 3)     the symmetric part of t, as for all symmetric matrices
    axis n, (3,)          the direction: t / |n|, of which the part across n counts

These are the derivatives of f(nearest rotation), f((J + Jᵀ)/2), f(n/|n|), which extend f from the rotations, the
symmetric matrices and the unit vectors to all arrays; they agree with f there. So a change that keeps Λ a rotation has
its exact derivative, whatever function of other numbers made Λ. What is returned are matrices too, with dΛ = Λ hat(δ).

`push` and `pull` are transposes of each other: along one direction one column is carried forward, and of one function
of the states one row back, whatever the number of parameters. Where that is less, all columns are carried.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..geometry.arrays import Array, as_array, axial
from ..geometry.attitudes import ENTRIES, attitudes
from ..geometry.rotations import hat
from ..integrators.ivp import segmented
from ..loads import Load
from ..loads.load import of_body
from ..loads.load_derivatives import with_parameter
from ..models.spin import Spin
from ..models.stack import stacked
from ..models.system import DirectorSystem, euler_inertia
from .derivatives import Solved, differentiable, linearised_by
from .ensembles import NAME, Propagator
from .grid import stored_steps
from .parameters import SYMMETRIC, Parameter, Parameters, principal_axes
from .planning import Plan
from .single_run import Prepared
from .starts import Starts, starts

MATRICES = ("rotation", "inertia", "dead_force")
OF_START = {NAME, "rotation", "load_scale"}  # what a propagator takes
Values = Mapping[str, Array]


class Varied:
    """A prepared problem of one body as a function of some of its numbers.

    Parameters
    ----------
    system : DirectorSystem
    plan : Plan
        With a grid.
    rotation, velocity : of the start, where they are not varied
    project : bool

    Raises
    ------
    ValueError
        The integrator or the load has no derivatives.
    """

    def __init__(self, system: DirectorSystem, plan: Plan, rotation: Any, velocity: Array, project: bool) -> None:
        self.system, self.plan, self.project = system, plan, project
        self._start: dict[str, Any] = {"rotation": rotation, NAME: velocity}
        assert plan.grid is not None
        self._steps, self._named = plan.grid.steps, dict[tuple[str, ...], dict[str, Parameter]]()
        self.count = len(stored_steps(self._steps, plan.store))
        self._problem = differentiable(plan, self._begin(system, {}))
        self._propagator = Propagator(system, plan, project)
        self.terms = list(Parameters(self._problem, NAME, linearised_by(plan)).terms)

    def named(self, names: Sequence[str]) -> dict[str, Parameter]:
        """Return the parameters of names, refused where they are unknown or stand for several."""
        key = tuple(names)
        try:
            return self._named[key]
        except (KeyError, TypeError):  # keys that are no names are refused below
            found = dict[str, Parameter]()
        for name in key:
            own = Parameters(self._problem, [name], linearised_by(self.plan), "params").all
            if len(own) > 1:
                known = ", ".join(one.name for one in own)
                raise ValueError(f"params has {name!r}, but several terms of the load have it; give one of {known}")
            for other, known_one in found.items():
                if known_one.name == own[0].name:
                    raise ValueError(f"params has {other!r} and {name!r}, which are the same; give only one of them")
            found[name] = own[0]
        if {"inertia", "principal_inertia"} <= set(found):
            raise ValueError("params has inertia and principal_inertia; give only one of them")
        self._named[key] = found
        return found

    def shape(self, one: Parameter) -> tuple[int, ...]:
        """Return the shape in which a parameter is given."""
        if one.term is not None:
            return np.shape(getattr(self.terms[one.term], one.field))
        if one.name in MATRICES:
            return 3, 3
        return () if one.labels == ("",) else (len(one.labels),)

    def run(self, values: Values) -> tuple[Array, Array]:
        """Return the stored attitudes Λ, (n, 3, 3), and velocities W, (n, 3)."""
        is_plain = OF_START.issuperset(values)
        found = self._propagator(**self._plain(values)) if is_plain else Prepared(*self._with(values)).run()
        return attitudes(found.quaternion), found.material_angular_velocity

    def push(self, values: Values, tangents: Values) -> tuple[Array, Array]:
        """Return the changes of attitudes, (d, n, 3, 3), and velocities, (d, n, 3), along d changes of parameters."""
        named = self.named(list(tangents))
        columns = [_inwards(one, values[name], tangents[name]) for name, one in named.items()]
        along = np.concatenate(columns, axis=1).T
        R, found = self._derived(values, list(named))
        changes = found.changes(along) if isinstance(found, Solved) else found @ along
        return R @ hat(np.moveaxis(changes[:, :3], 2, 0)), np.moveaxis(changes[:, 3:], 2, 0)

    def pull(self, values: Values, names: Sequence[str], by_attitude: Array, by_velocity: Array) -> dict[str, Array]:
        """Return the derivatives of d functions by the parameters, (d, ...), from those by the states.

        The latter are by the entries of Λ, (d, n, 3, 3), and by W, (d, n, 3).
        """
        named = self.named(names)
        R, derived = self._derived(values, list(names))
        turning = axial(np.einsum("nji,dnjk->dnik", R, by_attitude))
        rows = np.concatenate([turning, by_velocity], axis=2)
        if isinstance(derived, Solved) and len(rows) < derived.parameters.count:
            found = np.stack([derived.slopes(one) for one in rows])
        else:
            jacobian = derived.changes() if isinstance(derived, Solved) else derived
            found = np.einsum("dni,nik->dk", rows, jacobian)
        result, at = {}, 0
        for name, one in named.items():
            k = len(one.labels)
            result[name] = _outwards(one, values[name], found[:, at : at + k], self.shape(one))
            at += k
        return result

    def _derived(self, values: Values, names: list[str]) -> tuple[Array, Solved | Array]:
        """Return the attitudes, and the run with its derivatives; of a start alone these, (n, 6, count)."""
        if OF_START.issuperset(values):
            plain = self._plain(values)
            R = attitudes(self._propagator(**plain).quaternion)
            return R, np.concatenate(self._propagator.jacobian(wrt=tuple(names), **plain), axis=1)
        solved = Solved(*self._with(values), names)
        return attitudes(solved.run.quaternion[solved.rows]), solved

    def _plain(self, values: Values) -> dict[str, Any]:
        return {**self._start, **{name: value if value.ndim else float(value) for name, value in values.items()}}

    def _begin(self, system: DirectorSystem, values: Values) -> Starts:
        own = {**self._start, **{name: values[name] for name in values if name in OF_START}}
        return starts(system, **own, project=self.project, t_start=self.plan.t_start)

    def _with(self, values: Values) -> tuple[Plan, Starts]:
        """Return the plan and the start with these values."""
        system, terms, plan = self.system, self.terms.copy(), self.plan
        euler = partial(euler_inertia, physical=system.physical, axis=system.axis)
        for name, one in self.named(list(values)).items():
            value = as_array(values[name], name, self.shape(one))
            if one.labels == SYMMETRIC:
                value = (value + value.T) / 2
            if one.term is not None:
                terms[one.term] = with_parameter(terms[one.term], one.field, value)
            elif one.field == "inertia":
                system = replace(system, euler_inertia=euler(value))
            elif one.field == "principal_inertia":
                Q = principal_axes(self.system.inertia)
                system = replace(system, euler_inertia=euler((Q * value) @ Q.T))
            elif one.field == "dead_force":
                system = replace(system, dead_force=value)
            elif one.field == "axis" and system.axis is not None:
                system = replace(system, axis=value)
            elif one.field == "spin":
                if not value.any():
                    raise ValueError("spin is zero at all times, as if none were prescribed: give another value")
                system = replace(system, spin=Spin(self.system.spin.times, value))
            elif one.field == "duration":
                if value <= 0:
                    raise ValueError(f"duration must be positive, got {value:g} s")
                end = plan.t_start + float(value)
                plan = plan._replace(t_end=end, grid=segmented((plan.t_start, end), (self._steps,)))
        if terms != self.terms or system is not self.system:
            load = of_body(Load(tuple(terms)), system.inertia)
            plan = plan._replace(load=load, systems=stacked(system))
        return plan, self._begin(system, values)


def _inwards(one: Parameter, value: Array, tangent: Array) -> Array:
    """Return what changes of a parameter as it is given are to `Parameters`, (d, count)."""
    if one.name == "rotation":
        return axial(np.einsum("ji,djk->dik", value, tangent)) / 2
    if one.labels == SYMMETRIC:
        return np.stack([(tangent[:, i, j] + tangent[:, j, i]) / 2 for i, j in ENTRIES], axis=1)
    return tangent.reshape(len(tangent), -1) / _length(one, value)


def _outwards(one: Parameter, value: Array, slopes: Array, shape: tuple[int, ...]) -> Array:
    """Return the transpose of `_inwards`: derivatives by a parameter as it is given, (d, ...)."""
    if one.name == "rotation":
        return value @ hat(slopes) / 2
    if one.labels == SYMMETRIC:
        found = np.zeros((len(slopes), 3, 3))
        for k, (i, j) in enumerate(ENTRIES):
            found[:, i, j] += slopes[:, k] / 2
            found[:, j, i] += slopes[:, k] / 2
        return found
    return (slopes / _length(one, value)).reshape(len(slopes), *shape)


def _length(one: Parameter, value: Array) -> float:
    """Return the length by which a parameter is divided before it acts, that of an axis."""
    return float(np.linalg.norm(value)) if one.field in ("axis", "rotor", "wheel") else 1.0
