"""Rigid bodies described by directors, non-twisting frames, and integrators that keep their invariants."""

from importlib import import_module
from typing import Any

_HOME = {
    **dict.fromkeys(("heavy_top", "nontwisting", "standard", "suslov", "with_gravity"), "models.catalogue"),
    "SystemStack": "models.stack",
    **dict.fromkeys(("DirectorSystem", "convected_inertia", "euler_inertia", "split_inertia"), "models.system"),
    **dict.fromkeys(("inertia_of_cuboid", "inertia_of_cylinder", "inertia_of_ellipsoid"), "models.inertia"),
    **dict.fromkeys(("inertia_of_points", "shift_inertia"), "models.inertia"),
    **dict.fromkeys(("MassProperties", "inertia_of_mesh"), "models.mesh"),
    "principal_frame": "models.principal",
    **dict.fromkeys(("Load", "body_moment", "damping", "moment", "pulse", "sine", "space_moment"), "loads"),
    **dict.fromkeys(("Continuous", "EnergyMomentum", "Exact", "LieMidpoint", "Split"), "integrators"),
    **dict.fromkeys(("INTEGRATORS", "SimulationError", "SimulationInterrupt", "Status"), "integrators"),
    "Trajectory": "analysis.trajectory",
    "rotation": "analysis.motions",
    **dict.fromkeys(("observed_order", "second_quotient"), "analysis.precision"),
    **dict.fromkeys(("integrate", "simulate", "simulate_ensemble"), "driver"),
    **dict.fromkeys(("ResultFileError", "open_run", "save_run"), "io"),
    "resample": "analysis.resampling",
    "twist": "analysis.twisting",
    **dict.fromkeys(("closed_frame", "frame_error_estimate", "nontwisting_frame"), "geometry.frames"),
    **dict.fromkeys(("frame_along", "frame_of_curve", "holonomy", "solid_angle"), "geometry.frames"),
    "compare": "comparison",
    **dict.fromkeys(("RunFile", "RunFileError", "read_run_file"), "runfile"),
    "reproduce": "paper",
    "validate": "validation",
    **dict.fromkeys(("SweepError", "SweepStoreError", "open_sweep", "sweep", "sweep_member"), "sweeps"),
    "view": "viewer",
}
_NAMESPACES = {
    "comparison": "comparison",
    "exact": "exact",
    "plot": "plot",
    "rotations": "geometry.rotations",
    "sphere": "geometry.sphere",
}

__all__ = sorted([*_HOME, *_NAMESPACES])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("nontwist")
    if name in _HOME:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    elif name in _NAMESPACES:
        value = import_module(f"{__name__}.{_NAMESPACES[name]}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
