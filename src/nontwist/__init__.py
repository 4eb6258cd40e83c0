"""Rigid bodies described by directors, non-twisting frames, and integrators that conserve their invariants.

Bodies: standard, nontwisting, suslov, heavy_top, with_gravity, DirectorSystem, SystemStack
    Moments of inertia of solids, points and meshes: inertia
Loads: constant, sine, pulse, space_moment, body_moment, moment, damping, dry_friction, Load
    With a potential: dipole, spring, gravity_gradient, potential; on directors: director_forces
    With states of their own: wheel, rotor, memory_load
Motions: simulate, integrate, resample, Problem
    Many: simulate_ensemble, propagator, sweep, open_sweep, sweep_member; step by step: stepper
    Events: axis_crosses, spin_below; derivatives: sensitivities, gradient, jax; chaos: lyapunov, lyapunov_ensemble
    Schemes: integrators; closed forms: exact; several side by side: compare, comparison
    Controls: steer, least_effort
Runs: save_run, open_run, join_runs, drifts, point_position, point_velocity, results
    Figures: plot; an interactive page: view
Recordings: read_motion, rotation, twist, TwistCounter, fit_inertia, sensors
Geometry: rotations, sphere, curves, split_form
The paper and known numbers: reproduce, validate
Errors: errors
"""

from importlib import import_module
from typing import Any

# Public names are listed in `__init__.pyi` alone, with the modules that they are imported from on first use.
_loader: Any = __loader__
_stub = _loader.get_data(f"{__path__[0]}/__init__.pyi").decode().splitlines()
_HOME = {line.split()[3]: f"{__name__}{line.split()[1]}".rstrip(".") for line in _stub if line.startswith("from .")}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("nontwist")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = vars(import_module(_HOME[name]))
    value = home[name] if name in home else import_module(f"{_HOME[name]}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
