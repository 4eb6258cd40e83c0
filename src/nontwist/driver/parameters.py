"""The parameters of a run by name: how many numbers each has, what they do to the start and to the inputs of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..engine.functions import FUNCTIONS, changes_of_numbers, kind_of, numbers_of
from ..engine.known_steps import INPUTS
from ..geometry.arrays import Array
from ..geometry.tensors import BASIS, ENTRIES
from ..geometry.values import as_list, guess, shown
from ..integrators.compiled import Compiled
from ..integrators.linearised import Changes, Entries, Nodes, is_seen_from_orbit
from ..integrators.load_samples import as_marched
from ..integrators.memory_tangents import FIELDS, NAMES
from ..integrators.problem import IVP
from ..loads.base import is_called, with_moments
from ..loads.derivatives import (
    Slopes,
    fixed_slopes,
    forces_rates,
    moment_rates,
    moment_slopes,
    rotor_slopes,
    table_slopes,
    with_parameter,
)
from ..loads.forces import ForceTable
from ..loads.potentials import GravityGradient
from ..loads.terms import BODY, XYZ, Rotor, Term, chord, own_fields, parameters_of
from ..loads.wheels import Wheel

SYMMETRIC = tuple(f"{i + 1}{j + 1}" for i, j in ENTRIES)
OWN = {  # those that every run has: labels, unit
    "material_angular_velocity": (BODY, "rad s-1"),
    "rotation": (BODY, "rad"),
    "inertia": (SYMMETRIC, "kg m2"),
    "principal_inertia": (BODY, "kg m2"),
    "axis": (BODY, "1"),
    "dead_force": (tuple(f"{i}{x}" for i in BODY for x in XYZ), "N m"),
    "load_scale": (("",), "1"),
    "duration": (("",), "s"),
}
EVERY = ("material_angular_velocity", "rotation")


class Parameter(NamedTuple):
    """Some numbers that a run depends on, side by side among all parameters."""

    name: str
    labels: tuple[str, ...]
    unit: str
    first: int
    term: int | None = None  # of the load
    field: str = ""  # of its record


class Parameters:
    """The parameters that are asked for, of a problem of one body.

    Parameters
    ----------
    problem : IVP
    names : list of str
    scheme : Compiled
    given : str
        The argument that has the names.

    Raises
    ------
    ValueError
        A name is unknown, or has no derivatives.
    """

    def __init__(self, problem: IVP, names: Any, scheme: Compiled, given: str = "wrt") -> None:
        self.problem, self.all, first = problem, list[Parameter](), 0
        # tables of forces along the directors as moments
        self.terms = (problem.load if scheme.is_director_scheme else with_moments(problem.load)).terms
        self._orbits = is_seen_from_orbit(*as_marched(problem, scheme.is_director_scheme), scheme)
        words = [names] if isinstance(names, str) else as_list(names, given)
        known = self._known()
        if not words:
            raise ValueError(f"{given} names no parameter; known are {', '.join(known)}")
        for word in dict.fromkeys(w if isinstance(w, str) else shown(w) for w in words):
            if word not in known:
                raise ValueError(
                    f"{given} has the unknown parameter {word!r}; {self._field(word)}{guess(word, known)}"
                    f"known are {', '.join(known)}"
                )
            for name, labels, unit, term, field in known[word]:
                if all(name != one.name for one in self.all):
                    self.all.append(Parameter(name, tuple(labels), unit, first, term, field))
                    first += len(labels)
        self.count = first
        if problem.load.memories and (bad := next((one.name for one in self.all if not self._is_of_memory(one)), None)):
            raise ValueError(f"runs with memory have derivatives by {NAMES}; {bad} is none of them")
        if scheme.is_director_scheme and scheme.dissipation and any(one.name == "inertia" for one in self.all):
            raise ValueError(
                "energy-momentum with dissipation has no derivatives by the entries of the inertia, which turn the "
                "principal axes that its equations are written in; use principal_inertia"
            )
        self._scale = float(problem.load_scale[0])

    def _known(self) -> dict[str, list[tuple[str, Any, str, int | None, str]]]:
        """Return what each name stands for: names, labels, units, terms of the load and fields of these."""
        known: dict[str, Any] = {name: [(name, labels, unit, None, name)] for name, (labels, unit) in OWN.items()}
        spin = self.problem.systems.spin
        if spin is not None:
            known["spin"] = [("spin", tuple(map(str, range(len(spin.values)))), "rad s-1", None, "spin")]
        for k, term in enumerate(self.terms):
            for field, (labels, unit) in parameters_of(term).items():
                one = f"load[{k}].{field}", labels, unit, k, field
                known[one[0]] = [one]
                if field != "scale":
                    known.setdefault(field, []).append(one)
        return known

    def _field(self, word: str) -> str:
        """Return what a message says of a field of a term that is not a parameter; "" for any other word."""
        for k, term in enumerate(self.terms):
            if word.removeprefix(f"load[{k}].") in own_fields(type(term)):
                its = ", ".join(f"load[{k}].{name}" for name in parameters_of(term))
                return f"runs have no derivatives with respect to this field of load[{k}]; its parameters are {its}; "
        return ""

    @property
    def _drawn(self) -> list[GravityGradient]:
        """The terms that know the inertia."""
        return [term for term in self.terms if isinstance(term, GravityGradient)]

    def _is_of_memory(self, one: Parameter) -> bool:
        """Whether runs with memory have derivatives by a parameter."""
        return (
            one.name in EVERY if one.term is None else isinstance(self.terms[one.term], Wheel) and one.field in FIELDS
        )

    @property
    def of_wheels(self) -> list[tuple[int, str] | None]:
        """The number of a wheel and the name of its field, for each number; None: another parameter."""
        numbers = [k for k, term in enumerate(self.terms) if isinstance(term, Wheel)]
        return [
            None if one.term is None else (numbers.index(one.term), one.field) for one in self.all for _ in one.labels
        ]

    @property
    def labels(self) -> list[str]:
        """A name for each number."""
        return [f"{one.name}[{label}]" if label else one.name for one in self.all for label in one.labels]

    @property
    def units(self) -> list[str]:
        """The unit of each number."""
        return [one.unit for one in self.all for _ in one.labels]

    @property
    def inputs(self) -> set[str]:
        """The inputs of the steps that the parameters act on."""
        found = set[str]()
        for one in self.all:
            found |= self._inputs_of(one)
        return found

    def _inputs_of(self, one: Parameter) -> set[str]:
        plain = {"inertia": {"inertia"}, "principal_inertia": {"inertia"}, "axis": {"axis"}, "dead_force": {"dead"}}
        if one.field in plain and one.term is None:
            return plain[one.field] | ({"terms"} if one.field.endswith("inertia") and self._drawn else set())
        if one.field in ("material_angular_velocity", "rotation"):
            return {"rotor"} if self._wheels and one.field != "rotation" else set()
        if one.field == "spin":
            return {"spin"}
        terms = self.terms if one.term is None else (self.terms[one.term],)
        found = {"step"} if one.field == "duration" else set()
        for term in terms:
            if isinstance(term, Rotor | Wheel):
                found |= {"rotor", "rate"}
            elif term.kind in ("body", "space"):
                found.add("moving" if term.kind == "body" else "space")
            elif is_called(term):
                found |= self._inputs_of_called(one, term)
            elif one.field != "duration":
                found.add("damping" if term.kind == "state" else "dead")
        if one.field == "duration" and self.problem.systems.spin is not None:
            found.add("spin")
        return found

    def _inputs_of_called(self, one: Parameter, term: Term) -> set[str]:
        if one.field == "load_scale":
            return {"factor"}
        if isinstance(term, ForceTable):
            return {"forces"}
        if one.field == "duration":
            return {"time"}
        return {"terms", "orbit"} if self._orbits and one.field == "mean_motion" else {"terms"}

    @property
    def changes(self) -> list[Changes]:
        """What the numbers of terms that depend on the state change by, for each number of the input "terms"."""
        return [change for one in self.all for change in self._changes_of(one)]

    def _changes_of(self, one: Parameter) -> list[Changes]:
        """Return what each number of a parameter does to the numbers of terms."""
        if one.term is None:
            if not self._drawn or not one.field.endswith("inertia"):
                return []
            columns = self._inertias(one.field)
            return [[(term, changed(term.of_body, 0.0 * dJ, dJ, 1.0)) for term in self._drawn] for dJ in columns]
        term = self.terms[one.term]
        if not is_called(term) or isinstance(term, ForceTable):
            return []
        if kind_of(term) in FUNCTIONS and one.field != "scale":
            return [[(term, change)] for change in changes_of_numbers(term, one.field)]
        value, make = np.asarray(getattr(term, one.field)), partial(with_parameter, term, one.field)
        units = BASIS if one.field == "quadratic" else np.eye(value.size).reshape(-1, *value.shape)
        size = float(abs(value).max()) or 1.0
        size = min(size, 1 - size) if one.field == "eccentricity" else size
        return [[(term, changed(make, value, unit, size))] for unit in units]

    @property
    def needs_velocity(self) -> bool:
        """Whether the change of the first state depends on its velocity."""
        return any(one.field == "axis" and one.term is None for one in self.all)

    @property
    def are_scaled(self) -> bool:
        """Whether what they do depends on the factor of the load."""
        return any(one.term is not None or one.field == "duration" for one in self.all)

    def start(self, rows: int, velocity: Array, removed: float = 0.0) -> Array:
        """Return the change of the first state by each number, (rows, count), of a run that starts with W.

        Of the velocity that was given, a part of this size along the axis has been `removed`: with c the prescribed
        spin, W = (I - n⊗n) given + c n turns with the axis by c dn - (dn (n·given) + n (dn·given)).
        """
        found = np.zeros((rows, self.count))
        systems, W = self.problem.systems, velocity
        n = None if systems.axis is None else systems.axis[0]
        across = np.eye(3) if n is None else np.eye(3) - np.outer(n, n)
        for one in self.all:
            at = slice(one.first, one.first + len(one.labels))
            if one.field == "rotation":
                found[:3, at] = np.eye(3)
            elif one.field == "material_angular_velocity":
                found[3:6, at] = across
            elif one.field == "axis" and n is not None:
                c = 0.0 if systems.spin is None else float(systems.spin_at(self.problem.t_start)[0])
                found[3:6, at] = (c - removed) * across - np.outer(n, across @ W)
            elif one.field == "spin" and n is not None:
                found[3:6, at] = np.outer(n, self._spin_weights(np.array([self.problem.t_start]))[0])
        return found

    def entries(self, nodes: Nodes) -> Iterator[Entries]:
        """Yield what the parameters do to the inputs of some steps."""
        place = 0
        for one in self.all:
            if changes := self._changes_of(one):
                k = np.arange(len(changes))
                yield Entries("terms", place + k, one.first + k, np.ones(len(k)))
                place += len(k)
            if one.field in ("inertia", "principal_inertia") and one.term is None:
                columns = np.array([[dJ[e] for dJ in self._inertias(one.field)] for e in ENTRIES])
                entry, parameter = np.nonzero(columns)
                yield Entries("inertia", entry, one.first + parameter, columns[entry, parameter])
            elif one.field == "axis" and one.term is None:
                yield from self._of_axis(one.first)
            elif one.field == "dead_force":
                k = np.arange(9)
                yield Entries("dead", k, one.first + k, np.ones(9))
            elif one.field == "spin":
                yield self._of_spin(one.first, nodes)
            elif one.field == "duration":
                yield from self._of_duration(one.first, nodes)
            elif one.field == "material_angular_velocity" and one.term is None and self._wheels:
                yield from self._of_velocity(one.first, nodes)
            elif one.field == "load_scale":
                if any(map(is_called, self.terms)):
                    yield _at_all("factor", one.first)
                for term in self.terms:
                    if not is_called(term):
                        yield from self._of_term(term, "scale", one.first, nodes, term.scale)
            elif one.term is not None:
                yield from self._of_term(self.terms[one.term], one.field, one.first, nodes, self._scale)

    def entries_along(self, directions: Array, nodes: Nodes) -> Iterator[Entries]:
        """Yield what a change of all parameters at once does, along each of the `directions`, (count, d)."""
        d = directions.shape[1]
        for name, component, parameter, value, step in self.entries(nodes):
            along = (value[:, None] * directions[parameter]).ravel()
            which = np.tile(np.arange(d), len(value))
            yield Entries(name, np.repeat(component, d), which, along, None if step is None else np.repeat(step, d))

    def _inertias(self, field: str) -> Array:
        """Return the changes of the inertia by the numbers of a parameter, (count, 3, 3)."""
        if field == "inertia":
            return BASIS
        Q = principal_axes(self.problem.systems.convected_inertia[0])
        return np.array([np.outer(q, q) for q in Q.T])

    @property
    def _wheels(self) -> tuple[Wheel, ...]:
        return self.problem.load.wheels

    def _of_velocity(self, first: int, nodes: Nodes) -> Iterator[Entries]:
        """Yield what the first velocity does to the axial momenta of wheels, whose first speeds are given."""
        n = self.problem.systems.axis
        across = np.eye(3) if n is None else np.eye(3) - np.outer(n[0], n[0])
        locked = sum((one.locked for one in self._wheels), np.zeros((3, 3))) @ across
        component, parameter = np.indices((3, 3)).reshape(2, -1)
        for j in range(len(nodes.middles)):
            yield Entries("rotor", 3 * j + component, first + parameter, locked.ravel())

    def _of_axis(self, first: int) -> Iterator[Entries]:
        if self.problem.systems.axis is None:
            return
        n = self.problem.systems.axis[0]
        component, parameter = np.indices((3, 3)).reshape(2, -1)
        yield Entries("axis", component, first + parameter, (np.eye(3) - np.outer(n, n)).ravel())

    def _spin_weights(self, times: Array) -> Array:
        """Return the derivatives of the spin at (n,) times by the values of its table, (n, k).

        They are those of the body, which a stack may hold as a factor.
        """
        spin = self.problem.systems.spin
        assert spin is not None
        return np.stack([np.interp(times, spin.times, row) for row in np.eye(len(spin.values))], axis=1)

    def _of_spin(self, first: int, nodes: Nodes) -> Entries:
        change = self._spin_weights(nodes.end) - self._spin_weights(nodes.begin)
        step, k = np.nonzero(change)
        return Entries("spin", 0 * k, first + k, change[step, k], nodes.first + step)

    def _of_term(self, term: Term, field: str, first: int, nodes: Nodes, factor: float) -> Iterator[Entries]:
        """Yield what a parameter of a term does, times a factor."""
        if isinstance(term, Wheel):
            t0 = self.problem.t_start
            rows = (term.slopes_of_momentum(field, t - t0)[:, None] * term.direction for t in (nodes.begin, nodes.end))
            begin, end = (Slopes(*_rows(one)) for one in rows)
            yield from _rotor(begin, end, first, nodes, factor)
        elif isinstance(term, Rotor):
            begin, end = (rotor_slopes(term, field, t) for t in (nodes.begin, nodes.end))
            yield from _rotor(begin, end, first, nodes, factor)
        elif isinstance(term, ForceTable):
            yield _nodal("forces", table_slopes(term, field, nodes.times), first, nodes, 1.0)
        elif is_called(term):
            if self._orbits and field == "mean_motion":
                yield _at_all("orbit", first)
        elif term.kind in ("body", "space"):
            slopes = moment_slopes(term, field, nodes.times)
            yield _nodal("moving" if term.kind == "body" else "space", slopes, first, nodes, factor)
        else:
            fixed = fixed_slopes(term, field)
            name = "damping" if term.kind == "state" else "dead"
            yield Entries(name, fixed.component, first + fixed.parameter, factor * fixed.value)

    def _of_duration(self, first: int, nodes: Nodes) -> Iterator[Entries]:
        """Yield what a longer last stretch, with as many steps, does: longer steps, and later nodes."""
        problem, scale = self.problem, self._scale
        if self._wheels:
            raise ValueError("runs with wheels have no derivatives by the duration")
        begin = max(problem.grid.numbers[-2], 0)
        share = 1.0 / (problem.steps - begin)
        steps = np.arange(max(nodes.first, begin), nodes.last)
        if not len(steps):
            return
        every = np.zeros(1, dtype=np.int64) if begin == 0 else 0 * steps
        yield Entries("step", every, first + every, np.full(len(every), share), None if begin == 0 else steps)
        later = np.maximum(nodes.of_nodes - begin + np.tile(nodes.middles, nodes.last - nodes.first), 0.0) * share
        later[nodes.of_nodes < begin] = 0.0
        at = np.maximum(np.arange(nodes.first, nodes.last + 1) - begin, 0) * share
        if "time" in self._inputs_of(next(one for one in self.all if one.field == "duration")):
            k = np.arange(nodes.first, nodes.last)
            yield Entries("time", 0 * k, first + 0 * k, at[:-1], k)
        for term in self.terms:
            if isinstance(term, ForceTable):
                drift = term.scale * forces_rates(term, nodes.times) * later[:, None]
                yield _nodal("forces", Slopes(*_rows(drift)), first, nodes, 1.0)
            elif isinstance(term, Rotor):
                chords = [term.scale * chord(term.times, term.values, t) for t in (nodes.begin, nodes.end)]
                moved = [
                    Slopes(*_rows((rate * by)[:, None] * term.rotor))
                    for rate, by in zip(chords, (at[:-1], at[1:]), strict=True)
                ]
                yield from _rotor(moved[0], moved[1], first, nodes, scale)
                change = term.scale * (term.momentum(nodes.end) - term.momentum(nodes.begin))
                change *= -(at[1:] - at[:-1])[:, None] / (nodes.sizes**2)[:, None]
                row, component, _, value = _rows(change)
                yield Entries("rate", component, first + 0 * component, scale * value, nodes.first + row)
            elif term.kind in ("body", "space"):
                drift = moment_rates(term, nodes.times) * later[:, None]
                name = "moving" if term.kind == "body" else "space"
                yield _nodal(name, Slopes(*_rows(drift)), first, nodes, scale)
        spin, factor = problem.systems.spin, problem.systems.spin_factor
        if spin is not None and factor is not None:
            change = factor[0] * (
                chord(spin.times, spin.values, nodes.end) * at[1:]
                - chord(spin.times, spin.values, nodes.begin) * at[:-1]
            )
            k = np.arange(len(change))
            yield Entries("spin", 0 * k, first + 0 * k, change, nodes.first + k)


def principal_axes(J: Array) -> Array:
    """Return the axes that `principal_inertia` is about, as columns."""
    return np.eye(3) if np.array_equal(J, np.diag(J.diagonal())) else np.linalg.eigh(J)[1]


def changed(make: Callable[[Array], Term], value: Array, unit: Array, size: float) -> Array:
    """Return what the numbers of a term, at most quadratic in a value, change by along a unit; about its size."""
    ahead, behind = (numbers_of(make(value + x * unit)) for x in (size / 2, -size / 2))
    found: Array = (ahead - behind) / size
    return found


def _at_all(name: str, parameter: int) -> Entries:
    """Return that a parameter is an input of all steps."""
    return Entries(name, np.zeros(1, dtype=np.int64), np.array([parameter]), np.ones(1))


def _rows(rows: Array) -> tuple[Any, Any, Any, Any]:
    row, component = np.indices(rows.shape).reshape(2, -1)
    return row, component, 0 * row, rows.ravel()


def _nodal(name: str, slopes: Slopes, first: int, nodes: Nodes, factor: float) -> Entries:
    place = INPUTS[name] * (slopes.row % len(nodes.middles)) + slopes.component
    return Entries(name, place, first + slopes.parameter, factor * slopes.value, nodes.of_nodes[slopes.row])


def _rotor(begin: Slopes, end: Slopes, first: int, nodes: Nodes, factor: float) -> Iterator[Entries]:
    """Yield the changes of the momentum of a rotor at the nodes, on the chords of the steps, and of its rate."""
    steady = all(np.array_equal(one, other) for one, other in zip(begin, end, strict=True))
    for sign, slopes in ((-1.0, begin), (1.0, end)):
        step, parameter = nodes.first + slopes.row, first + slopes.parameter
        value = factor * slopes.value
        if not steady:  # else they cancel
            yield Entries("rate", slopes.component, parameter, sign * value / nodes.sizes[slopes.row], step)
        for j, c in enumerate(nodes.middles.tolist()):
            weight = c if sign > 0 else 1.0 - c
            yield Entries("rotor", 3 * j + slopes.component, parameter, weight * value, step)
