"""Tables of the reference, made from the package itself: `%run ../_extensions/registry.py` in a hidden cell."""

import inspect
import re
import warnings
from importlib import import_module

import pandas as pd

import nontwist
from nontwist import body_moment, damping, integrate, moment, nontwisting, rotor, space_moment, wheel
from nontwist.integrators import INTEGRATORS
from nontwist.models.bodies import sample_bodies
from nontwist.paper.tables import LABEL

PROBLEMS = {
    **{name: (body, None) for name, body in sample_bodies().items()},
    "load along directors": (nontwisting([2, 3, 4]), body_moment(lambda t: (0.1, 0.3, 0))),
    "load along fixed axes": (nontwisting([2, 3, 4]), space_moment(lambda t: (0.1, 0.2, 0))),
    "rotor": (nontwisting([2, 3, 4]), rotor((0, 1, 0), 0.5)),
    "wheel": (nontwisting([2, 3, 4]), wheel((0, 1, 0), 0.5, speed=3)),
    "prescribed spin": (nontwisting([2, 3, 4], spin=1), None),
    "load of the state": (nontwisting([2, 3, 4]), damping(0.1) + moment(lambda t, d, w: -0.1 * w)),
}


def table_of(*modules):
    """Return the public functions of catalogues, their parameters and the first lines of their docstrings."""
    rows = [
        (name, ", ".join(inspect.signature(f).parameters), _first_line(f))
        for module in modules
        for name, f in vars(import_module(module)).items()
        if inspect.isfunction(f) and f.__module__ == module and name in dir(nontwist)
    ]
    table = pd.DataFrame(rows, columns=["function", "parameters", "description"])
    return table.style.hide(axis="index").set_properties(**{"text-align": "left"})


def _first_line(function):
    line = inspect.getdoc(function).splitlines()[0].removeprefix("Return ").replace("`", "")
    return re.sub(rf" \({LABEL.pattern}.*?\)", "", line)  # the labels of equations are below


def _accepts(name, problem):
    system, load = problem
    try:
        how = {"material_angular_velocity": (0, 0.3, 0), "project": True, "load": load, "integrator": name}
        integrate(system, t_end=0.1, step=0.05, **how)
    except ValueError:
        return "–"
    return "yes"


def table_of_integrators():
    """Return what each integrator has and takes, by trying."""
    warnings.simplefilter("ignore")
    rows = {}
    for name, cls in INTEGRATORS.items():
        orders = ", ".join(map(str, cls.orders)) or "–"
        rows[name] = {"orders": orders, "output at": "any times" if cls.any_times else "steps"}
        rows[name] |= {what: _accepts(name, problem) for what, problem in PROBLEMS.items()}
    return pd.DataFrame(rows).style.set_properties(**{"text-align": "left"})
