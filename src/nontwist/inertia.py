"""Inertia of boxes, cylinders, ellipsoids, points and meshes; shifted, in principal axes, convected and Euler's."""

from .geometry.values import public
from .models.mesh import MassProperties, of_mesh
from .models.solids import of_cuboid, of_cylinder, of_ellipsoid, of_points, principal_frame, shift
from .models.system import convected_inertia, euler_inertia

__all__ = [
    "MassProperties",
    "convected_inertia",
    "euler_inertia",
    "of_cuboid",
    "of_cylinder",
    "of_ellipsoid",
    "of_mesh",
    "of_points",
    "principal_frame",
    "shift",
]
public(__name__)
