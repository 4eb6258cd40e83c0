"""Every kind of body, one entry each: read by run files, sweeps, the viewer, `nontwist validate` and the tests.

They read `BODIES` on every call, so a kind that is added at run time counts from then on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from .catalogue import heavy_top, nontwisting, standard, suslov
from .system import DirectorSystem

KEYS = ("inertia", "axis", "mass", "centre_of_mass", "gravity", "spin", "physical")  # of the table [body]


@dataclass(frozen=True)
class BodyKind:
    """A kind of body.

    Attributes
    ----------
    make : callable
        Returns a `DirectorSystem` whose name is the key of this entry. Its parameters are keys of a run file:
        `inertia`, and any of `axis`, `mass`, `centre_of_mass`, `gravity`, `spin`, `physical`. Parameters with a
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
        `make` has no parameter `inertia`, or one that is not a key of run files.
    """

    make: Callable[..., DirectorSystem]
    words: str
    sample: dict[str, Any]
    principal: bool = False
    at_once: Callable[[Array], Array] | None = None

    def __post_init__(self) -> None:
        unknown = [key for key in self.takes if key not in KEYS]
        if unknown or "inertia" not in self.takes:
            what = f"takes {unknown[0]!r}, which is not a key of [body]" if unknown else "takes no inertia"
            raise ValueError(f"{self.words!r} {what}: a body accepts inertia and any of {', '.join(KEYS[1:])}")

    @cached_property
    def takes(self) -> tuple[str, ...]:
        """The parameters of `make`."""
        return tuple(signature(self.make).parameters)

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
