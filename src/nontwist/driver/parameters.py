"""The parameters of a run by name: how many numbers each has, what they do to the start and to the inputs of steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..engine.called_functions import FUNCTIONS, changes_of_numbers, kernel_kind, numbers_of
from ..engine.known_steps import INPUTS, NODAL
from ..geometry.arrays import Array
from ..geometry.attitudes import BASIS, ENTRIES
from ..geometry.values import as_list, guess, short_repr
from ..integrators.compiled import Compiled
from ..integrators.ivp import IVP
from ..integrators.linearised_runs import Changes, InputDerivatives, StepNodes
from ..integrators.load_samples import as_marched, orbit_of, with_spin
from ..integrators.memory_tangents import NAMES
from ..loads.load import is_called, tables_as_moments
from ..loads.load_derivatives import LATER, Slopes, fixed_slopes, momentum_slopes, slopes_of_time, with_parameter
from ..loads.memory_terms import Memory, Wheel
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
# Of these the momentum of a wheel, to which steps of many nodes are not linear, has no derivatives under a table.
NOT_OF_TABLES = {"scale": "the factor of", "wheel": "the axis of", "duration": "the duration with"}
EVERY = ("material_angular_velocity", "rotation")


class Parameter(NamedTuple):
    """Some numbers that a run depends on, side by side among all parameters."""

    name: str
    labels: tuple[str, ...]
    unit: str
    field: str  # of the record of a term, else the name
    term: int | None = None  # of the load
    first: int = 0


class Effect(NamedTuple):
    """What a parameter does to some of the inputs of steps."""

    inputs: tuple[str, ...]
    entries: Callable[[StepNodes], Iterable[InputDerivatives]]


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
        self.problem, self.all, self.count = problem, list[Parameter](), 0
        self._scale = float(problem.load_scale[0])
        axis = problem.systems.axis
        self._axis = None if axis is None else axis[0]
        self._across = np.eye(3) if self._axis is None else np.eye(3) - np.outer(self._axis, self._axis)
        # tables of forces along the directors as moments
        self.terms = (problem.load if scheme.is_director_scheme else tables_as_moments(problem.load)).terms
        self._orbits = orbit_of(*as_marched(problem, scheme.is_director_scheme), 1.0, scheme) is not None
        words = [names] if isinstance(names, str) else as_list(names, given)
        self._dissipates = scheme.is_director_scheme and bool(scheme.dissipation)
        known = self._known()
        able = [name for name, many in known.items() if not any(map(self._refusal, many))]
        if not words:
            raise ValueError(f"{given} names no parameter; known are {', '.join(able)}")
        for word in dict.fromkeys(w if isinstance(w, str) else short_repr(w) for w in words):
            if word not in known:
                raise ValueError(
                    f"{given} has the unknown parameter {word!r}; {self._field(word, able) or guess(word, able)}"
                    f"known are {', '.join(able)}"
                )
            for one in known[word]:
                if all(one.name != other.name for other in self.all):
                    self.all.append(one._replace(first=self.count))
                    self.count += len(one.labels)
        if said := next(filter(None, map(self._refusal, self.all)), ""):
            raise ValueError(said)
        self.changes = list[Changes]()  # of the numbers of terms that depend on the state, for each of "terms"
        self._effects = [effect for one in self.all for effect in self._effects_of(one)]

    def _known(self) -> dict[str, list[Parameter]]:
        """Return what each name stands for."""
        spin = self.problem.systems.spin
        own = OWN if spin is None else OWN | {"spin": (tuple(map(str, range(len(spin.values)))), "rad s-1")}
        known = {name: [Parameter(name, labels, unit, name)] for name, (labels, unit) in own.items()}
        for k, term in enumerate(self.terms):
            for field, (labels, unit) in parameters_of(term).items():
                one = Parameter(f"load[{k}].{field}", tuple(labels), unit, field, k)
                known[one.name] = [one]
                if field != "scale" and field not in OWN:
                    known.setdefault(field, []).append(one)
        return known

    def _refusal(self, one: Parameter) -> str:
        """Return why runs have no derivatives by a parameter; "" where they have."""
        wheels = self.problem.load.wheels
        if self.problem.load.memories:
            said = f"runs with memory have derivatives by {NAMES}; {one.name} is none of them"
            return "" if self._is_of_memory(one) else said
        if self._dissipates and (len(self.inertias_of(one)) if wheels else one.name == "inertia"):
            what = "inertias beside wheels" if wheels else "the entries of the inertia"
            return (
                f"energy-momentum with dissipation has no derivatives by {what}, which turn the principal axes that "
                f"its equations are written in; {'leave dissipation out' if wheels else 'use principal_inertia'}"
            )
        if one.name in ("axis", "spin") and self._axis is not None and wheels:
            return f"runs with wheels have no derivatives by {one.name}, which their momenta begin with"
        terms = self.terms if one.term is None else (self.terms[one.term],)
        what = NOT_OF_TABLES.get(one.field.removeprefix("load_"), "")
        if what and any(isinstance(term, Wheel) and term.times.size for term in terms):
            return f"runs have no derivatives by {what} a wheel whose torque is a table"
        return ""

    def _field(self, word: str, able: Iterable[str]) -> str:
        """Return what a message says of a field of a term that is not a parameter; "" for any other word."""
        for k, term in enumerate(self.terms):
            if word.removeprefix(f"load[{k}].") in own_fields(type(term)):
                its = ", ".join(name for name in able if name.startswith(f"load[{k}]."))
                return f"runs have no derivatives with respect to this field of load[{k}]; its parameters are {its}; "
        return ""

    @property
    def _drawn(self) -> list[GravityGradient]:
        """The terms that know the inertia."""
        return [term for term in self.terms if isinstance(term, GravityGradient)]

    def _is_of_memory(self, one: Parameter) -> bool:
        """Whether runs with memory have derivatives by a parameter."""
        if one.term is None:
            return one.name in (*EVERY, "inertia", "principal_inertia")
        return isinstance(self.terms[one.term], Memory) and one.field != "scale"

    @property
    def of_memories(self) -> list[tuple[int, str, int] | None]:
        """The number of a load with memory, wheels first, its field, and the component; None: another parameter."""
        numbers = [k for k, term in enumerate(self.terms) if isinstance(term, Memory)]
        numbers.sort(key=lambda k: not isinstance(self.terms[k], Wheel))
        each = ((one, k) for one in self.all for k in range(len(one.labels)))
        return [None if one.term is None else (numbers.index(one.term), one.field, k) for one, k in each]

    @property
    def inertias(self) -> Array:
        """The changes of the inertia, of a body with wheels that of their carrier, by each number, (count, 3, 3)."""
        each = ((self.inertias_of(one), np.zeros((len(one.labels), 3, 3))) for one in self.all)
        return np.concatenate([own if len(own) else none for own, none in each])

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
            columns = self.inertias_of(one) if self._drawn else ()
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

    def start(self, rows: int, velocity: Array, removed: float = 0.0) -> Array:
        """Return the change of the first state by each number, (rows, count), of a run that starts with W.

        Of the velocity that was given, a part of this size along the axis has been `removed`: with c the prescribed
        spin, W = (I - n⊗n) given + c n turns with the axis by c dn - (dn (n·given) + n (dn·given)).
        """
        found, t0, n, across = np.zeros((rows, self.count)), self.problem.t_start, self._axis, self._across
        for one in self.all:
            at = slice(one.first, one.first + len(one.labels))
            if one.name == "rotation":
                found[:3, at] = np.eye(3)
            elif one.name == "material_angular_velocity":
                found[3:6, at] = across
            elif one.name == "axis" and n is not None:
                c = float(self.problem.systems.spin_at(t0)[0])
                found[3:6, at] = (c - removed) * across - np.outer(n, across @ velocity)
            elif one.name == "spin" and n is not None:
                found[3:6, at] = np.outer(n, self._spin_weights(np.array([t0]))[0])
        return found

    @property
    def inputs(self) -> set[str]:
        """The inputs of the steps that the parameters act on."""
        return {name for effect in self._effects for name in effect.inputs}

    def entries(self, nodes: StepNodes) -> Iterator[InputDerivatives]:
        """Yield what the parameters do to the inputs of some steps."""
        for effect in self._effects:
            yield from effect.entries(nodes)

    def entries_along(self, directions: Array, nodes: StepNodes) -> Iterator[InputDerivatives]:
        """Yield what a change of all parameters at once does, along each of the `directions`, (count, d)."""
        d = directions.shape[1]
        for name, component, parameter, value, step in self.entries(nodes):
            along = (value[:, None] * directions[parameter]).ravel()
            which = np.tile(np.arange(d), len(value))
            yield InputDerivatives(
                name, np.repeat(component, d), which, along, None if step is None else np.repeat(step, d)
            )

    # ---- what each parameter does

    def _effects_of(self, one: Parameter) -> Iterator[Effect]:
        """Yield what a parameter does; `changes` are those of the parameters before it, and become its own too."""
        first, n, wheels = one.first, self._axis, self.problem.load.wheels
        if changes := self._changes_of(one):
            yield _always("terms", np.eye(len(changes)), first, len(self.changes))
            self.changes += changes
        if len(inertias := self.inertias_of(one)):
            yield _always("inertia", np.array([[dJ[e] for dJ in inertias] for e in ENTRIES]), first)
        if one.term is not None:
            yield from self._effects_of_term(self.terms[one.term], one.field, first, self._scale)
        elif one.name == "axis" and n is not None:
            yield _always("axis", self._across, first)
        elif one.name == "dead_force":
            yield _always("dead", np.eye(9), first)
        elif one.name == "spin":
            yield Effect(("spin",), partial(self._of_spin, first))
        elif one.name == "material_angular_velocity" and wheels:
            locked = sum((wheel.locked for wheel in wheels), np.zeros((3, 3))) @ self._across
            yield Effect(
                ("rotor",), lambda nodes: [_of_all_steps("rotor", np.tile(locked, (len(nodes.middles), 1)), first)]
            )
        elif one.name == "load_scale":
            if any(map(is_called, self.terms)):
                yield _always("factor", np.eye(1), first)
            for term in self.terms:
                if not is_called(term):
                    yield from self._effects_of_term(term, "scale", first, term.scale)
        elif one.name == "duration":
            yield Effect(("step", *["spin"] * (self.problem.systems.spin is not None)), partial(self._longer, first))
            if "" in map(_input_of, self.terms):
                yield Effect(("time",), partial(self._later, first))
            for term in self.terms:
                if _input_of(term) in NODAL:
                    yield from self._effects_of_term(term, LATER, first, self._scale)

    def _effects_of_term(self, term: Term, field: str, first: int, factor: float) -> Iterator[Effect]:
        """Yield what a parameter of a term does, or that all is `LATER`, times a factor."""
        name = _input_of(term)
        if name == "rotor":
            yield Effect(("rotor", "rate"), partial(self._of_rotor, term, field, first, factor))
        elif name in NODAL:
            yield Effect((name,), partial(self._of_nodes, term, field, first, factor))
        elif name:
            yield _always(name, factor * fixed_slopes(term, field), first)
        elif self._orbits and field == "mean_motion":
            yield _always("orbit", np.eye(1), first)

    def inertias_of(self, one: Parameter) -> Array:
        """Return the changes of the inertia, of a body with wheels that of their carrier, (count or 0, 3, 3)."""
        if one.name == "inertia":
            return BASIS
        if one.name == "principal_inertia":
            return np.array([np.outer(q, q) for q in principal_axes(self.problem.systems.convected_inertia[0]).T])
        wheel = None if one.term is None else self.terms[one.term]
        if not isinstance(wheel, Wheel) or one.field not in ("inertia", "wheel"):
            return np.zeros((0, 3, 3))
        n = wheel.direction
        if one.field == "inertia":
            return -np.outer(n, n)[None]
        across = np.eye(3) - np.outer(n, n)
        return -wheel.inertia * (across[:, :, None] * n + n[:, None] * across[:, None])

    def _spin_weights(self, times: Array) -> Array:
        """Return the derivatives of the spin at (n,) times by the values of its table, (n, k).

        They are those of the body, which a stack may hold as a factor.
        """
        spin = self.problem.systems.spin
        assert spin is not None
        return np.stack([np.interp(times, spin.times, row) for row in np.eye(len(spin.values))], axis=1)

    def _of_spin(self, first: int, nodes: StepNodes) -> Iterator[InputDerivatives]:
        change = self._spin_weights(nodes.end) - self._spin_weights(nodes.begin)
        step, k = np.nonzero(change)
        yield InputDerivatives("spin", 0 * k, first + k, change[step, k], nodes.first + step)

    def _of_nodes(
        self, term: Term, field: str, first: int, factor: float, nodes: StepNodes
    ) -> Iterator[InputDerivatives]:
        """Yield what a parameter of a moment of time, or of a table of forces, does to it at the nodes."""
        later = self._later_by(nodes)[1] if field == LATER else None
        slopes, name = slopes_of_time(term, field, nodes.times, later), _input_of(term)
        place = INPUTS[name] * (slopes.row % len(nodes.middles)) + slopes.component
        value = slopes.value if name == "forces" else factor * slopes.value
        yield InputDerivatives(name, place, first + slopes.parameter, value, nodes.of_nodes[slopes.row])

    def _of_rotor(
        self, term: Any, field: str, first: int, factor: float, nodes: StepNodes
    ) -> Iterator[InputDerivatives]:
        """Yield what a parameter of a rotor, or of a wheel whose momentum is known, does to its momentum.

        The momentum changes at the nodes, on the chords of the steps, and so does its rate.
        """
        at, times = self._later_by(nodes)[0], (nodes.begin, nodes.end)
        if isinstance(term, Wheel) and field != LATER:
            ends = [Slopes.of(self._slopes_of_wheel(term, field, t, factor)) for t in times]
            factor = 1.0
        else:
            ends = [momentum_slopes(term, field, t, by) for t, by in zip(times, (at[:-1], at[1:]), strict=True)]
        steady = all(np.array_equal(one, other) for one, other in zip(*ends, strict=True))
        for sign, slopes in zip((-1.0, 1.0), ends, strict=True):
            step, parameter = nodes.first + slopes.row, first + slopes.parameter
            value = factor * slopes.value
            if not steady:  # else they cancel
                yield InputDerivatives(
                    "rate", slopes.component, parameter, sign * value / nodes.sizes[slopes.row], step
                )
            for j, c in enumerate(nodes.middles.tolist()):
                weight = c if sign > 0 else 1.0 - c
                yield InputDerivatives("rotor", 3 * j + slopes.component, parameter, weight * value, step)
        if field == LATER:  # and so are the steps
            h, h1 = (term.history(t)[0][:, None] * term.direction for t in times)
            change = term.scale * (h1 - h)
            change *= -(at[1:] - at[:-1])[:, None] / (nodes.sizes**2)[:, None]
            row, component, parameter, value = Slopes.of(change[..., None])
            yield InputDerivatives("rate", component, first + parameter, factor * value, nodes.first + row)

    def _slopes_of_wheel(self, wheel: Wheel, field: str, times: Array, factor: float) -> Array:
        """Return the derivatives of h n of a wheel at (n,) times by a parameter, (n, 3, count)."""
        n, own, t0 = wheel.direction, factor * wheel.scale, self.problem.t_start
        W = with_spin(self.problem.systems, self.problem.velocity, t0)[0]
        speed, one = own * wheel.speed + n @ W, np.ones(len(times))
        if field == "wheel":
            across, h = np.eye(3) - np.outer(n, n), wheel.inertia * speed + own * wheel.impulse(times - t0)
            return h[:, None, None] * across + wheel.inertia * np.outer(n, across @ W)
        if field == "inertia":
            return (one[:, None] * (speed * n))[..., None]
        # what is added to the torque of a table acts as long as the table does
        ends = wheel.times[[0, -1]] if wheel.times.size else (-np.inf, np.inf)
        by_speed, by_torque = wheel.inertia * one, np.clip(times, *ends) - np.clip(t0, *ends)
        by = {"speed": wheel.scale * by_speed, "torque": wheel.scale * by_torque}
        by["scale"] = wheel.speed * by_speed + wheel.torque * by_torque
        return factor * (by[field][:, None] * n)[..., None]

    # ---- a longer last segment, with as many steps: longer steps, and later nodes

    def _later_by(self, nodes: StepNodes) -> tuple[Array, Array, int]:
        """Return by how much later steps begin, and the last one ends, and nodes are; the first step that is longer."""
        begin = max(self.problem.grid.numbers[-2], 0)
        share = 1.0 / (self.problem.steps - begin)
        at = np.maximum(np.arange(nodes.first, nodes.last + 1) - begin, 0) * share
        later = np.maximum(nodes.of_nodes - begin + np.tile(nodes.middles, nodes.last - nodes.first), 0.0) * share
        later[nodes.of_nodes < begin] = 0.0
        return at, later, begin

    def _longer(self, first: int, nodes: StepNodes) -> Iterator[InputDerivatives]:
        """Yield what it does to the sizes of steps, and to a spin."""
        at, _, begin = self._later_by(nodes)
        steps = np.arange(max(nodes.first, begin), nodes.last)
        if not len(steps):
            return
        every = np.zeros(1, dtype=np.int64) if begin == 0 else 0 * steps
        share = np.full(len(every), 1.0 / (self.problem.steps - begin))
        yield InputDerivatives("step", every, first + every, share, None if begin == 0 else steps)
        spin, factor = self.problem.systems.spin, self.problem.systems.spin_factor
        if spin is not None and factor is not None:
            rates = [chord(spin.times, spin.values, t) for t in (nodes.begin, nodes.end)]
            change = factor[0] * (rates[1] * at[1:] - rates[0] * at[:-1])
            k = np.arange(len(change))
            yield InputDerivatives("spin", 0 * k, first + 0 * k, change, nodes.first + k)

    def _later(self, first: int, nodes: StepNodes) -> Iterator[InputDerivatives]:
        """Yield what it does to the time of functions of the state."""
        k = np.arange(nodes.first, nodes.last)
        yield InputDerivatives("time", 0 * k, first + 0 * k, self._later_by(nodes)[0][:-1], k)


def principal_axes(J: Array) -> Array:
    """Return the axes that `principal_inertia` is about, as columns."""
    return np.eye(3) if np.array_equal(J, np.diag(J.diagonal())) else np.linalg.eigh(J)[1]


def changed(make: Callable[[Array], Term], value: Array, unit: Array, size: float) -> Array:
    """Return what the numbers of a term, at most quadratic in a value, change by along a unit; about its size."""
    ahead, behind = (numbers_of(make(value + x * unit)) for x in (size / 2, -size / 2))
    return (ahead - behind) / size


def _input_of(term: Term) -> str:
    """Return the input of steps that a term is, or adds to; "" of one that is called with the state."""
    if isinstance(term, ForceTable):
        return "forces"
    if is_called(term):
        return ""
    inputs = {"body": "moving", "space": "space", "state": "damping"}
    return "rotor" if isinstance(term, Rotor | Wheel) else inputs.get(term.kind, "dead")


def _of_all_steps(name: str, change: Array, first: int, place: int = 0) -> InputDerivatives:
    """Return what parameters do to an input of all steps, by its changes by each of them, (components, count)."""
    component, parameter = np.nonzero(change)
    return InputDerivatives(name, place + component, first + parameter, change[component, parameter])


def _always(name: str, change: Array, first: int, place: int = 0) -> Effect:
    entries = _of_all_steps(name, change, first, place)
    return Effect((name,), lambda nodes: [entries])
