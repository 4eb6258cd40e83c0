"""The parameters of a run by name: how many numbers each has, what they do to the start and to the inputs of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..engine.functions import FUNCTIONS, changes_of_numbers, kernel_kind, numbers_of
from ..engine.known_steps import INPUTS
from ..geometry.arrays import Array
from ..geometry.attitudes import BASIS, ENTRIES
from ..geometry.values import as_list, guess, short_repr
from ..integrators.compiled import Compiled
from ..integrators.linearised import Changes, Entries, StepNodes
from ..integrators.load_samples import as_marched, orbit_of
from ..integrators.memory_tangents import FIELDS, NAMES
from ..integrators.problem import IVP
from ..loads.base import is_called, tables_as_moments
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
from ..loads.memory import Wheel
from ..loads.potentials import ForceTable, GravityGradient
from ..loads.terms import BODY, XYZ, Rotor, Term, chord, own_fields, parameters_of

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


class Effect(NamedTuple):
    """What a parameter does to some of the inputs of steps."""

    inputs: tuple[str, ...]
    entries: Callable[[StepNodes], Iterable[Entries]]


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
        self.terms = (problem.load if scheme.is_director_scheme else tables_as_moments(problem.load)).terms
        self._orbits = orbit_of(*as_marched(problem, scheme.is_director_scheme), 1.0, scheme) is not None
        words = [names] if isinstance(names, str) else as_list(names, given)
        known = self._known()
        its = {name: [Parameter(*one[:3], 0, *one[3:]) for one in many] for name, many in known.items()}
        able = ", ".join(
            k for k, many in its.items() if not problem.load.memories or all(map(self._is_of_memory, many))
        )
        if not words:
            raise ValueError(f"{given} names no parameter; known are {able}")
        for word in dict.fromkeys(w if isinstance(w, str) else short_repr(w) for w in words):
            if word not in known:
                raise ValueError(
                    f"{given} has the unknown parameter {word!r}; {self._field(word)}{guess(word, known)}"
                    f"known are {able}"
                )
            for name, labels, unit, term, field in known[word]:
                if all(name != one.name for one in self.all):
                    self.all.append(Parameter(name, tuple(labels), unit, first, term, field))
                    first += len(labels)
        self.count = first
        if problem.load.memories and (bad := next((one.name for one in self.all if not self._is_of_memory(one)), None)):
            raise ValueError(f"runs with memory have derivatives by {NAMES}; {bad} is none of them")
        turning, beside = [one.name for one in self.all if len(self.inertias_of(one))], bool(problem.load.wheels)
        if scheme.is_director_scheme and scheme.dissipation and (turning if beside else "inertia" in turning):
            what = "inertias beside wheels" if beside else "the entries of the inertia"
            raise ValueError(
                f"energy-momentum with dissipation has no derivatives by {what}, which turn the principal axes that "
                f"its equations are written in; {'leave dissipation out' if beside else 'use principal_inertia'}"
            )
        self._scale = float(problem.load_scale[0])
        self.changes = list[Changes]()  # of the numbers of terms that depend on the state, for each of "terms"
        self._effects = [effect for one in self.all for effect in self._effects_of(one)]

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
                if field != "scale" and field not in OWN:
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
        if one.term is None:
            return one.name in (*EVERY, "inertia", "principal_inertia") and not (self._drawn and "inertia" in one.name)
        return isinstance(self.terms[one.term], Wheel) and one.field in FIELDS

    @property
    def of_wheels(self) -> list[tuple[int, str, int] | None]:
        """The number of a wheel, the name of its field, and the component, for each number; None: another parameter."""
        numbers = [k for k, term in enumerate(self.terms) if isinstance(term, Wheel)]
        each = ((one, k) for one in self.all for k in range(len(one.labels)))
        return [None if one.term is None else (numbers.index(one.term), one.field, k) for one, k in each]

    @property
    def inertias(self) -> Array:
        """The changes of the inertia, of a body with wheels that of their carrier, by each number, (count, 3, 3)."""
        found = np.zeros((self.count, 3, 3))
        for one in self.all:
            if len(own := self.inertias_of(one)):
                found[one.first : one.first + len(own)] = own
        return found

    @property
    def labels(self) -> list[str]:
        """A name for each number."""
        return [f"{one.name}[{label}]" if label else one.name for one in self.all for label in one.labels]

    @property
    def units(self) -> list[str]:
        """The unit of each number."""
        return [one.unit for one in self.all for _ in one.labels]

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
        if kernel_kind(term) in FUNCTIONS and one.field != "scale":
            return [[(term, change)] for change in changes_of_numbers(term, one.field)]
        value, make = np.asarray(getattr(term, one.field)), partial(with_parameter, term, one.field)
        units = BASIS if one.field == "quadratic" else np.eye(value.size).reshape(-1, *value.shape)
        size = float(abs(value).max()) or 1.0
        size = min(size, 1 - size) if one.field == "eccentricity" else size
        return [[(term, changed(make, value, unit, size))] for unit in units]

    @property
    def needs_velocity(self) -> bool:
        """Whether the change of the first state depends on its velocity."""
        return any(one.name == "axis" for one in self.all)

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
            if one.term is not None:
                continue
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

    @property
    def inputs(self) -> set[str]:
        """The inputs of the steps that the parameters act on."""
        return {name for effect in self._effects for name in effect.inputs}

    def entries(self, nodes: StepNodes) -> Iterator[Entries]:
        """Yield what the parameters do to the inputs of some steps."""
        for effect in self._effects:
            yield from effect.entries(nodes)

    def entries_along(self, directions: Array, nodes: StepNodes) -> Iterator[Entries]:
        """Yield what a change of all parameters at once does, along each of the `directions`, (count, d)."""
        d = directions.shape[1]
        for name, component, parameter, value, step in self.entries(nodes):
            along = (value[:, None] * directions[parameter]).ravel()
            which = np.tile(np.arange(d), len(value))
            yield Entries(name, np.repeat(component, d), which, along, None if step is None else np.repeat(step, d))

    # ---- what each parameter does

    def _effects_of(self, one: Parameter) -> Iterator[Effect]:
        """Yield what a parameter does; `changes` are those of the parameters before it, and become its own too."""
        systems, first, n = self.problem.systems, one.first, self.problem.systems.axis
        if changes := self._changes_of(one):
            k = np.arange(len(changes))
            yield _always("terms", len(self.changes) + k, first + k, np.ones(len(k)))
            self.changes += changes
        if one.field in ("axis", "spin") and n is not None and self.problem.load.wheels:
            raise ValueError(f"runs with wheels have no derivatives by {one.field}, which their momenta begin with")
        if len(inertias := self.inertias_of(one)):
            columns = np.array([[dJ[e] for dJ in inertias] for e in ENTRIES])
            entry, parameter = np.nonzero(columns)
            yield _always("inertia", entry, first + parameter, columns[entry, parameter])
        if one.term is not None:
            yield from self._effects_of_term(self.terms[one.term], one.field, first, self._scale)
        elif one.field == "axis" and n is not None:
            yield _matrix("axis", np.eye(3) - np.outer(n[0], n[0]), first)
        elif one.field == "dead_force":
            yield _always("dead", np.arange(9), first + np.arange(9), np.ones(9))
        elif one.field == "spin":
            yield Effect(("spin",), partial(self._of_spin, first))
        elif one.field == "material_angular_velocity" and self.problem.load.wheels:
            across = np.eye(3) if n is None else np.eye(3) - np.outer(n[0], n[0])
            locked = sum((wheel.locked for wheel in self.problem.load.wheels), np.zeros((3, 3))) @ across
            yield Effect(("rotor",), partial(_at_middles, _matrix("rotor", locked, first)))
        elif one.field == "load_scale":
            if any(map(is_called, self.terms)):
                yield _always("factor", [0], [first], [1.0])
            for term in self.terms:
                if not is_called(term):
                    yield from self._effects_of_term(term, "scale", first, term.scale)
        elif one.field == "duration":
            own = ("spin",) if systems.spin is not None else ()
            yield Effect(("step", *own), partial(self._longer, first))
            if any(is_called(term) and not isinstance(term, ForceTable) for term in self.terms):
                yield Effect(("time",), partial(self._later, first))
            for term in self.terms:
                if isinstance(term, Rotor | Wheel):
                    yield Effect(("rotor", "rate"), partial(self._later_rotor, term, first))
                elif isinstance(term, ForceTable) or (term.kind in ("body", "space") and not is_called(term)):
                    yield Effect((_input_of(term),), partial(self._later_moment, term, first))

    def _effects_of_term(self, term: Term, field: str, first: int, factor: float) -> Iterator[Effect]:
        """Yield what a parameter of a term does, times a factor."""
        name = _input_of(term)
        if isinstance(term, Rotor | Wheel):
            yield Effect(("rotor", "rate"), partial(self._of_rotor, term, field, first, factor))
        elif isinstance(term, ForceTable):
            yield Effect((name,), lambda nodes: [_nodal(name, table_slopes(term, field, nodes.times), first, nodes)])
        elif is_called(term):
            if self._orbits and field == "mean_motion":
                yield _always("orbit", [0], [first], [1.0])
        elif term.kind in ("body", "space"):
            yield Effect(
                (name,), lambda nodes: [_nodal(name, moment_slopes(term, field, nodes.times), first, nodes, factor)]
            )
        else:
            fixed = fixed_slopes(term, field)
            yield _always(name, fixed.component, first + fixed.parameter, factor * fixed.value)

    def inertias_of(self, one: Parameter) -> Array:
        """Return the changes of the inertia, of a body with wheels that of their carrier, (count or 0, 3, 3)."""
        if one.term is None:
            return self._inertias(one.field) if one.field in ("inertia", "principal_inertia") else np.zeros((0, 3, 3))
        wheel = self.terms[one.term]
        if not isinstance(wheel, Wheel) or one.field not in ("inertia", "wheel"):
            return np.zeros((0, 3, 3))
        n = wheel.direction
        if one.field == "inertia":
            return -np.outer(n, n)[None]
        across = np.eye(3) - np.outer(n, n)
        return -wheel.inertia * (across[:, :, None] * n + n[:, None] * across[:, None])

    def _inertias(self, field: str) -> Array:
        """Return the changes of the inertia by the numbers of a parameter, (count, 3, 3)."""
        if field == "inertia":
            return BASIS
        Q = principal_axes(self.problem.systems.convected_inertia[0])
        return np.array([np.outer(q, q) for q in Q.T])

    def _spin_weights(self, times: Array) -> Array:
        """Return the derivatives of the spin at (n,) times by the values of its table, (n, k).

        They are those of the body, which a stack may hold as a factor.
        """
        spin = self.problem.systems.spin
        assert spin is not None
        return np.stack([np.interp(times, spin.times, row) for row in np.eye(len(spin.values))], axis=1)

    def _of_spin(self, first: int, nodes: StepNodes) -> Iterator[Entries]:
        change = self._spin_weights(nodes.end) - self._spin_weights(nodes.begin)
        step, k = np.nonzero(change)
        yield Entries("spin", 0 * k, first + k, change[step, k], nodes.first + step)

    def _of_rotor(
        self, term: Rotor | Wheel, field: str, first: int, factor: float, nodes: StepNodes
    ) -> Iterator[Entries]:
        """Yield what a parameter of a rotor, or of a wheel whose momentum is known, does to its momentum."""
        ends = nodes.begin, nodes.end
        if isinstance(term, Wheel):
            begin, end = (Slopes.of(self.slopes_of_wheel(term, field, t, factor)) for t in ends)
            factor = 1.0
        else:
            begin, end = (rotor_slopes(term, field, t) for t in ends)
        yield from _rotor(begin, end, first, nodes, factor)

    def slopes_of_wheel(self, wheel: Wheel, field: str, times: Array, factor: float) -> Array:
        """Return the derivatives of h n of a wheel at (n,) times by a parameter, (n, 3, count)."""
        n, own, t0, systems = wheel.direction, factor * wheel.scale, self.problem.t_start, self.problem.systems
        if field not in ("inertia", "wheel"):
            return factor * (wheel.slopes_of_momentum(field, times, t0)[:, None] * n)[..., None]
        W = self.problem.velocity[0] + (0.0 if systems.axis is None else systems.spin_at(t0)[0] * systems.axis[0])
        speed = own * wheel.speed + n @ W
        if field == "inertia":
            return np.tile(speed * n, (len(times), 1))[..., None]
        if wheel.times.size:
            raise ValueError("runs have no derivatives by the axis of a wheel whose torque is a table")
        across, h = np.eye(3) - np.outer(n, n), wheel.inertia * speed + own * wheel.impulse(times - t0)
        return h[:, None, None] * across + wheel.inertia * np.outer(n, across @ W)

    # ---- a longer last stretch, with as many steps: longer steps, and later nodes

    def _later_by(self, nodes: StepNodes) -> tuple[Array, Array, int]:
        """Return by how much later steps begin, and the last one ends, and nodes are; the first step that is longer."""
        begin = max(self.problem.grid.numbers[-2], 0)
        share = 1.0 / (self.problem.steps - begin)
        at = np.maximum(np.arange(nodes.first, nodes.last + 1) - begin, 0) * share
        later = np.maximum(nodes.of_nodes - begin + np.tile(nodes.middles, nodes.last - nodes.first), 0.0) * share
        later[nodes.of_nodes < begin] = 0.0
        return at, later, begin

    def _longer(self, first: int, nodes: StepNodes) -> Iterator[Entries]:
        """Yield what it does to the sizes of steps, and to a spin."""
        at, _, begin = self._later_by(nodes)
        steps = np.arange(max(nodes.first, begin), nodes.last)
        if not len(steps):
            return
        every = np.zeros(1, dtype=np.int64) if begin == 0 else 0 * steps
        share = np.full(len(every), 1.0 / (self.problem.steps - begin))
        yield Entries("step", every, first + every, share, None if begin == 0 else steps)
        spin, factor = self.problem.systems.spin, self.problem.systems.spin_factor
        if spin is not None and factor is not None:
            rates = [chord(spin.times, spin.values, t) for t in (nodes.begin, nodes.end)]
            change = factor[0] * (rates[1] * at[1:] - rates[0] * at[:-1])
            k = np.arange(len(change))
            yield Entries("spin", 0 * k, first + 0 * k, change, nodes.first + k)

    def _later(self, first: int, nodes: StepNodes) -> Iterator[Entries]:
        """Yield what it does to the time of functions of the state."""
        k = np.arange(nodes.first, nodes.last)
        yield Entries("time", 0 * k, first + 0 * k, self._later_by(nodes)[0][:-1], k)

    def _later_moment(self, term: Term, first: int, nodes: StepNodes) -> Iterator[Entries]:
        """Yield what it does to a moment of the time."""
        later = self._later_by(nodes)[1]
        if isinstance(term, ForceTable):
            rates, factor = term.scale * forces_rates(term, nodes.times), 1.0
        else:
            rates, factor = moment_rates(term, nodes.times), self._scale
        yield _nodal(_input_of(term), Slopes.of((rates * later[:, None])[..., None]), first, nodes, factor)

    def _later_rotor(self, term: Rotor | Wheel, first: int, nodes: StepNodes) -> Iterator[Entries]:
        """Yield what it does to the momentum of a rotor or a wheel, and to its rate."""
        if isinstance(term, Wheel) and term.times.size:
            raise ValueError("runs have no derivatives by the duration with a wheel whose torque is a table")
        at, ends, n = self._later_by(nodes)[0], (nodes.begin, nodes.end), term.direction
        if isinstance(term, Wheel):
            chords, momenta = [term.torque_at(t) for t in ends], [term.impulse(t)[:, None] * n for t in ends]
        else:
            chords, momenta = [chord(term.times, term.values, t) for t in ends], [term.momentum(t) for t in ends]
        moved = [
            Slopes.of(((term.scale * rate * by)[:, None] * n)[..., None])
            for rate, by in zip(chords, (at[:-1], at[1:]), strict=True)
        ]
        yield from _rotor(moved[0], moved[1], first, nodes, self._scale)
        change = term.scale * (momenta[1] - momenta[0])
        change *= -(at[1:] - at[:-1])[:, None] / (nodes.sizes**2)[:, None]
        row, component, parameter, value = Slopes.of(change[..., None])
        yield Entries("rate", component, first + parameter, self._scale * value, nodes.first + row)


def principal_axes(J: Array) -> Array:
    """Return the axes that `principal_inertia` is about, as columns."""
    return np.eye(3) if np.array_equal(J, np.diag(J.diagonal())) else np.linalg.eigh(J)[1]


def changed(make: Callable[[Array], Term], value: Array, unit: Array, size: float) -> Array:
    """Return what the numbers of a term, at most quadratic in a value, change by along a unit; about its size."""
    ahead, behind = (numbers_of(make(value + x * unit)) for x in (size / 2, -size / 2))
    return (ahead - behind) / size


def _input_of(term: Term) -> str:
    """Return the input of steps that a term is, or adds to."""
    inputs = {"body": "moving", "space": "space", "state": "damping"}
    return "forces" if isinstance(term, ForceTable) else inputs.get(term.kind, "dead")


def _always(name: str, component: Any, parameter: Any, value: Any) -> Effect:
    """Return the effect of parameters on an input of all steps."""
    entries = Entries(name, np.asarray(component), np.asarray(parameter), np.asarray(value))
    return Effect((name,), lambda nodes: [entries])


def _matrix(name: str, change: Array, first: int) -> Effect:
    """Return the effect of three parameters on a vector that is an input of all steps."""
    component, parameter = np.indices((3, 3)).reshape(2, -1)
    return _always(name, component, first + parameter, change.ravel())


def _at_middles(effect: Effect, nodes: StepNodes) -> Iterator[Entries]:
    """Yield an effect on a vector, at every node of a step."""
    (one,) = effect.entries(nodes)
    for j in range(len(nodes.middles)):
        yield one._replace(component=3 * j + one.component)


def _nodal(name: str, slopes: Slopes, first: int, nodes: StepNodes, factor: float = 1.0) -> Entries:
    place = INPUTS[name] * (slopes.row % len(nodes.middles)) + slopes.component
    return Entries(name, place, first + slopes.parameter, factor * slopes.value, nodes.of_nodes[slopes.row])


def _rotor(begin: Slopes, end: Slopes, first: int, nodes: StepNodes, factor: float) -> Iterator[Entries]:
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
