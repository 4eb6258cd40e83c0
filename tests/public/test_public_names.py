"""Public names stay what they are, whatever is imported, in any order."""

import ast
import pickle
import pkgutil
import random
import re
import subprocess
import sys
from importlib.resources import files
from types import ModuleType

import pytest

import nontwist
from nontwist.geometry.values import hinted

NAMESPACES = {name for name in nontwist.__all__ if isinstance(getattr(nontwist, name), ModuleType)}


def modules():
    return sorted(info.name for info in pkgutil.walk_packages(nontwist.__path__, "nontwist."))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_names_survive_every_import(seed):
    """And every module can be imported without LLVM."""
    order = modules()
    random.Random(seed).shuffle(order)
    code = (
        "import sys, importlib, types\n"
        "sys.modules['llvmlite'] = None\n"
        "import nontwist\n"
        f"for name in {order!r}: importlib.import_module(name)\n"
        "for name in nontwist.__all__:\n"
        "    value = getattr(nontwist, name)\n"
        "    is_module = isinstance(value, types.ModuleType)\n"
        f"    assert is_module == (name in {NAMESPACES}), name\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_module_names_are_unique():
    last = [name.rsplit(".", 1)[1] for name in modules()]
    assert [name for name in last if last.count(name) > 1] == []


def test_modules_and_functions_differ():
    last = {name.rsplit(".", 1)[1] for name in modules()}
    assert last & (set(nontwist.__all__) - NAMESPACES) == set()


def test_stub_as_python_reads_it():
    tree = ast.parse(files("nontwist").joinpath("__init__.pyi").read_text(encoding="utf-8"))
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert {(alias.name, alias.asname, node.module, node.level) for node in nodes for alias in node.names} == {
        (name, name, home.removeprefix("nontwist").lstrip(".") or None, 1) for name, home in nontwist._HOME.items()
    }


def test_help_lists_all_names():
    named = [name for line in nontwist.__doc__.splitlines()[2:] for name in re.findall(r"\w+", line.partition(":")[2])]
    assert {name for name in nontwist.__all__ if named.count(name) != 1} == set()


def test_completion_and_attribute_errors():
    assert {"simulate", "plot", "__version__"} <= set(dir(nontwist))
    assert nontwist.__version__
    with pytest.raises(AttributeError, match="module 'nontwist' has no attribute 'simulat'"):
        nontwist.simulat  # noqa: B018


@pytest.mark.parametrize("name", sorted(NAMESPACES))
def test_modules_list_public_names(name):
    """None of what they import; of modules without `__all__` what they define."""
    module = getattr(nontwist, name)
    assert sorted(dir(module)) == sorted(getattr(module, "__all__", dir(module)))
    for public in dir(module):
        assert not isinstance(getattr(module, public), ModuleType)
    assert not {"np", "annotations", "Any", "__doc__"} & set(dir(module))


@pytest.mark.parametrize(
    ("module", "name", "hint"),
    [
        (nontwist.plot, "twist", "did you mean twist_angle? it has directors, energy"),
        (nontwist.plot, "animate", "it has directors, energy"),
        (nontwist.inertia, "of_rod", "did you mean of_cylinder? it has MassProperties"),
        (nontwist.rotations, "rotvec", "it has cayley, cayley_inverse"),
    ],
)
def test_missing_attribute_is_guessed(module, name, hint):
    assert not hasattr(module, "__wrapped__")
    with pytest.raises(AttributeError) as told:
        getattr(module, name)
    assert str(told.value).startswith(f"module {module.__name__!r} has no attribute {name!r}; {hint}")


@pytest.mark.parametrize("name", sorted(NAMESPACES))
def test_called_module(name):
    """It is no function: what takes one refuses it."""
    module = getattr(nontwist, name)
    with pytest.raises(TypeError, match="'module' object is not callable"):
        module([0, 0, 0, 1], scalar_first=False)
    assert not callable(module)


BODY = nontwist.standard([3, 4, 5])
LOOP = nontwist.stepper(BODY, 0.1)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: nontwist.standard(J=[3, 4, 5]), "an unexpected keyword argument 'J'; did you mean inertia=?"),
        (
            lambda: nontwist.standard(2, 8, 9),
            "argument but 3 were given; it takes inertia, physical",
        ),
        (lambda: nontwist.stepper(BODY, dt=0.1), "'dt'; did you mean step=?"),
        (lambda: LOOP.step(body_moments=(1, 0, 0)), "'body_moments'; did you mean body_moment=?"),
        (lambda: LOOP.reset(W=(1, 0, 0)), "'W'; did you mean material_angular_velocity=?"),
        (lambda: LOOP.reset(t_start=1), "'t_start'; did you mean time=?"),
        (lambda: LOOP.reset(LOOP.state), "2 were given; it takes rotation, scalar_first, "),
        (lambda: nontwist.heavy_top([2, 2, 1], 1, (0, 0, 1), g=9.81), "'g'; did you mean gravity=?"),
        (lambda: nontwist.wheel("z", 0.1, rpm=100), "'rpm'; did you mean speed=?"),
        (lambda: nontwist.twist(None, rate=9), "'rate'; did you mean time=?"),
        (lambda: nontwist.view(None, speed=2), "'speed'; it takes run, other, title, labels"),
        (lambda: nontwist.steer(None, None, t_end=2), "'t_end'; it takes start, target, scalar_first"),
        (
            lambda: nontwist.read_motion("a", degrees=True),
            "read_motion() got an unexpected keyword ",
        ),
        (lambda: nontwist.inertia.of_cylinder(1, 1, height=1), "'height'; did you mean length=?"),
    ],
)
def test_wrong_arguments_are_explained(call, told):
    with pytest.raises(TypeError) as error:
        call()
    assert told in str(error.value)
    assert error.value.__suppress_context__


def test_inner_type_error():
    def fails(x):
        return x + ""

    with pytest.raises(TypeError, match=r"^unsupported operand"):
        hinted(fails)(1)
    assert pickle.loads(pickle.dumps(nontwist.standard)) is nontwist.standard
    with pytest.raises(ValueError, match=r"^gravity must be a vector in space, as \(0, 0, -9\.81\), got 9\.81$"):
        nontwist.heavy_top([2, 2, 1], 1, (0, 0, 1), gravity=9.81)


RUN = nontwist.simulate(BODY, t_end=1, step=0.1, material_angular_velocity=(1, 2, 3))


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: nontwist.simulate(BODY, t_end=True), "t_end must be a number, got True"),
        (lambda: nontwist.simulate(BODY, t_end=1, step=True), "step must be a number, got True"),
        (lambda: nontwist.join_runs([RUN, RUN]), "as a Dataset, got a list of them: give one by one"),
        (lambda: nontwist.view([RUN, RUN]), "view accepts one run or two, view(a, b), not a list"),
        (lambda: nontwist.resample(nontwist.read_motion(RUN.quaternion.to_pandas(), rate=10), [0.5]), "Slerp of SciPy"),
        (
            lambda: nontwist.simulate(BODY, t_end=1, events=lambda t, y: y[0]),
            "attributes angular_velocity, ",
        ),
        (lambda: nontwist.simulate(BODY, t_end=1, events=lambda t, y: y.W), "material_angular_velocity, quaternion"),
    ],
)
def test_other_forms_are_explained(call, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        call()


def test_trajectory_repr():
    run = nontwist.propagator(BODY, t_end=1, step=0.25, store=1)()
    assert repr(run) == f"<Trajectory: {BODY!r}, gauss, 0 to 1 s, 5 states: done>"
