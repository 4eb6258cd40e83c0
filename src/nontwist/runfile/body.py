"""The table ``[body]``: what turns."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from functools import cache
from inspect import signature
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, create_model
from pydantic_core import CoreSchema, core_schema

from ..geometry.arrays import AXES, Array
from ..geometry.values import MadeByName
from ..models.bodies import BODIES, KEYS, with_gravity
from ..models.mesh import MassProperties, of_mesh
from ..models.solids import of_cuboid, of_cylinder, of_ellipsoid, of_points, shift
from ..models.system import DirectorSystem
from ..spec import specs
from .files import Fault, Folder, shown
from .section import AN_AXIS, BY_FORM, Axis, Matrix, OneOf, Positive, Section, Vector, entry, key_of, words_of

# Inertias made from a shape: `inertia = { cuboid = { mass = 2.0, lengths = [0.1, 0.2, 0.3] } }`.
#
# `MadeInertia` is the visible list: a new shape is one class and one line. All inertias are about the fixed point,
# which is the centre of mass of the shape unless `offset` puts it elsewhere.


class Maker(Section):
    """A shape with mass."""

    @abstractmethod
    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia about the point from which the shape is `offset` away."""


class Solid(Maker):
    """A shape whose keys are the arguments of the function `inertia`, which is about its centre."""

    inertia: ClassVar[Callable[..., Array]]
    mass: Positive = entry("a positive number, {unit}", unit="kg")

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        return _shifted(self.mass, offset, type(self).inertia(**self.model_dump()))


class Cuboid(Solid):
    """A solid cuboid."""

    inertia = of_cuboid
    lengths: list[Positive] = entry(
        "3 positive numbers, {unit}: the edges along the body axes", min_length=3, max_length=3, unit="m"
    )


class Cylinder(Solid):
    """A circular cylinder, solid or hollow."""

    inertia = of_cylinder
    radius: Positive = entry("a positive number, {unit}", unit="m")
    length: Positive = entry("a positive number, {unit}", unit="m")
    inner_radius: float = entry("a number from 0 to the radius, {unit}", 0.0, ge=0, unit="m")
    axis: Axis = entry(AN_AXIS + "along the cylinder, in body components", AXES["z"])


class Ellipsoid(Solid):
    """A solid ellipsoid."""

    inertia = of_ellipsoid
    semi_axes: list[Positive] = entry(
        "3 positive numbers, {unit}: along the body axes; three times the radius for a sphere",
        min_length=3,
        max_length=3,
        unit="m",
    )


class Points(Maker):
    """Point masses."""

    masses: list[Annotated[float, Field(ge=0)]] = entry("numbers >= 0, {unit}, one for each point", unit="kg")
    positions: list[Vector] = entry("rows of 3 numbers, {unit}: the points, in body components", unit="m")

    def made(self, offset: Array, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia."""
        if len(self.masses) != len(self.positions):
            raise ValueError(f"{len(self.masses)} masses, but {len(self.positions)} positions")
        m, x = np.array(self.masses), np.reshape(self.positions, (len(self.masses), 3)) + offset
        J = of_points(m, x)
        return MassProperties(float(m.sum()), m @ x / m.sum(), J)


class Mesh(Maker):
    """A closed surface of triangles from a file."""

    file: str = entry("a closed mesh (STL, OBJ, PLY, ...), relative to the run file, in quotes")
    density: Positive | None = entry("a positive number, {unit}; or mass is given", None, unit="kg/m³")
    mass: Positive | None = entry("a positive number, {unit}; or density is given", None, unit="kg")
    scale: Positive = entry("a positive number, {unit}: the unit of the file; 0.001 for mm", 1.0, unit="m")
    about: Literal["centre_of_mass", "origin"] = entry(
        'the fixed point: "centre_of_mass", or "origin" of the mesh', "centre_of_mass"
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


class MadeInertia(Section):
    """A shape, and where it is."""

    offset: Vector = entry("3 numbers, {unit}: from the fixed point to the shape", [0.0, 0.0, 0.0], unit="m")
    cuboid: Cuboid | None = entry("a table: A solid cuboid", None)
    cylinder: Cylinder | None = entry("a table: A circular cylinder, solid or hollow", None)
    ellipsoid: Ellipsoid | None = entry("a table: A solid ellipsoid", None)
    points: Points | None = entry("a table: Point masses", None)
    mesh: Mesh | None = entry("a table: A closed surface of triangles from a file", None)

    @property
    def chosen(self) -> dict[str, Maker]:
        """The shapes that are given; there must be one."""
        return {name: shape for name, shape in self if isinstance(shape, Maker)}

    def made(self, folder: Folder) -> MassProperties:
        """Return mass, centre of mass and inertia about the fixed point."""
        (shape,) = self.chosen.values()
        return shape.made(np.array(self.offset), folder)


MAKERS = [name for name in MadeInertia.model_fields if name != "offset"]
GRAVITY = [0.0, 0.0, -9.81]
OF_SOME = {"axis": "an axis", "physical": "physical", "spin": "a spin"}  # keys that some kinds take
OF_WEIGHT = {"mass": "a mass", "centre_of_mass": "a centre of mass", "gravity": "gravity"}
WEIGHT = tuple(OF_WEIGHT)


class SpinTable(Section):
    """A prescribed spin, linear between its times and constant outside."""

    times: list[float] = entry("2 or more increasing numbers, {unit}", min_length=2, unit="s")
    values: list[float] = entry("a rate for each time, {unit}", unit="rad/s")


class Body(Section):
    """The body: its kind, its inertia about the fixed point, its spin, and its weight where gravity acts."""

    error_key: ClassVar[str] = "inertia"
    kind: Annotated[str, OneOf(BODIES, " or ", open=True)]
    inertia: Annotated[Vector | Matrix | MadeInertia, BY_FORM] = entry(
        "inertia about the fixed point, {unit}: 3 principal values, 3 rows of 3 numbers, or a table like { cuboid = { "
        "mass = 2.0, lengths = [0.1, 0.2, 0.3] } }",
        unit="kg m²",
    )
    axis: Axis | None = entry(AN_AXIS + "the held direction in the body", None)
    mass: Positive | None = entry("a positive number, {unit}", None, unit="kg")
    centre_of_mass: Vector | None = entry(
        "3 numbers, {unit}: from the fixed point to the centre of mass, in body components", None, unit="m"
    )
    gravity: Vector | None = entry("3 numbers, {unit}, in space; [0.0, 0.0, -9.81] by default", None, unit="m/s²")
    spin: Annotated[SpinTable | float, BY_FORM] | None = entry(
        "a number, {unit}: the prescribed rate about the third axis; or a table with the keys times and values",
        None,
        unit="rad/s",
    )
    physical: bool | None = entry(
        "false for an inertia that no distribution of mass has, as in some published problems", None
    )

    @property
    def takes(self) -> tuple[str, ...]:
        """The keys that this kind of body needs."""
        return BODIES[self.kind].takes

    @property
    def is_heavy(self) -> bool:
        """Whether this kind of body has a weight of its own."""
        return any(name in self.takes for name in WEIGHT)

    def unfit(self) -> Iterator[Fault]:
        """Yield keys that this kind of body, or of inertia, lacks or does not have."""
        some = OF_SOME | (OF_WEIGHT if self.is_heavy else {})
        for name, others in some.items():
            if name not in self.takes and (value := getattr(self, name)) is not None:
                able = [f'"{kind}"' for kind, one in BODIES.items() if name in one.takes]
                takes = f"{' and '.join(able)} take{'s' * (len(able) == 1)} {others}"
                yield Fault(f"body.{name}", shown(value), f'left out for kind = "{self.kind}"; {takes}')
        if "axis" in self.takes and self.axis is None:
            yield Fault("body.axis", "missing", words_of(Body, "axis"))
        own = BODIES[self.kind].has_default if self.is_heavy else {"gravity"}
        weight = {name: getattr(self, name) for name in WEIGHT if name in self.takes or not self.is_heavy}
        if isinstance(self.inertia, MadeInertia):
            if len(self.inertia.chosen) != 1:
                given = f"a table with {' and '.join(self.inertia.chosen) or 'no shape'}"
                yield Fault("body.inertia", given, f"a table with one of {', '.join(MAKERS)}")
            brought = "left out: the shape in body.inertia brings it"
            for name in ("mass", "centre_of_mass"):
                if weight.get(name) is not None:
                    yield Fault(f"body.{name}", shown(weight[name]), brought)
        elif self.is_heavy or any(value is not None for value in weight.values()):
            for name in (name for name, value in weight.items() if value is None and name not in own):
                yield Fault(f"body.{name}", "missing", f"{words_of(Body, name)}, where gravity acts")

    def weight(self, folder: Folder) -> tuple[float, Array] | None:
        """Return mass and centre of mass where gravity acts, None where it does not."""
        if isinstance(self.inertia, MadeInertia):
            if not self.is_heavy and self.gravity is None:
                return None
            made = self.inertia.made(folder)
            return made.mass, made.centre_of_mass
        if self.mass is None or self.centre_of_mass is None:
            return None
        return self.mass, np.array(self.centre_of_mass)

    def system(self, folder: Folder) -> DirectorSystem:
        """Return the body; a ValueError where no body has such numbers."""
        kind, weight, given = BODIES[self.kind], self.weight(folder), dict(self)
        given["inertia"] = self.inertia.made(folder).inertia if isinstance(self.inertia, MadeInertia) else self.inertia
        if isinstance(self.spin, SpinTable):
            given["spin"] = self.spin.times, self.spin.values
        if weight is not None:
            given |= dict(zip(WEIGHT, (*weight, self.gravity or GRAVITY), strict=True))
        own = {name for name in kind.has_default if getattr(self, name) is None}
        system = kind.make(**{name: given[name] for name in self.takes if name not in own})
        if weight is None or self.is_heavy:
            return system
        return with_gravity(system, **{name: given[name] for name in WEIGHT})


@cache
def table_of(name: str, make: Callable[..., DirectorSystem]) -> type[Body]:
    """Return the table of a kind of body whose function has parameters of its own, or no inertia."""
    keys: dict[str, Any] = {key: key_of(*one) for key, one in specs(make).items() if key not in KEYS}
    first = next(iter(keys), "kind")
    if "inertia" not in signature(make).parameters:
        keys["inertia"] = None, entry(f'left out for kind = "{name}"', None)
    made = create_model(f"Body of the kind {name}", __base__=Body, __doc__=make.__doc__, **keys)
    made.error_key = first if "inertia" in keys else Body.error_key
    return made


TABLES = MadeByName(  # of kinds of bodies that have keys of their own
    lambda: (name for name, kind in BODIES.items() if kind.own or "inertia" not in kind.takes),
    lambda name: table_of(name, BODIES[name].make),
)


class OfItsKind:
    """Annotation of a body: of a kind with keys of its own it is the table of that kind."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        source.kinds = TABLES

        def table(value: Any, other: Callable[[Any], Body]) -> Body:
            kind = value.get("kind") if isinstance(value, dict) else None
            return TABLES[kind].model_validate(value) if isinstance(kind, str) and kind in TABLES else other(value)

        own = core_schema.simple_ser_schema("any")
        return core_schema.no_info_wrap_validator_function(table, handler(source), serialization=own)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        found = [handler(schema), *(handler(form.__pydantic_core_schema__) for form in TABLES.values())]
        return {"anyOf": found} if len(found) > 1 else found[0]


AnyBody = Annotated[Body, OfItsKind()]
