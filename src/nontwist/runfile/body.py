"""The table ``[body]``: what turns."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model

from ..geometry.arrays import Array
from ..models.bodies import BODIES
from ..models.catalogue import with_gravity
from ..models.inertia import (
    of_cuboid,
    of_cylinder,
    of_ellipsoid,
    of_points,
    shift,
)
from ..models.mesh import MassProperties, of_mesh
from ..models.system import DirectorSystem
from .folder import Folder
from .section import AN_AXIS, Axis, Matrix, OneOf, Positive, Section, Vector, by_shape

# Inertias made from a shape: `inertia = { cuboid = { mass = 2.0, lengths = [0.1, 0.2, 0.3] } }`.
#
# `MAKERS` is the visible list: a new maker is one class and one line. All inertias are about the fixed point, which is
# the centre of mass of the shape unless `offset` puts it elsewhere.


class Maker(Section):
    """A shape with mass."""

    @abstractmethod
    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia about the point from which the shape is `offset` away."""


class Cuboid(Maker):
    """A solid cuboid."""

    mass: Positive = Field(description="a positive number, kg")
    lengths: Annotated[list[Positive], Field(min_length=3, max_length=3)] = Field(
        description="3 positive numbers, m: the edges along the body axes"
    )

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        return _shifted(self.mass, offset, of_cuboid(self.mass, self.lengths))


class Cylinder(Maker):
    """A circular cylinder, solid or hollow."""

    mass: Positive = Field(description="a positive number, kg")
    radius: Positive = Field(description="a positive number, m")
    length: Positive = Field(description="a positive number, m")
    inner_radius: Annotated[float, Field(ge=0)] = Field(default=0.0, description="a number from 0 to the radius, m")
    axis: Axis = Field(default=[0.0, 0.0, 1.0], description=AN_AXIS + "along the cylinder, in body components")

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        J = of_cylinder(self.mass, self.radius, self.length, inner_radius=self.inner_radius, axis=self.axis)
        return _shifted(self.mass, offset, J)


class Ellipsoid(Maker):
    """A solid ellipsoid."""

    mass: Positive = Field(description="a positive number, kg")
    semi_axes: Annotated[list[Positive], Field(min_length=3, max_length=3)] = Field(
        description="3 positive numbers, m: along the body axes; three times the radius for a sphere"
    )

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        return _shifted(self.mass, offset, of_ellipsoid(self.mass, self.semi_axes))


class Points(Maker):
    """Point masses."""

    masses: list[Annotated[float, Field(ge=0)]] = Field(description="numbers >= 0, kg, one for each point")
    positions: list[Vector] = Field(description="rows of 3 numbers, m: the points, in body components")

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        if len(self.masses) != len(self.positions):
            raise ValueError(f"{len(self.masses)} masses, but {len(self.positions)} positions")
        m, x = np.array(self.masses), np.array(self.positions).reshape(-1, 3) + offset
        J = of_points(m, x)
        return MassProperties(float(m.sum()), m @ x / m.sum(), J)


class Mesh(Maker):
    """A closed surface of triangles from a file."""

    file: str = Field(description="a closed mesh (STL, OBJ, PLY, ...), relative to the run file, in quotes")
    density: Positive | None = Field(default=None, description="a positive number, kg/m³; or mass is given")
    mass: Positive | None = Field(default=None, description="a positive number, kg; or density is given")
    scale: Positive = Field(default=1.0, description="a positive number, m: the unit of the file; 0.001 for mm")
    about: Literal["centre_of_mass", "origin"] = Field(
        default="centre_of_mass", description='the fixed point: "centre_of_mass", or "origin" of the mesh'
    )

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        try:
            made = of_mesh(*folder.mesh(self.file), density=self.density, mass=self.mass, scale=self.scale)
        except (OSError, ImportError) as error:
            raise ValueError(str(error)) from error
        centre = offset if self.about == "centre_of_mass" else offset + made.centre_of_mass
        return _shifted(made.mass, centre, made.inertia)


def _shifted(mass: float, centre: Array, J: Array) -> MassProperties:
    return MassProperties(mass, centre, shift(J, mass, centre))


MAKERS: dict[str, type[Maker]] = {
    "cuboid": Cuboid,
    "cylinder": Cylinder,
    "ellipsoid": Ellipsoid,
    "points": Points,
    "mesh": Mesh,
}


class Placed(Section):
    """A shape, and where it is."""

    offset: Vector = Field(default=[0.0, 0.0, 0.0], description="3 numbers, m: from the fixed point to the shape")

    @property
    def chosen(self) -> list[str]:
        """The makers that are given; there must be one."""
        return [name for name in MAKERS if getattr(self, name) is not None]

    def made(self, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia about the fixed point."""
        if len(self.chosen) != 1:
            raise ValueError(f"one of {', '.join(MAKERS)} makes an inertia, not {' and '.join(self.chosen) or 'none'}")
        maker: Maker = getattr(self, self.chosen[0])
        return maker.made(np.array(self.offset), folder)


_fields: dict[str, Any] = {
    name: (maker | None, Field(default=None, description=f"a table: {maker.__doc__}".rstrip(".")))
    for name, maker in MAKERS.items()
}
if TYPE_CHECKING:
    MadeInertia = Placed
else:
    MadeInertia = create_model("MadeInertia", __base__=Placed, __doc__=Placed.__doc__, **_fields)


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
