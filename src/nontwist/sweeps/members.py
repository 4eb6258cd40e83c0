"""From the numbers of members to their results: as few ensembles as possible, and members that are refused.

Attitudes, velocities, bodies and the scale of a single load are axes of an ensemble. Members that differ in any other
number, of a load, of the times or of the integrator, form an ensemble for each of its values; at worst of one
member. Members of an ensemble are independent, so their bits do not depend on the grouping.

The numbers of member i, a function of the table ``[sweep]`` and i alone, so that blocks are independent.

Member i is at the point ``i // samples`` of the product of grids and lists. Its random numbers come from a point of the
unit cube. Random: every key has a Philox generator of its own (Salmon et al. 2011), whose key is hashed from the seed
and the name, and member i takes the numbers at the counter ``c i``, with c the blocks of four that a value needs.
Its raw integers are used, ``u = (n + 1/2) 2^-53``: they never change, unlike NumPy's distributions.
Quasi-random: all drawn keys share one scrambled sequence, and member i takes its i-th point.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterable
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

from ..analysis import statistics
from ..analysis.variables import SIZES, Acting, about, observables
from ..driver.completion import checked_march, with_extrema
from ..driver.notices import messages
from ..driver.planning import known_body
from ..driver.starts import starts
from ..errors import RunFileError
from ..geometry.arrays import UNIT, Array, as_direction, norm
from ..integrators import IVP, Integrator
from ..integrators.ivp import COLUMNS, segmented
from ..machine import cached_property
from ..models.bodies import BODIES, many_euler
from ..models.stack import SystemStack, doubtful
from ..models.system import DirectorSystem
from ..runfile import RunFile
from ..runfile.body import Body
from ..runfile.document import checked, with_loads
from ..runfile.files import Fault, Folder, shown
from ..runfile.load_tables import AnyLoad
from ..runfile.section import in_toml, problems_of
from ..runfile.sweep_table import Drawn, Sweep, is_axis
from ..units import RATE

Values = dict[str, Array]
LEAST, MOST = 2.0**-54, 1 - 2.0**-53
_sequences = threading.local()


def values(sweep: Sweep, first: int, last: int) -> Values:
    """Return the numbers of members `first` to ``last - 1``: for each key an array, the member axis first."""
    i = np.arange(first, last)
    found: Values = {}
    if sweep.axes:
        at = np.unravel_index(i // sweep.samples, sweep.shape)
        places = at * len(sweep.axes) if sweep.combine == "together" else at
        for one, place in zip(sweep.axes, places, strict=True):
            found[one.key] = one.points()[place]
    if sweep.drawn:
        for drawn, u in zip(sweep.drawn, _cube(sweep, first, last), strict=True):
            found[drawn.key] = drawn.values(np.ascontiguousarray(u))
    return {one.key: found[one.key] for one in sweep.over}


def spread(sweep: Sweep, count: int) -> Values:
    """Return the numbers of about `count` members, taken in 16 runs of neighbours all over the sweep."""
    members, runs = sweep.members, 16
    length = max(1, min(count, members) // runs)
    starts = np.unique(np.linspace(0, members - length, runs).astype(np.int64)).tolist()
    parts = [values(sweep, first, first + length) for first in starts]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _cube(sweep: Sweep, first: int, last: int) -> list[Array]:
    """Return points inside of the unit cube, (m, dimension), one array for each drawn key."""
    drawn = sweep.drawn
    if sweep.sampling == "random":
        return [_random(sweep.seed, one, first, last) for one in drawn]
    ends = np.cumsum([one.dimension for one in drawn])
    points = _quasi_random(sweep.sampling, sweep.seed, int(ends[-1]), first, last)
    return np.split(np.clip(points, LEAST, MOST), ends[:-1], axis=1)


def _random(seed: int, one: Drawn, first: int, last: int) -> Array:
    name = int.from_bytes(hashlib.sha256(one.key.encode()).digest()[:16], "little")
    stream, blocks = np.random.Philox(np.random.SeedSequence((seed, name))), -(-one.dimension // 4)
    raw = stream.advance(first * blocks).random_raw(4 * blocks * (last - first))
    u: Array = ((raw >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    return u.reshape(last - first, -1)[:, : one.dimension]


def _quasi_random(name: str, seed: int, dimension: int, first: int, last: int) -> Array:
    """Return points of the sequence; each thread has an engine, which advances from block to block."""
    key = (name, seed, dimension)
    if getattr(_sequences, "key", None) != key:
        _sequences.key, _sequences.engine = key, _engine(*key)
    engine = _sequences.engine
    if engine.num_generated > first:
        engine.reset()
    if first > engine.num_generated:
        engine.fast_forward(first - engine.num_generated)
    if first == 0:  # by itself: Sobol warns of a first block whose length is not a power of 2
        return np.concatenate([engine.random(1), engine.random(last - 1)])
    return engine.random(last - first)


def _engine(name: str, seed: int, dimension: int) -> Any:
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    return qmc.Sobol(dimension, seed=generator, bits=32) if name == "sobol" else qmc.Halton(dimension, seed=generator)


# The bodies of many members: from numbers put into the table `[body]` to a stack.
#
# Axes and inertias given by their components are converted all at once, where the kind of body has a form for this,
# `E = 1/2 tr(J) I - J`; shapes, and bodies under gravity, whose inertia must suit the mass, one after the other.

AT_ONCE = ("axis", "inertia")


class InvalidMembersError(ValueError):
    """Members whose numbers define no body: `reasons` by index."""

    def __init__(self, reasons: dict[int, str]) -> None:
        super().__init__(next(iter(reasons.values())))
        self.reasons = reasons


def stack(body: Body, values: Values, folder: Folder) -> SystemStack:
    """Return the bodies of members.

    Parameters
    ----------
    body : Body
        That of the file.
    values : dict
        Keys below ``body.``, without that prefix, to arrays with the member axis first; none where all have one body.
    folder : Folder
        Where the file lies.

    Raises
    ------
    InvalidMembersError
        Numbers of members that define no body.
    """
    if not values:
        return SystemStack.of([folder.system(body)])
    plain = isinstance(body.inertia, list) and body.weight(folder) is None and body.spin is None
    if BODIES[body.kind].at_once and plain and all(key.split(".")[0] in AT_ONCE for key in values):
        return _at_once(body, values)
    data, members = body.model_dump(exclude_none=True), range(len(next(iter(values.values()))))
    made = _each(members, lambda i: type(body).model_validate(with_values(data, part(values, i))).system(folder))
    return SystemStack.of(made)


def _each(members: Iterable[int], made: Callable[[int], DirectorSystem]) -> list[DirectorSystem]:
    """Return the bodies of members, each `made` by itself; an InvalidMembersError says why some cannot be."""
    found, invalid = [], {}
    for i in members:
        try:
            found.append(made(i))
        except ValueError as error:
            invalid[i] = in_toml(reason_of(error, "body"))
    if invalid:
        raise InvalidMembersError(invalid)
    return found


def reason_of(error: ValueError, *place: str) -> str:
    """Return why numbers are refused; `place` is where in the file a table lies that was read by itself."""
    if isinstance(error, RunFileError):
        return "; ".join(map(str, error.problems))
    return "; ".join(map(str, problems_of(error, place))) if isinstance(error, ValidationError) else str(error)


def part(values: Values, places: Any) -> Values:
    """Return the numbers of one member or of some."""
    return {key: array[places] for key, array in values.items()}


def with_values(data: Any, values: dict[str, Any]) -> Any:
    """Return plain data with the values inserted at dotted keys; whole numbers stay whole."""
    data = deepcopy(data)
    for key, value in values.items():
        *parts, last = key.split(".")
        place = data
        for part in parts:
            place = place[int(part) if isinstance(place, list) else part]
        at: Any = int(last) if isinstance(place, list) else last
        number = np.asarray(value).tolist()
        place[at] = int(number) if isinstance(place[at], int) and float(number).is_integer() else number
    return data


def components(nominal: Any, name: str, values: Values, m: int) -> Array:
    """Return m copies of the array `nominal`, with the `values` of it and of its entries inserted."""
    found: Array = np.repeat(np.array(nominal, dtype=np.float64)[None], m, axis=0)
    for key, value in values.items():
        head, *entries = key.split(".")
        if head == name:
            place: Any = (slice(None), *map(int, entries))
            found[place] = value
    return found


def _at_once(body: Body, values: Values) -> SystemStack:
    kind, m = BODIES[body.kind], len(next(iter(values.values())))
    given = {name: components(getattr(body, name), name, values, m) for name in AT_ONCE if name in kind.takes}
    J = given["inertia"]
    J = given["inertia"] = J if J.ndim == 3 else J[:, :, None] * np.eye(3)
    assert kind.at_once is not None
    how: dict[str, Any] = {} if body.physical is None else {"physical": body.physical}
    E, fixed = kind.at_once(J), None if "axis" in given else kind.make(**kind.sample).axis
    axis = given.get("axis") if fixed is None else np.repeat(fixed[None], m, axis=0)
    if axis is not None:
        for i in np.flatnonzero(axis.any(axis=1) & (abs(norm(axis) - 1) > UNIT)):
            axis[i] = as_direction(axis[i], "axis")
    is_odd = (J.swapaxes(1, 2) != J).any(axis=(1, 2)) | (many_euler(J) != E).any(axis=(1, 2))
    alone = np.flatnonzero(doubtful(E, axis) | is_odd).tolist()
    made = _each(alone, lambda i: kind.make(**part(given, i), **how))
    E[alone] = np.reshape([one.euler_inertia for one in made], (-1, 3, 3))
    return SystemStack(E, axis, name=body.kind, **how)


REFUSED = -1  # status of a member whose numbers define no run
LOADS: TypeAdapter[list[Any]] = TypeAdapter(list[AnyLoad])


class Results(NamedTuple):
    """Results of members: arrays with the member axis first, and the reasons of failures, by index."""

    arrays: dict[str, Array]
    status: NDArray[np.int8]
    reasons: dict[int, str]

    def refuse(self, reasons: dict[int, str]) -> None:
        """Mark the members that have reasons as refused."""
        self.status[list(reasons)] = REFUSED
        self.reasons.update(reasons)


class Members:
    """The members of a sweep file; `text` is that file with all defaults.

    Parameters
    ----------
    file : RunFile
        A ValueError where it has no table [sweep], or what no member can have.
    """

    def __init__(self, file: RunFile) -> None:
        if file.sweep is None:
            raise ValueError(
                "the file has no table [sweep]: nontwist run runs it, nontwist example sweep copies one that has"
            )
        start, events = file.start.run, len(file.event)
        faults = [] if start is None else [Fault("start.run", shown(start), "left out: members start from numbers")]
        faults += [Fault("event", f"{events} tables", "left out: a sweep looks for no events")] * bool(events)
        if faults:
            raise RunFileError("[sweep]", tuple(faults))
        self.file, self.text, self.folder = file, file.text(), file._folder
        self.sweep: Sweep = file.sweep
        self.data = self.file.model_dump(exclude_none=True, exclude={"sweep"})
        self.variables = statistics.checked_variables(self.sweep.variables)

    def __len__(self) -> int:
        return self.sweep.members

    @cached_property
    def kept(self) -> dict[str, tuple[tuple[str, ...], dict[str, str]]]:
        """The dims after the member axis, and the attributes, of all variables but `status`.

        The conserved momentum is that of the body of the file.
        """
        found = {}
        for name in self.variables:
            dims, units, long_name, symbol = about(name)
            attributes = {"units": units, "long_name": f"{long_name} at t_end", "symbol": symbol}
            found[name] = tuple(dims[1:]), attributes
        for name, (dims, _, attributes) in self._reduced(np.zeros((1, 4, COLUMNS)), 1.0).items():
            found[name] = tuple(dims[1:]), attributes
        return found

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of the variables of a member."""
        sizes = SIZES | {"wheel": len(self.file.prepared.plan.load.wheels)}
        return {name: tuple(sizes[dim] for dim in dims) for name, (dims, _) in self.kept.items()}

    @property
    def bytes_each(self) -> int:
        """Stored bytes of a member."""
        return 1 + sum(8 * int(np.prod(shape)) for shape in self.shapes.values())

    def _reduced(self, observed: Array, span: float) -> statistics.Described:
        plan = self.file.prepared.plan
        loaded = bool(plan.load.without_potentials.terms)
        return statistics.named(observed, self.sweep.reduce, plan.systems, loaded, span, plan.load.potentials)

    def run(self, values: Values) -> Results:
        """Integrate the members with these numbers, those at once that differ in axes of an ensemble alone."""
        m = len(next(iter(values.values())))
        arrays = {name: np.full((m, *shape), np.nan) for name, shape in self.shapes.items()}
        results = Results(arrays, np.zeros(m, np.int8), {})
        inner = {key: array for key, array in values.items() if is_axis(key, self.file.load)}
        outer = {key: array for key, array in values.items() if key not in inner}
        rows = np.concatenate([np.empty((m, 0)), *(array.reshape(m, -1) for array in outer.values())], axis=1)
        _, firsts, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        for first, places in zip(firsts, np.split(order, np.cumsum(np.bincount(group.ravel()))[:-1]), strict=True):
            try:
                file = self._file(part(outer, first))
            except ValueError as error:
                results.refuse(dict.fromkeys(places.tolist(), reason_of(error, "load")))
            else:
                self._run(file, places, inner, results)
        return results

    def _file(self, numbers: dict[str, Any]) -> RunFile:
        """Return the file with numbers inserted, or raise a ValueError; loads are checked when they are made."""
        if not numbers:
            return self.file
        data = with_values(self.data, numbers)
        if all(key.startswith("load.") for key in numbers):
            return with_loads(self.file, LOADS.validate_python(data["load"]))
        return checked("member", data, self.folder)

    def _run(self, file: RunFile, places: NDArray[np.int64], inner: Values, results: Results) -> None:
        """Integrate members of one file, without those that are refused, which are found by bisection if not named."""
        left = [places]
        while left:
            if not len(places := left.pop()):
                continue
            try:
                scheme, problem = self.problem(file, part(inner, places), len(places))
                outcome = checked_march(scheme, problem)
                if "extrema" in self.sweep.reduce:
                    outcome = with_extrema(scheme, problem, outcome)
            except ValueError as error:
                alone = {0: str(error).replace(" of member 0", "")} if len(places) == 1 else {}
                reasons = error.reasons if isinstance(error, InvalidMembersError) else alone
                results.refuse({int(places[i]): reason for i, reason in reasons.items()})
                left += [np.delete(places, list(reasons))] if reasons else np.array_split(places, 2)
                continue
            ends = outcome.states.part(slice(None), slice(-1, None))
            acting = Acting.of(problem.load, problem.stored_times[-1:], problem.load_scale)
            for name, found in observables(self.variables, problem.systems, ends, acting).items():
                last = found[:, 0]
                results.arrays[name][places] = last * signs(last) if name == "quaternion" else last
            if outcome.observed is not None:
                for name, (_, reduced, _) in self._reduced(outcome.observed, problem.t_end - problem.t_start).items():
                    results.arrays[name][places] = reduced
            results.status[places] = outcome.failures[:, 0]
            results.reasons.update({int(places[i]): reason for i, reason in messages(problem, outcome).items()})

    def problem(self, file: RunFile, values: Values, m: int) -> tuple[Integrator, IVP]:
        """Return m members of one file, which differ in axes of an ensemble alone, and how to integrate them.

        Raises
        ------
        ValueError
            The numbers of a member define no run.
        """
        plan, scales = file.prepared.plan._replace(store="end", output_times=None), values.get("load.0.scale")
        if numbers := _below("body.", values):
            plan = plan._replace(systems=stack(file.body, numbers, self.folder))
        if scales is not None:
            plan = plan._replace(load=file.load[0].unscaled(self.folder))
        plan = plan._replace(load=known_body(plan.load, plan.systems))
        velocity = file.start.angular_velocity
        frame = next(iter(type(velocity).model_fields))
        given = components(getattr(velocity, frame), frame, _below("start.angular_velocity.", values), m)
        given *= RATE[velocity.unit]
        W, w = (given, None) if frame == "body" else (None, given)
        rotation = self._rotations(file, _below("start.rotation", values), m)
        scale = 1.0 if scales is None else scales
        begin = starts(plan.systems, None, rotation, False, W, w, scale, file.start.project, plan.t_start, many=True)
        grid = plan.grid or segmented((plan.t_start, plan.t_end), (1,))
        return plan.scheme, plan.problem(begin, grid, observed=bool(self.sweep.reduce))

    def _rotations(self, file: RunFile, values: Values, m: int) -> Rotation | Array:
        """Return the attitudes at the start, one or m, as `RunFile.arguments` has that of one member.

        A quaternion that was drawn is scaled to length 1 as it is there; all others are, and again may change a bit.
        """
        if "" in values:
            return values[""]
        if not values:
            return file.start.rotation.rotation()
        form, data = type(file.start.rotation), file.start.rotation.model_dump()
        keys = _below(".", values)
        made = [form.model_validate(with_values(data, part(keys, i))) for i in range(m)]
        return Rotation.concatenate([one.rotation() for one in made])

    def member(self, i: int) -> RunFile:
        """Return the run file of one member, its numbers inserted; a RunFileError where they define no run."""
        numbers = part(values(self.sweep, i, i + 1), 0)
        rotation = numbers.pop("start.rotation", None)
        data: dict[str, Any] = with_values(self.data, numbers)
        if rotation is not None:
            data["start"]["rotation"] = {"quaternion": rotation.tolist(), "order": "xyzw"}
        return checked(f"member {i}", data, self.folder)

    def try_ends(self) -> None:
        """Raise the RunFileError of member 0 where the last one is refused as well."""
        try:
            self.member(len(self) - 1)
        except RunFileError:
            self.member(0)


def signs(quaternion: Array) -> Array:
    """Return the signs, (..., 1), that make the scalar of quaternions not negative: one form for each attitude."""
    return np.where(quaternion[..., 3:] < 0, -1.0, 1.0)


def _below(prefix: str, values: Values) -> Values:
    return {key.removeprefix(prefix): array for key, array in values.items() if key.startswith(prefix)}
