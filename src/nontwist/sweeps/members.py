"""From the numbers of members to their results: as few ensembles as possible, and members that are refused.

Attitudes, velocities, bodies and the scale of a single load are axes of an ensemble. Members that differ in any other
number, of a load, of the times or of the integrator, form an ensemble for each of its values; at worst of one
member. Members of an ensemble are independent, so their bits do not depend on the grouping.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

from ..analysis import ensemble_dataset, statistics
from ..analysis.variables import SIZES, VARIABLES, Wheels, observables, potentials_of
from ..driver.completion import march
from ..driver.ensembles import messages
from ..driver.planning import known_body
from ..driver.starts import starts
from ..errors import RunFileError
from ..geometry.arrays import Array
from ..geometry.values import among
from ..integrators import INTEGRATORS, Integrator, Problem
from ..integrators.problem import COLUMNS
from ..integrators.time_grid import stretched
from ..runfile import RunFile
from ..runfile.document import with_loads
from ..runfile.folder import Folder
from ..runfile.loads import AnyLoad, Place
from ..runfile.problems import problems_of
from ..runfile.reading import checked
from ..runfile.sweep_table import Sweep
from ..runfile.toml_data import parsed
from ..units import RATE
from .bodies import InvalidMembersError, components, stack, with_values
from .draws import Values

REFUSED = -1  # status of a member whose numbers define no run
LOADS: TypeAdapter[list[Any]] = TypeAdapter(list[AnyLoad])


class Kept(NamedTuple):
    """A variable that is kept of every member."""

    dims: tuple[str, ...]  # after the member axis
    attributes: dict[str, str]


class Results(NamedTuple):
    """Results of members: arrays with the member axis first, and the reasons of failures, by index."""

    arrays: dict[str, Array]
    status: NDArray[np.int8]
    reasons: dict[int, str]


class Members:
    """The members of a sweep file; `text` is that file with all defaults.

    Parameters
    ----------
    file : RunFile
        A ValueError where it has no table [sweep].
    """

    def __init__(self, file: RunFile) -> None:
        if file.sweep is None:
            raise ValueError(
                "the file has no table [sweep]: nontwist run runs it, nontwist example sweep copies one that has"
            )
        self.file, self.text, self.folder = file, file.text(), file._folder
        self.sweep: Sweep = file.sweep
        self.data = self.file.model_dump(exclude_none=True, exclude={"sweep"})

    @classmethod
    def of(cls, text: str, folder: Path) -> Members:
        """Return the members of a file given by `RunFile.text`; the files that it names are in `folder`.

        Where its integrator has lost the order since, they can be read, and not be run.
        """
        data = parsed("the sweep", text)
        order = _removed_order(data)
        if order is None:
            return cls(checked("the sweep", data, Folder(folder)))
        file = checked("the sweep", data | {"integrator": {"name": data["integrator"]["name"]}}, Folder(folder))
        copied = file.model_copy(update={"integrator": file.integrator.model_copy(update={"order": order})})
        vars(copied)["prepared"] = file.prepared
        return cls(copied)

    def __len__(self) -> int:
        return self.sweep.members

    @cached_property
    def kept(self) -> dict[str, Kept]:
        """The variables without `status`; the conserved momentum is that of the body of the file."""
        found = {}
        for name in ensemble_dataset.checked(self.sweep.variables):
            dims, units, long_name, symbol = VARIABLES[name]
            attributes = {"units": units, "long_name": f"{long_name} at t_end", "symbol": symbol}
            found[name] = Kept(tuple(dims[1:]), attributes)
        for name, (dims, _, attributes) in self._reduced(np.zeros((1, 4, COLUMNS)), 1.0).items():
            found[name] = Kept(tuple(dims[1:]), attributes)
        return found

    @property
    def bytes_each(self) -> int:
        """Stored bytes of a member."""
        return 1 + sum(8 * int(np.prod([SIZES[dim] for dim in one.dims])) for one in self.kept.values())

    def _reduced(self, observed: Array, span: float) -> statistics.Described:
        plan = self.file.prepared.plan
        loaded = bool(plan.load.without_potentials.terms)
        return statistics.named(observed, self.sweep.reduce, plan.systems, loaded, span, plan.load.potentials)

    def run(self, values: Values) -> Results:
        """Integrate the members with these numbers."""
        m = len(next(iter(values.values())))
        shapes = {name: (m, *(SIZES[dim] for dim in one.dims)) for name, one in self.kept.items()}
        results = Results({k: np.full(shape, np.nan) for k, shape in shapes.items()}, np.zeros(m, np.int8), {})
        for file, places, inner in self._groups(values):
            self._run(file, places, inner, results)
        return results

    def _groups(self, values: Values) -> Iterator[tuple[RunFile | str, NDArray[np.int64], Values]]:
        """Yield files that differ in keys that are no ensemble axis, the indices of their members, and the axes."""
        inner = {key: array for key, array in values.items() if self.is_axis(key)}
        outer = {key: array for key, array in values.items() if key not in inner}
        m = len(next(iter(values.values())))
        if not outer:
            yield self.file, np.arange(m), inner
            return
        rows = np.concatenate([array.reshape(m, -1) for array in outer.values()], axis=1)
        _, firsts, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        for first, places in zip(firsts, np.split(order, np.cumsum(np.bincount(group.ravel()))[:-1]), strict=True):
            file = self._file({key: array[first] for key, array in outer.items()})
            yield file, places, {key: array[places] for key, array in inner.items()}

    def _file(self, numbers: dict[str, Any]) -> RunFile | str:
        """Return the file with numbers inserted, or why it is invalid; loads are checked when they are made."""
        data = with_values(self.data, numbers)
        try:
            if all(key.startswith("load.") for key in numbers):
                return with_loads(self.file, LOADS.validate_python(data["load"]))
            return checked("member", data, self.folder)
        except RunFileError as error:
            return "; ".join(map(str, error.problems))
        except ValidationError as error:
            return "; ".join(map(str, problems_of(error, data, RunFile)))
        except ValueError as error:
            return str(error)

    def is_axis(self, key: str) -> bool:
        """Whether members may differ in this key within one ensemble."""
        if key == "load.0.scale":
            return len(self.file.load) == 1 and self.file.load[0].is_swept
        return key.startswith(("start.rotation", "start.angular_velocity.", "body."))

    def _run(self, file: RunFile | str, places: NDArray[np.int64], values: Values, results: Results) -> None:
        """Integrate members of one file, without those that are refused, which are found by bisection if not named."""
        if isinstance(file, str):
            results.status[places] = REFUSED
            results.reasons.update(dict.fromkeys(places.tolist(), file))
            return None
        if not len(places):
            return None
        try:
            scheme, problem = self.problem(file, values, len(places))
            outcome = march(scheme, problem)
        except ValueError as error:
            reasons = error.reasons if isinstance(error, InvalidMembersError) else {}
            if len(places) == 1:
                return self._run(reasons.get(0, str(error).replace(" of member 0", "")), places, values, results)
            number, half = np.arange(len(places)), len(places) // 2
            invalid = np.isin(number, list(reasons))
            for i, reason in reasons.items():
                self._run(reason, places[i : i + 1], values, results)
            for part in [~invalid] if reasons else [number < half, number >= half]:
                self._run(file, places[part], {key: array[part] for key, array in values.items()}, results)
            return None
        ends = outcome.states.part(slice(None), slice(-1, None))
        rotors = ensemble_dataset.rotor_momenta(problem, np.array([problem.t_end]))
        held = potentials_of(problem.load, problem.output[-1:], problem.load_scale)
        wheels = Wheels.of(problem.load.description)
        for name, found in observables(self._states, problem.systems, ends, rotors, held, wheels).items():
            last = found[:, 0]
            results.arrays[name][places] = last * signs(last) if name == "quaternion" else last
        if outcome.observed is not None:
            for name, (_, reduced, _) in self._reduced(outcome.observed, problem.t_end - problem.t_start).items():
                results.arrays[name][places] = reduced
        results.status[places] = outcome.failures[:, 0]
        results.reasons.update({int(places[i]): reason for i, reason in messages(problem, outcome).items()})
        return None

    @property
    def _states(self) -> tuple[str, ...]:
        return ensemble_dataset.checked(self.sweep.variables)

    def problem(self, file: RunFile, values: Values, m: int) -> tuple[Integrator, Problem]:
        """Return m members of one file, which differ in axes of an ensemble alone, and how to integrate them.

        Raises
        ------
        ValueError
            The numbers of a member define no run.
        """
        plan, scales = file.prepared.plan._replace(store="end", asked=None), values.get("load.0.scale")
        if numbers := _below("body.", values):
            plan = plan._replace(systems=stack(file.body, numbers, self.folder))
        if scales is not None:
            plan = plan._replace(load=file.load[0].unscaled(Place(self.folder, plan.t_start, plan.t_end)))
        plan = plan._replace(load=known_body(plan.load, plan.systems))
        velocity = file.start.angular_velocity
        frame = next(iter(type(velocity).model_fields))
        given = components(getattr(velocity, frame), frame, _below("start.angular_velocity.", values), m)
        given *= RATE[velocity.unit]
        W, w = (given, None) if frame == "body" else (None, given)
        rotation = self._rotations(file, _below("start.rotation", values), m)
        scale = 1.0 if scales is None else scales
        begin = starts(plan.systems, None, rotation, False, W, w, scale, file.start.project, plan.t_start)
        grid = plan.grid or stretched((plan.t_start, plan.t_end), (1,))
        return plan.scheme, replace(plan.problem(begin, grid), observed=bool(self.sweep.reduce))

    def _rotations(self, file: RunFile, values: Values, m: int) -> Rotation | Array:
        """Return the attitudes at the start, one or m, as `RunFile.arguments` has that of one member.

        A quaternion that was drawn is scaled to length 1 as it is there; all others are, and again may change a bit.
        """
        if "" in values:
            return values[""]
        if not values:
            return file.start.rotation.rotation()
        form, data = type(file.start.rotation), file.start.rotation.model_dump()
        keys = {key.removeprefix("."): array for key, array in values.items()}
        made = [
            form.model_validate(with_values(data, {key: array[i] for key, array in keys.items()})) for i in range(m)
        ]
        return Rotation.concatenate([one.rotation() for one in made])

    def data_of(self, values: Values) -> dict[str, Any]:
        """Return the file of one member, whose numbers have a member axis of length 1, as plain data."""
        plain = {key: array[0] for key, array in values.items() if key != "start.rotation"}
        data: dict[str, Any] = with_values(self.data, plain)
        if "start.rotation" in values:
            data["start"]["rotation"] = {"quaternion": values["start.rotation"][0].tolist(), "order": "xyzw"}
        return data


def signs(quaternion: Array) -> Array:
    """Return the signs, (..., 1), that make the scalar of quaternions not negative: one form for each attitude."""
    return np.where(quaternion[..., 3:] < 0, -1.0, 1.0)


def _removed_order(data: dict[str, Any]) -> int | None:
    """Return the order of the integrator where it is one of an earlier version."""
    table = data.get("integrator")
    name, order = (table.get("name"), table.get("order")) if isinstance(table, dict) else (None, None)
    kind = INTEGRATORS[name] if isinstance(name, str) and name in INTEGRATORS else None
    return order if kind is not None and among(order, kind.removed) else None


def _below(prefix: str, values: Values) -> Values:
    return {key.removeprefix(prefix): array for key, array in values.items() if key.startswith(prefix)}
