"""The table ``[body]``: what turns."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Discriminator, Field, Tag

from ..geometry.arrays import Array
from ..models.bodies import BODIES
from ..models.catalogue import with_gravity
from ..models.system import DirectorSystem
from .folder import Folder
from .makers import MadeInertia
from .section import AN_AXIS, Axis, Matrix, OneOf, Positive, Section, Vector, by_shape

GRAVITY = [0.0, 0.0, -9.81]

Inertia = Annotated[
    Annotated[Vector, Tag("<values>")] | Annotated[Matrix, Tag("<rows>")] | Annotated[MadeInertia, Tag("<table>")],
    Discriminator(by_shape),
]


class SpinTable(Section):
    """A prescribed spin, linear between its times and constant outside."""

    times: Annotated[list[float], Field(min_length=2)] = Field(description="2 or more increasing numbers, s")
    values: list[float] = Field(description="a rate for each time, rad/s")


class Body(Section):
    """The body: its kind, its inertia about the fixed point, its spin, and its weight where gravity acts."""

    kind: Annotated[str, OneOf(BODIES, " or ", open=True)]
    inertia: Inertia = Field(
        description="inertia about the fixed point, kg m²: 3 principal values, 3 rows of 3 numbers, "
        "or a table like { cuboid = { mass = 2.0, lengths = [0.1, 0.2, 0.3] } }"
    )
    axis: Axis | None = Field(default=None, description=AN_AXIS + "the held direction in the body")
    mass: Positive | None = Field(default=None, description="a positive number, kg")
    centre_of_mass: Vector | None = Field(
        default=None, description="3 numbers, m: from the fixed point to the centre of mass, in body components"
    )
    gravity: Vector | None = Field(default=None, description="3 numbers, m/s², in space; [0.0, 0.0, -9.81] by default")

    spin: (
        Annotated[
            Annotated[SpinTable, Tag("<table>")] | Annotated[float, Tag("<number>")],
            Discriminator(by_shape),
        ]
        | None
    ) = Field(
        default=None,
        description="a number, rad/s: the prescribed rate about the third axis; or a table with the keys times and "
        "values",
    )

    physical: bool | None = Field(
        default=None, description="false for an inertia that no distribution of mass has, as in some published problems"
    )

    @property
    def takes(self) -> tuple[str, ...]:
        """The keys that this kind of body needs."""
        return BODIES[self.kind].takes

    def weight(self, folder: Folder) -> tuple[float, Array] | None:
        """Return mass and centre of mass where gravity acts, None where it does not."""
        if isinstance(self.inertia, MadeInertia):
            if "mass" not in self.takes and self.gravity is None:
                return None
            made = self.inertia.made(folder)
            return made.mass, made.centre_of_mass
        if self.mass is None or self.centre_of_mass is None:
            return None
        return self.mass, np.array(self.centre_of_mass)

    def system(self, folder: Folder) -> DirectorSystem:
        """Return the body; a ValueError where no body has such numbers."""
        J = self.inertia.made(folder).inertia if isinstance(self.inertia, MadeInertia) else np.array(self.inertia)
        weight = self.weight(folder)
        mass, centre = weight or (None, None)
        heavy: dict[str, Any] = {"mass": mass, "centre_of_mass": centre, "gravity": self.gravity or GRAVITY}
        spin = (self.spin.times, self.spin.values) if isinstance(self.spin, SpinTable) else self.spin
        given = {"inertia": J, "axis": self.axis, "spin": spin, "physical": self.physical, **heavy}
        kind = BODIES[self.kind]
        own = {key for key in ("gravity", "spin", "physical") if getattr(self, key) is None and key in kind.has_default}
        system = kind.make(**{key: given[key] for key in self.takes if key not in own})
        return system if weight is None or "mass" in self.takes else with_gravity(system, **heavy)
