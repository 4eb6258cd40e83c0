"""Every public function, with inputs of every kind: a finite result or a documented exception, and nothing else."""

import builtins
import faulthandler
import inspect
import re
import signal
import warnings
import zlib
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from types import FunctionType

import numpy as np
import pandas
import pytest
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpydoc.docscrape import NumpyDocString
from pydantic import BaseModel
from scipy.spatial.transform import Rotation

import nontwist
from fuzz_values import NEEDED, Draws, strategy
from fuzz_wrong import THINGS, damaged
from nontwist import errors
from nontwist.geometry.values import short_repr
from nontwist.integrators import Integrator
from nontwist.integrators.compiled import Compiled
from public.test_docstrings import MADE, NOT_CALLED, PUBLIC

PLACES = (builtins, nontwist, errors)  # of exceptions and warnings
TIMED = re.compile("seconds|run_time|newton_iterations|version|memory")  # what differs from machine to machine
SECONDS = 20
VALID = 0.3  # least part of the inputs of each function that must give a result
INPUTS, FEW = 100, 2
SLOW = {"compare": 60, "reproduce": 20, "sweep": 60, "plot.save": 40, "open_run": 60, "save_run": 60}
MADE_BY_THE_PACKAGE = (nontwist.results.Trajectory, nontwist.runfile.RunFile, *MADE)  # nobody calls these classes


def functions():
    """Return what can be called, by name: functions, classes, and the methods that a class defines itself."""
    found = {}
    for name, thing in PUBLIC.items():
        if not inspect.isclass(thing):
            found[name] = thing
            continue
        if issubclass(thing, NOT_CALLED):
            continue
        if not issubclass(thing, MADE_BY_THE_PACKAGE):
            found[name] = thing
        base = Compiled if issubclass(thing, Compiled) else Integrator
        for method, raw in vars(thing).items():
            public = not method.startswith("_") and isinstance(raw, (FunctionType, staticmethod, classmethod))
            if public and not hasattr(base, method) and not hasattr(BaseModel, method):
                found[f"{name}.{method}"] = getattr(thing, method)
    return found


FUNCTIONS = functions()


def strategies(name):
    """Return what draws a valid value, and whether it may be left out, for each parameter of a function."""
    function = FUNCTIONS[name]
    text = NumpyDocString(inspect.getdoc(function))
    entries = [entry for section in ("Parameters", "Attributes") for entry in text[section]]
    said = {one.strip(" *"): entry.type for entry in entries for one in entry.name.split(",")}
    found = {}
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.VAR_KEYWORD:
            continue
        annotation = name.split(".")[-2] if parameter.name == "self" else str(parameter.annotation)
        draw = strategy(name, parameter.name, annotation, said.get(parameter.name, ""))
        optional = parameter.default is not parameter.empty and parameter.name not in NEEDED
        found[parameter.name] = draw, optional and f"{name}.{parameter.name}" not in NEEDED, parameter.kind
    return found


def drawn(r, table, broken):
    """Return arguments: all valid; or, where `broken`, one to three of them wrong."""
    given = r.given = {}
    for name, (draw, optional, _) in table.items():
        if not optional or r.random() < 0.6:
            given[name] = draw(r)
    candidates = [name for name in table if name != "self"]
    for name in r.permutation(candidates)[: r.choice([1, 1, 1, 2, 3])] if broken and candidates else ():
        value = given[name] if name in given else table[name][0](r)
        things = [thing for thing in THINGS if not (thing is None and name in NEEDED)]
        given[name] = damaged(r, value) if r.random() < 0.6 else things[r.integers(len(things))]
    return given


def called(name, table, given):
    kinds = {parameter: kind for parameter, (_, _, kind) in table.items()}
    loose = [value for key, value in given.items() if kinds[key] is inspect.Parameter.VAR_POSITIONAL]
    first = [value for key, value in given.items() if kinds[key] is not inspect.Parameter.KEYWORD_ONLY] if loose else []
    rest = {key: value for key, value in given.items() if not loose}
    return FUNCTIONS[name](*first, **rest)


def documented(name, section):
    """Return the exceptions or warnings that a docstring names."""
    entries = NumpyDocString(inspect.getdoc(FUNCTIONS[name]))[section]
    names = [one.strip() for entry in entries for one in entry.type.split(",")]
    return tuple(next(getattr(place, one) for place in PLACES if hasattr(place, one)) for one in names)


def allows_nan(name):
    text = NumpyDocString(inspect.getdoc(FUNCTIONS[name]))
    return any("NaN" in str(text[section]) for section in ("Returns", "Notes"))


def leaves(value):
    """All numbers in a result, as arrays, in an order of their own."""
    if isinstance(value, (bool, int, float, complex, np.generic, np.ndarray)):
        array = np.asarray(value)
        if array.dtype.kind in "mM":
            array = array.astype("int64").astype(float)
        if array.dtype.kind in "fiub":
            yield array.astype(float)
        elif array.dtype.kind == "O":
            yield from (one for entry in array.flat if entry is not value for one in leaves(entry))
    elif isinstance(value, str):
        yield from (np.array(float(word)) for word in re.findall(r"(?<![\w.])-?\d+\.?\d*(?:e[+-]?\d+)?(?!\w)", value))
    elif isinstance(value, Rotation):
        yield value.as_quat()
    elif isinstance(value, Axes):
        for line in value.lines:
            yield np.asarray(line._verts3d if hasattr(line, "_verts3d") else line.get_xydata(), dtype=float)
            yield np.array(line.get_linewidth())
        for one in value.collections:
            yield from leaves(one._faces if hasattr(one, "_faces") else [path.vertices for path in one.get_paths()])
        yield from leaves([getattr(value, "elev", 0.0), getattr(value, "azim", 0.0), value.figure.get_size_inches()])
    elif isinstance(value, Figure):
        yield from leaves(value.axes)
    elif isinstance(value, nontwist.Load) and not value.depends_on_state:
        yield from (value.sample(np.linspace(0, 1, 7), kind) for kind in ("body", "space"))
    elif isinstance(value, (xarray.Dataset, pandas.DataFrame)):
        kept = value.variables if isinstance(value, xarray.Dataset) else value.columns
        yield from leaves({name: value[name].values for name in kept})
    elif isinstance(value, xarray.DataArray):
        yield from leaves([value.values, *(value[name].values for name in sorted(value.coords))])
    elif isinstance(value, BaseModel):
        yield from leaves(value.model_dump())
    elif isinstance(value, Mapping):
        yield from (one for key in sorted(value, key=str) if not TIMED.search(str(key)) for one in leaves(value[key]))
    elif isinstance(value, (list, tuple)):
        yield from (one for entry in value for one in leaves(entry))
    elif hasattr(value, "__array__"):
        yield from leaves(np.asarray(value))
    elif isinstance(value, nontwist.results.BodyState):
        yield from leaves([value.time, value.quaternion, value.material_angular_velocity])
    elif is_dataclass(value) and not isinstance(value, (Enum, type)):
        own = {field.name: getattr(value, field.name) for field in fields(value)}
        yield from leaves({name: one for name, one in own.items() if name != "physical" or not one})  # since 0.3.0


class TooLong(BaseException):
    """A call that does not end."""


@contextmanager
def at_most(seconds):
    """End what takes more processor time, compilation left out; a kernel that never ends ends the process."""

    def ring(signum, frame):
        while frame is not None:
            if frame.f_globals.get("__name__", "").startswith(("nontwist.kernels.", "llvmlite.")):
                signal.setitimer(signal.ITIMER_PROF, seconds)
                return
            frame = frame.f_back
        raise TooLong

    old = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    faulthandler.dump_traceback_later(100 * seconds, exit=True)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGPROF, old)


def unread(name, result):
    """Whether the numbers of a result are no answer: positions of curves, bounds of times in loads, an empty state."""
    yield name.startswith("plot.")
    yield isinstance(result, nontwist.Load) and result.depends_on_state
    yield type(result) is nontwist.results.BodyState


def verdict(name, table, given):
    """Return (whether a result came, what is wrong with the outcome or None)."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            with at_most(SECONDS):
                result = called(name, table, given)
                numbers = () if any(unread(name, result)) else [getattr(result, "load_work", 0.0), *leaves(result)]
                infinite = np.isinf if allows_nan(name) else lambda array: ~np.isfinite(array)
                problem = "a result that is not finite" if any(infinite(one).any() for one in numbers) else None
            good = True
        except TooLong:
            good, problem = False, f"not done within {SECONDS} s of processor time"
        except Exception as error:
            good = False
            known = isinstance(error, documented(name, "Raises"))
            problem = None if known else f"{type(error).__name__}, which its docstring does not name: {error!s:.300}"
    for warning in caught:
        if not isinstance(warning.message, documented(name, "Warns")):
            problem = problem or f"{warning.category.__name__}, which its docstring does not name: {warning.message}"
    return good, problem


def fuzz(name, count):
    table, r = strategies(name), Draws(np.random.PCG64(zlib.crc32(name.encode())))
    good, problems = 0, {}
    for k in range(count):
        given = drawn(r, table, broken=k % 2 == 1)
        came, problem = verdict(name, table, given)
        good += came
        if problem:
            problems.setdefault(problem, given)
    found = [
        f"{name}({', '.join(f'{key}={short_repr(value)}' for key, value in given.items())}):\n    {problem}"
        for problem, given in problems.items()
    ]
    assert not found, "\n".join([f"{len(found)} different problems", *found])
    assert good >= VALID * count, (
        f"{name} gave a result for {good} of {count} inputs; add valid ones to VALUES in tests/fuzz_values.py"
    )


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_few_inputs(name):
    fuzz(name, 1 if name in SLOW else FEW)


@pytest.mark.long
@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_many_inputs(name):
    fuzz(name, SLOW.get(name, INPUTS))


def test_many_inputs_are_ten_thousand():
    assert sum(SLOW.get(name, INPUTS) for name in FUNCTIONS) >= 10_000
