"""Every public function and class says what its parameters are and shows an example, which does what it says."""

import doctest
import enum
import inspect
import re

import pytest
from numpydoc.docscrape import NumpyDocString

import nontwist
from nontwist.errors import InputWarning, PythonOptions, SweepError
from nontwist.inertia import MassProperties
from nontwist.recordings.options import ReadOptions
from nontwist.results import Fit, LeastEffort, Propagator, Steering, Stepper, StepperState
from nontwist.spec import specs

OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
ORDER = ["Parameters", "Attributes", "Returns", "Raises", "Warns", "See Also", "Notes", "References", "Examples"]
NO_EXAMPLE = {SweepError, InputWarning}  # a worker would have to die; as InputError
NOT_CALLED = (BaseException, enum.Enum, MassProperties)  # a user reads their attributes; these have texts of their own
# Made by functions: what they are made of is nobody's business.
MADE = (Fit, LeastEffort, Propagator, Steering, Stepper, StepperState)


def public():
    """Return the public functions and classes by name, each once."""
    found = {}
    for place in ("", *(name for name in nontwist.__all__ if inspect.ismodule(getattr(nontwist, name)))):
        space = getattr(nontwist, place) if place else nontwist
        own = [name for name, value in vars(space).items() if getattr(value, "__module__", "") == space.__name__]
        for name in getattr(space, "__all__", [name for name in own if name.islower() and not name.startswith("_")]):
            value = getattr(space, name)
            if (inspect.isfunction(value) or inspect.isclass(value)) and value not in found.values():
                found[f"{place}.{name}".lstrip(".")] = value
    return found


PUBLIC = public()
LATE = {"reproduce", "results.Fit", "results.LeastEffort"}  # whose examples, and those of figures, take long


def headings(thing):
    return re.findall(r"^(\S.*)\n-+$", inspect.getdoc(thing), re.MULTILINE)


def is_late(name):
    return [pytest.mark.long] * (name in LATE or name.startswith("plot."))


SHOWN = [pytest.param(name, marks=is_late(name)) for name, thing in PUBLIC.items() if thing not in NO_EXAMPLE]


@pytest.mark.parametrize("name", SHOWN)
def test_example(name, tmp_path, monkeypatch):
    thing = PUBLIC[name]
    assert "Examples" in headings(thing), f"{name} has no example"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    finder = doctest.DocTestFinder(recurse=False, exclude_empty=False)
    (example,) = finder.find(thing, name, globs={"__name__": "__main__"})
    told = []
    result = doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=told.append)
    assert result.attempted
    assert not result.failed, "".join(told)


def test_simulate_names_integrators_with_times():
    (told,) = (
        " ".join(p.desc) for p in NumpyDocString(inspect.getdoc(nontwist.simulate))["Parameters"] if p.name == "times"
    )
    assert {name for name in nontwist.integrators.INTEGRATORS if f'"{name}"' in told} == {
        name for name, scheme in nontwist.integrators.INTEGRATORS.items() if scheme.any_times
    }


def test_sections_and_parameters():
    for name, thing in PUBLIC.items():
        found = headings(thing)
        assert found == [heading for heading in ORDER if heading in found], name
        if inspect.isclass(thing) and issubclass(thing, (*NOT_CALLED, *MADE)):
            continue
        text = NumpyDocString(inspect.getdoc(thing))
        lines = [entry.name for section in ("Parameters", "Attributes") for entry in text[section]]
        described = [one.strip(" *") for line in lines for one in line.split(",")]
        assert sorted(described) == sorted(inspect.signature(thing).parameters), name


def test_shared_options():
    for function, names in ((nontwist.read_motion, specs(ReadOptions)), (nontwist.fit_inertia, ["body", "rate"])):
        words = " ".join(function.__doc__.split())
        for name in names:
            text = specs(ReadOptions)[name][2].text.format(option=PythonOptions())
            assert re.search(rf"\b{name} : ", words)
            assert " ".join(text.split()) in words
