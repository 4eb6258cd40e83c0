"""The bodies of many members: from numbers put into the table ``[body]`` to a stack.

Axes and inertias given by their components are converted all at once, where the kind of body has a form for this, ``E =
1/2 tr(J) I - J``; shapes, and bodies under gravity, whose inertia must suit the mass, one after the other.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..geometry.arrays import Array
from ..models.bodies import BODIES, many_euler
from ..models.stack import SystemStack
from ..runfile.body import Body
from ..runfile.folder import Folder
from ..runfile.problems import problems_of
from .draws import Values

AT_ONCE = ("axis", "inertia")
DOUBTFUL = 1e-6  # of the trace: members with a smaller eigenvalue of E are checked one by one


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
    m = len(next(iter(values.values())))
    data, made, invalid = body.model_dump(exclude_none=True), [], {}
    for i in range(m):
        own = with_values(data, {key: array[i] for key, array in values.items()})
        try:
            made.append(Body.model_validate(own).system(folder))
        except ValidationError as error:
            invalid[i] = "; ".join(map(str, problems_of(error, own, Body, ("body",))))
        except ValueError as error:
            invalid[i] = str(error)
    _require(invalid)
    return SystemStack.of(made)


def _require(invalid: dict[int, str]) -> None:
    if invalid:
        raise InvalidMembersError(invalid)


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
    kind, m, invalid = BODIES[body.kind], len(next(iter(values.values()))), dict[int, str]()
    given = {name: components(getattr(body, name), name, values, m) for name in AT_ONCE if name in kind.takes}
    J = given["inertia"]
    J = given["inertia"] = J if J.ndim == 3 else J[:, :, None] * np.eye(3)
    assert kind.at_once is not None
    how: dict[str, Any] = {} if body.physical is None else {"physical": body.physical}
    E, fixed = kind.at_once(J), None if "axis" in given else kind.make(**kind.sample).axis
    axis = given.get("axis") if fixed is None else np.repeat(fixed[None], m, axis=0)
    doubtful = np.linalg.eigvalsh(E)[:, 0] <= DOUBTFUL * np.trace(E, axis1=1, axis2=2)
    doubtful |= (J.swapaxes(1, 2) != J).any(axis=(1, 2)) | (many_euler(J) != E).any(axis=(1, 2))
    if axis is not None:
        length = np.sqrt(axis[:, 0] * axis[:, 0] + axis[:, 1] * axis[:, 1] + axis[:, 2] * axis[:, 2])
        doubtful |= length == 0
        axis = axis / np.where(length == 0, 1.0, length)[:, None]
    for i in np.flatnonzero(doubtful).tolist():
        try:
            E[i] = kind.make(**{name: array[i] for name, array in given.items()}, **how).euler_inertia
        except ValueError as error:
            invalid[i] = str(error)
    _require(invalid)
    return SystemStack(E, axis, name=body.kind, **how)
