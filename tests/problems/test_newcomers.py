"""A body, an integrator and a reader that are registered at run time, as the pages say, count everywhere."""

import json
import os
import pickle
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partialmethod
from importlib import import_module
from pathlib import Path
from typing import Annotated, ClassVar
from unittest.mock import patch

import distributed
import numpy as np
import pytest

from conftest import ended, problems_of
from nontwist import (
    DirectorSystem,
    compare,
    damping,
    heavy_top,
    open_run,
    plot,
    read_motion,
    save_run,
    simulate,
    simulate_ensemble,
    sine,
    standard,
    suslov,
    sweep,
    validate,
    with_gravity,
)
from nontwist.analysis import OBSERVABLES, Observable
from nontwist.errors import RunFileError
from nontwist.inertia import euler_inertia
from nontwist.integrators import INTEGRATORS
from nontwist.integrators.integrator import Integrator
from nontwist.integrators.stepping import march_by_steps
from nontwist.loads import LOADS, DirectorForces
from nontwist.models.bodies import BODIES, KEYS, BodyKind, many_euler, sample_bodies
from nontwist.recordings.formats import READERS
from nontwist.runfile import read_run_file
from nontwist.runfile.body import Body
from nontwist.runfile.document import json_schema
from nontwist.spec import Spec
from nontwist.validation import conserved
from nontwist.validation.problems import SAMPLES
from nontwist.viewer.content import content
from refusals import refused_as, said, says

ROOT = Path(__file__).parents[2]


def example(name):
    """What an example of one's own defines."""
    return runpy.run_path(str(ROOT / "examples" / f"own_{name}.py"))


with patch.dict(INTEGRATORS):
    MuntheKaas, one_step = map(example("integrator").get, ("MuntheKaas", "step"))
BRICK = standard([3, 4, 5])
RUN = """
body = { kind = "skate", inertia = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]] }
start = { angular_velocity = { body = [0, 1, 2] } }
time = { t_end = 1.0, step = 0.03125 }
integrator = { name = "munthe-kaas", order = 1 }
"""
SWEEP = """
[sweep]
variables = ["material_angular_velocity"]
[[sweep.over]]
key = "body.inertia.0.0"
kind = "list"
values = [2.5, 2.75, 3.0]
"""


def page(name):
    return (ROOT / "docs" / "contributing" / f"{name}.md").read_text(encoding="utf-8")


def blocks_of_the_page(name, language="python"):
    return re.findall(rf"^```{language}\n(.*?)^```", page(name), re.MULTILINE | re.DOTALL)


@pytest.fixture
def newcomers():
    """The kind of body of one page and the integrator of the other, which has the orders 1 and 4."""
    with patch.dict(BODIES), patch.dict(INTEGRATORS):
        exec(*blocks_of_the_page("body"), {})
        example("integrator")
        yield


@pytest.fixture
def written(write):
    return write(RUN)


YOUR_OWN = "; your own once its module is imported (nontwist --import MODULE)"
KINDS = ['"standard"', '"nontwisting"', '"suslov"', '"heavy_top"']


@pytest.mark.usefixtures("newcomers")
def test_run_file_and_schema(written):
    run = simulate(read_run_file(written).problem)
    how = {"t_end": 1, "step": 1 / 32, "material_angular_velocity": (0, 1, 2), "integrator": "munthe-kaas", "order": 1}
    assert np.array_equal(run.directors, simulate(BODIES["skate"].make(**BODIES["skate"].sample), **how).directors)
    assert abs(run.material_angular_velocity.values[:, 0]).max() < 1e-15
    assert problems_of(written, 'body.kind="skat"') == [
        f'body.kind: "skat" -> did you mean "skate"? {", ".join(KINDS)} or "skate"'
    ]
    assert problems_of(written, "body.axis=[1, 0, 0]", "integrator.order=2") == [
        'body.axis: [1.0, 0.0, 0.0] -> left out for kind = "skate"; "suslov" takes an axis',
        "integrator.order: 2 (munthe-kaas has the order 1, 4; got order = 2) -> one of 1, 4",
    ]
    tables = json_schema()["$defs"]
    assert tables["Body"]["properties"]["kind"]["enum"] == [*BODIES]
    assert tables["Integrator"]["properties"]["name"]["enum"] == [*INTEGRATORS]
    assert {"skate", "munthe-kaas"} <= {*BODIES, *INTEGRATORS}


@patch.dict(INTEGRATORS)
def test_unregistered_kinds(written):
    INTEGRATORS.pop(MuntheKaas.name, None)  # of a copy in the package
    known = ", ".join(f'"{name}"' for name in INTEGRATORS)
    assert problems_of(written) == [
        f'body.kind: "skate" -> {", ".join(KINDS[:3])} or {KINDS[3]}{YOUR_OWN}',
        f'integrator.name: "munthe-kaas" -> {known}{YOUR_OWN}',
    ]


@pytest.mark.usefixtures("newcomers")
@pytest.mark.parametrize("at_once", [None, many_euler])
def test_sweep_of_a_body(at_once, write, tmp_path):
    written = write(RUN + SWEEP)
    BODIES["skate"] = replace(BODIES["skate"], at_once=at_once)
    many = sweep(written, tmp_path / "store", workers=1)
    assert (many.status == 0).all()
    for i, J11 in enumerate((2.5, 2.75, 3.0)):
        run = simulate(read_run_file(written, [f"body.inertia.0.0={J11}"]).problem)
        assert many.material_angular_velocity[i].values == pytest.approx(run.material_angular_velocity[-1].values)


WHEEL = """
body = { kind = "wheel", mass = 2.0, radius = 0.3, width = 0.02, arm = 0.2 }
start.angular_velocity.body = [0, 1, 60]
time = { t_end = 0.5, step = 0.0625 }
[sweep]
variables = ["angular_velocity"]
[[sweep.over]]
key = "body.radius"
kind = "list"
values = [0.25, 0.35]
"""
WRONG_WHEELS = {
    "body.radios=0.3": "body.radios: unknown key -> did you mean radius? known are kind, inertia, axis, mass",
    "body.radius=-1": "body.radius: -1 -> a positive number, m: of the wheel, a cylinder about the third director",
    "body.radius=1e-30": "body.radius: 1e-30 (inertia",
    "body.inertia=[1, 1, 1]": 'body.inertia: [1, 1, 1] -> left out for kind = "wheel"',
    "body.centre_of_mass=[0, 0, 1]": 'body.centre_of_mass: [0.0, 0.0, 1.0] -> left out for kind = "wheel"; "heavy_top"',
    "body.axis='x'": 'body.axis: [1.0, 0.0, 0.0] -> left out for kind = "wheel"; "suslov" takes an axis',
}


def test_keys_of_a_body(write, tmp_path):
    """Parameters that no other kind has are keys of run files and sweeps, with their words and units."""
    with patch.dict(BODIES):
        example("body")
        written, make = write(WHEEL), BODIES["wheel"].make
        how = {"t_end": 0.5, "step": 0.0625, "material_angular_velocity": (0, 1, 60)}
        found = simulate(read_run_file(written).problem)
        assert np.array_equal(found.directors, simulate(make(2, 0.3, 0.02, 0.2), **how).directors)
        plain = RUN.replace("skate", "standard").replace('"munthe-kaas", order = 1', '"gauss"')
        assert (
            type(read_run_file(write(plain)).body) is Body
        )  # kinds without keys of their own have no table of their own
        written = write(WHEEL)
        fall = simulate(read_run_file(written, ["body.gravity=[0, 0, -1.62]"]).problem)
        assert np.array_equal(fall.directors, simulate(make(2, 0.3, 0.02, 0.2, (0, 0, -1.62)), **how).directors)
        for change, fault in WRONG_WHEELS.items():
            assert problems_of(written, change)[0].startswith(fault), problems_of(written, change)
        with pytest.raises(RunFileError, match=r"body\.arm: missing -> a number, m: from the fixed point"):
            read_run_file(write(WHEEL.replace(", arm = 0.2", "")))
        standard_body = WHEEL.replace('"wheel"', '"standard", inertia = [1, 1, 1]').partition("[sweep]")[0]
        with pytest.raises(RunFileError, match=r'body.radius: unknown key .* it belongs to kind = "wheel"'):
            read_run_file(write(standard_body))
        many = sweep(write(WHEEL), tmp_path / "store", workers=1)
        assert many["body.radius"].attrs["units"] == "m"
        for i, radius in enumerate((0.25, 0.35)):
            run = simulate(make(2, radius, 0.02, 0.2), **how)
            assert many.angular_velocity[i].values == pytest.approx(run.angular_velocity[-1].values)
        own = json_schema()["properties"]["body"]["anyOf"][1]
        assert own["properties"]["arm"]["description"] == "a number, m: from the fixed point to the centre of the wheel"
        assert {"radius", "width", "arm"} <= {*own["required"]}


@pytest.mark.usefixtures("newcomers")
def test_words_in_viewer_and_figure(written):
    told = content(simulate(read_run_file(written).problem))
    assert told["name"] == "skating body"
    assert told["about"]["Integrator"] == "munthe-kaas, order 1, step 0.03125 s"
    for name in ("gauss", "split", "continuous"):  # many more orders and tolerances
        del INTEGRATORS[name]
    data = compare(sample_bodies()["skate"], t_end=1, material_angular_velocity=(0, 1, 2), steps=[1 / 32], repeats=1)
    assert {"munthe-kaas 1", "munthe-kaas 4", "lie-midpoint 2"} <= set(data.integrator.values)
    assert (data.status == 0).all()
    lines = plot.work_precision(data).lines
    looks = {line.get_label(): (line.get_color(), line.get_linestyle(), line.get_marker()) for line in lines}
    assert looks["munthe-kaas 1"][2] == "$1$"
    assert len(set(looks.values())) == len(looks)


@pytest.mark.usefixtures("newcomers")
def test_validate_measures_them():
    for name in {*INTEGRATORS, *BODIES} - {"munthe-kaas", "energy-momentum", "exact", "standard", "skate"}:
        (INTEGRATORS if name in INTEGRATORS else BODIES).pop(name)
    newcomer = INTEGRATORS["munthe-kaas"]
    newcomer.counts = newcomer.counts | {1: (128, 192, 256), 4: (32, 48, 64)}  # in Python: as few as show the order
    result = validate("orders")
    assert [check for check in result.checks if not check.holds] == []
    for kind in BODIES.values():
        measured = {check.name.split(": ")[0] for check in result.checks if f": {kind.words}" in check.name}
        assert measured == {"munthe-kaas 1", "munthe-kaas 4", "energy-momentum 2"}


def gate(inertia, mass, centre_of_mass, gravity=(0, 0, -9.81)):
    """A body under gravity that may not turn about its second axis."""
    return replace(with_gravity(suslov(inertia, (0, 1, 0)), mass, centre_of_mass, gravity), name="gate")


def test_validate_under_gravity():
    """Of the kinds of the package, those with gravity have no axis; a check of mu had left its moment out."""
    sample = {"inertia": SAMPLES["suslov"].convected_inertia, "mass": 1.2, "centre_of_mass": [0.1, -0.2, 0.6]}
    with patch.dict(BODIES, gate=BodyKind(gate, "gate", sample)):
        assert validate("equations").holds


def light():
    return DirectorSystem(euler_inertia([3e-5, 4e-5, 5e-5]), name="light")


@pytest.mark.long
@patch.dict(BODIES)
def test_validate_without_inertia():
    """Bodies that take no inertia are checked as their samples are, under loads of their size."""
    example("body")
    BODIES["light"] = BodyKind(light, "light body", {})
    assert validate("orders").holds


@pytest.mark.long
def test_validate_in_other_processes(tmp_path, monkeypatch):
    (tmp_path / "own_skate.py").write_text(*blocks_of_the_page("body"), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with patch.dict(BODIES):
        import_module("own_skate")
        result = validate(["compiled", "geometry"], workers=2)
    del sys.modules["own_skate"]
    assert result.holds
    assert result.notes == ("the checks of all bodies in compiled include your own: 'skate'",)
    assert "lie-midpoint, skating body: states" in {check.name for check in result.checks}


def moon(inertia, mass, centre_of_mass, gravity=(0, 0, -1.62)):
    return replace(heavy_top(inertia, mass, centre_of_mass, gravity), name="moon")


MOON = BodyKind(moon, "top on the moon", {"inertia": [3, 4, 5], "mass": 1, "centre_of_mass": [0, 0, 0.1]})


@patch.dict(BODIES, moon=MOON)
def test_heavy_random_bodies(monkeypatch):
    """As many more, as random as the others, whose K + V is constant."""
    monkeypatch.setattr(conserved, "ALL", [("gauss", 4)])
    monkeypatch.setattr(conserved, "BODIES_OF_EACH_KIND", 5)
    checks = {check.name: check.holds for check in conserved.random_bodies()}
    assert all(checks.values())
    assert "gauss 4: energy, 25 bodies" in checks
    assert [name for name in checks if "20 bodies" in name] == []


@dataclass(frozen=True, eq=False)
class Brake(DirectorForces):
    """A force against the velocity of the tip of the third director."""

    brake: Annotated[float, Spec("", unit="N m s")]

    def forces(self, t, directors, angular_velocity):
        none = np.zeros(3)
        return np.array([none, none, -self.brake * np.cross(angular_velocity, directors[2])])


@patch.dict(LOADS, brake=Brake)
@pytest.mark.parametrize("scheme", ["gauss", "split", "continuous"])
def test_director_forces_are_damping(scheme):
    """-c d3 × (w × d3) = -c (I - d3 ⊗ d3) w: a matrix of damping, which other code computes."""
    how = {"t_end": 2, "step": 0.01, "material_angular_velocity": (1, -2, 3), "integrator": scheme}
    run = simulate(BRICK, load=Brake(0.3), **how)
    assert content(run)["about"]["Load"] == "brake: brake 0.3 N m s"
    known = simulate(BRICK, load=damping(np.diag([0.3, 0.3, 0.0])), **how)
    assert abs(run.directors - known.directors).max() < 1e-11


def rising(state):
    """The components of d3 in space."""
    return state.directors[..., 2, :]


@pytest.fixture
def nutation():
    """The observable of the page, and one with three components."""
    with patch.dict(OBSERVABLES, rising=Observable(rising, "1", "third director", "d3", ("axis",))):
        yield example("observable")["nutation"]


SPUN = """
body = { kind = "standard", inertia = [3, 4, 5] }
time = { t_end = 1.5, step = 0.05 }
sweep.variables = ["nutation", "rising"]
sweep.over = [{ key = "start.angular_velocity.body", kind = "list", values = [[1, 0, 0], [2, 0, 0]] }]
"""


def test_observable_everywhere(nutation, write, tmp_path):
    """Of a body that turns about its first director, which is principal: θ = W1 t."""
    how = {"t_end": 1.5, "step": 0.05, "events": lambda t, state: nutation(state) - 1}
    run = simulate(BRICK, material_angular_velocity=(2, 0, 0), **how)
    np.testing.assert_allclose(run.nutation, 2 * run.time, atol=1e-14)
    np.testing.assert_array_equal(run.rising, run.directors.sel(director=3, drop=True))
    assert run.t_events.values == pytest.approx([0.5], abs=1e-12)
    save_run(run, tmp_path / "run.nc")
    W = np.array([[1.0, 0, 0], [2.0, 0, 0]])
    many = simulate_ensemble(BRICK, t_end=1.5, step=0.05, store=1, material_angular_velocity=W, variables=["nutation"])
    np.testing.assert_array_equal(many.nutation[1], run.nutation)
    ends = sweep(write(SPUN), tmp_path / "many.zarr", workers=1)
    np.testing.assert_allclose(ends.nutation, [1.5, 3], atol=1e-14)
    assert ends.nutation.attrs["units"] == "rad"
    np.testing.assert_allclose(ends.rising.values[:, 2], np.cos([1.5, 3]), atol=1e-14)
    OBSERVABLES.clear()
    np.testing.assert_array_equal(open_run(tmp_path / "run.nc").nutation, run.nutation)


def observed(function):
    with patch.dict(OBSERVABLES, own=Observable(function, "1", "own", "o")):
        simulate(BRICK, t_end=1, step=0.5)


test_wrong_observable = refused_as(
    {
        "of the package": lambda: OBSERVABLES.update(kinetic_energy=Observable(rising, "J", "energy", "K")),
        "not a name": lambda: OBSERVABLES.update({"nutation angle": Observable(rising, "rad", "angle", "θ")}),
        "dims": lambda: Observable(rising, "rad", "Euler angles", "ψθφ", ("angle",)),
        "shape": lambda: observed(rising),
        "misspelt": lambda: observed(lambda state: state.kinetic_enery),
    },
    (ValueError, AttributeError),
)


def importing(registry, *words):
    """Run a command that imports a module of this folder, and forget what it registers."""
    with patch.dict(registry), patch.object(sys, "path", [*sys.path]):
        done = ended(0, *words)
    for name in ("body", "integrator", "load", "observable", "reader"):
        sys.modules.pop(f"own_{name}", None)
    return done


def test_commands_read_a_log(here):
    shutil.copy(ROOT / "examples" / "own_reader.py", here)
    python, command = map(shlex.split, re.findall(r"^(?:python|nontwist) .*$", page("recording"), re.MULTILINE))
    assert (*python[:2], command[0]) == ("python", "-c", "nontwist")
    with patch.dict(READERS), patch.object(sys, "path", ["", *sys.path]):
        exec(python[2], {})
        del sys.modules["own_reader"]
    assert "│ total twist                  │ 3.14159 rad (0.5 turns;" in importing(READERS, *command[1:]).stdout


@patch.dict(READERS)
def test_reader_names_the_place(write):
    example("reader")
    for text in (b"1|1|0|0|0\n2|x|0|0|1", b"\xff1|1|0|0|0", b"\xef\xbb\xbf"):
        path = write(text, "cut.spin")
        with says():
            read_motion(path)


def strange(inertia, radius):
    return standard(inertia)


def nameless(inertia):
    return DirectorSystem(euler_inertia(inertia))


@dataclass(frozen=True)
class Third(MuntheKaas):
    name: ClassVar[str] = "third"
    orders: ClassVar[tuple[int, ...]] = (3,)
    order: int = 3


def scheme(own, base=Integrator, **said):
    return dataclass(frozen=True)(type(own, (base,), said))


Two = scheme("Two", name="two", orders=(2, 4))


@pytest.mark.parametrize(
    ("key", "cls"),
    [
        ("two", Two),
        ("undecorated", type("Undecorated", (Integrator,), {"name": "undecorated", "orders": (3,)})),
        ("chose", scheme("Choosing", MuntheKaas, name="choosing")),
        ("gauss", scheme("Another", MuntheKaas, name="gauss")),
        ("seven", 7),
        ("nameless", scheme("Nameless", orders=(2,))),
    ],
)
def test_integrator_refused_at_registration(key, cls):
    for add, given in ((INTEGRATORS.__setitem__, (key, cls)), (INTEGRATORS.update, [[(key, cls)]])):
        with patch.dict(INTEGRATORS), says():
            add(*given)
        assert cls not in INTEGRATORS.values()
    assert pickle.loads(pickle.dumps(INTEGRATORS)) == INTEGRATORS
    with pytest.raises(ValueError, match=r"^Two has the orders 2, 4, but no field order: add order: int = 2 to it$"):
        Two()


def test_class_is_replaced():
    with patch.dict(INTEGRATORS):
        first, second = (example("integrator")["MuntheKaas"] for _ in range(2))
        assert first is not second is INTEGRATORS["munthe-kaas"]
        with pytest.raises(ValueError, match=r"^'munthe-kaas' is already the key of the class MuntheKaas"):
            INTEGRATORS["munthe-kaas"] = scheme("MuntheKaas", MuntheKaas, name="munthe-kaas", orders=(2,))


HEUN = ((0, 1 / 3, 2 / 3), (1 / 4, 0, 3 / 4))  # nodes and weights of Heun's scheme of order 3


@dataclass(frozen=True)
class Heun(Integrator):
    """An integrator of one order, whose class has no field for it; the scheme that the example has two others of."""

    name = "heun"
    orders = (3,)
    counts = Integrator.counts | {3: (40, 80, 160)}

    def march_one(self, problem):
        constraints = 0 if problem.system.axis is None else 1
        return march_by_steps(problem, constraints, lambda k, q, v: one_step(problem, *HEUN, k, q, v), float)


@patch.dict(INTEGRATORS, heun=Heun)
def test_integrator_of_one_order(here, write):
    how = {"t_end": 1, "material_angular_velocity": (0, 1, 2), "load": sine((1, 2, 0), 0.7)}
    assert Heun() == Heun(order=3) == Heun.variants()[0]
    for choice in ({"integrator": "heun"}, {"integrator": "heun", "order": 3}, {"integrator": Heun()}):
        run = simulate(BRICK, step=1 / 16, **choice, **how)
        assert json.loads(run.attrs["integrator"]) == {"name": "heun", "order": 3}
    with pytest.raises(ValueError, match=r"^heun has the order 3; got order = 2$"):
        simulate(BRICK, integrator="heun", order=2, **how)
    run, truth = (simulate(BRICK, tolerance=x, integrator=one, **how) for one, x in (("heun", 1e-4), ("gauss", 1e-10)))
    assert abs(run.directors[-1] - truth.directors[-1]).max() < 1e-4
    coarse = r"by 85\.9 degrees in it \(heun, order 3\); try step <= 0\.03, the integrator gauss, or tolerance = 1e-6$"
    with pytest.warns(UserWarning, match=coarse):
        simulate(BRICK, t_end=1, step=0.1, material_angular_velocity=(15, 0, 0), integrator="heun")
    data = compare(BRICK, steps=[1 / 16, 1 / 32], repeats=1, integrators=["heun", "gauss"], **how)
    assert data.order.values.tolist() == [3, 8]
    assert data.attitude_order.sel(integrator="heun 3").values[1] == pytest.approx(3, abs=0.1)
    text = RUN.replace('"munthe-kaas", order = 1', '"heun"').replace("skate", "standard")
    written = write(text)
    ordered, plain = (simulate(read_run_file(written, more).problem) for more in (["integrator.order=3"], []))
    assert ordered.equals(plain)
    assert problems_of(written, "integrator.order=2") == [
        "integrator.order: 2 (heun has the order 3; got order = 2) -> 3"
    ]
    assert problems_of(written, "integrator.options.order=3") == [
        "integrator.options.order: unknown key -> left out: this table has no keys"
    ]
    found = json.loads(ended(0, "precision", "run.toml", "--json").stdout)
    assert found["observed_order"] == pytest.approx(3, abs=0.05)
    assert (sweep(write(text + SWEEP), here / "store", workers=1).status == 0).all()


@pytest.mark.long
def test_strict_types_of_pages(tmp_path):
    """All blocks in Python, and a line in a class; `make lint` looks at the examples."""
    names = [path.stem for path in (ROOT / "docs" / "contributing").glob("*.md")]
    files = {f"{name}_{k}.py": code for name in names for k, code in enumerate(blocks_of_the_page(name))}
    (line,) = re.findall(r"`(counts = [^`]+)`", page("integrator"))
    header = "from nontwist.integrators.integrator import Integrator\n\n\n"
    files["counts.py"] = f'{header}class Third(Integrator):\n    name = "third"\n    orders = (3,)\n    {line}\n'
    assert "body_0.py" in files
    for name, code in files.items():
        (tmp_path / name).write_text(code, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--follow-imports=silent", *files]
    environment = {**os.environ, "MYPYPATH": str(ROOT / "src")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stdout


test_incomplete_entry = refused_as(
    {
        "key": lambda: BodyKind(strange, "disc", {}),
        "sample": lambda: BodyKind(standard, "disc"),
        "name": patch.dict(BODIES, disc=BodyKind(nameless, "disc", {"inertia": [3, 4, 5]}))(sample_bodies),
    },
    (ValueError, TypeError),
)


def test_integrator_without_step_counts():
    with patch.dict(INTEGRATORS, {"third": Third}, clear=True):
        failed = [check.name for check in validate("orders").checks if "ValueError" in check.name]
    assert failed
    said(failed[0])


def test_body_keys():
    assert {"kind", *KEYS} == set(Body.model_fields)


MAGNET = """load = [{ kind = "magnet", dipole = [0.3, 0, 1.2], field = [2e-5, 0, -4e-5] }]
body = { kind = "standard", inertia = [2e-5, 3e-5, 4e-5] }
time.t_end = 1
"""


def test_commands_import_modules(here, write):
    """Before or after the command, whose hints then have the option."""
    shutil.copy(ROOT / "examples" / "own_load.py", "own_load.py")
    write(MAGNET)
    alone = ended(3, "check", "run.toml")
    assert next(line for line in alone.stderr.splitlines() if "load.0.kind" in line).endswith(
        f'"gravity_gradient"{YOUR_OWN}'
    )
    for words in (["--import", "own_load", "check", "run.toml"], ["check", "run.toml", "--import=own_load"]):
        assert importing(LOADS, *words).stderr.splitlines()[-1] == "next: nontwist run run.toml --import own_load"
    (table,) = blocks_of_the_page("load", "toml")
    write(table, "magnet.toml")
    for name in ("run", "magnet"):
        importing(LOADS, "run", f"{name}.toml", "--import", "own_load", "--quiet")
        assert open_run(f"{name}.nc").attrs["status"] == 0


OF_THE_PACKAGE = {"body": 'body.kind="standard"', "integrator": 'integrator={ name = "gauss" }'}


@pytest.mark.parametrize(
    ("name", "registry"), [("body", BODIES), ("integrator", INTEGRATORS), ("observable", OBSERVABLES)]
)
def test_commands_import_others(name, registry, here, write):
    """Each is one file in a folder of its own; loads and readers are above."""
    example = (ROOT / "examples" / f"own_{name}.py").read_text(encoding="utf-8")
    Path(f"own_{name}.py").write_text(blocks_of_the_page(name)[0] if name == "body" else example, encoding="utf-8")
    write(RUN)
    sets = [word for kind, one in OF_THE_PACKAGE.items() if kind != name for word in ("--set", one)]
    importing(registry, "run", "run.toml", "--import", f"own_{name}", "--quiet", *sets)
    run = open_run("run.nc")
    assert (DirectorSystem.from_json(run.attrs["system"]).name == "skate") == (name == "body")
    assert (json.loads(run.attrs["integrator"])["name"] == "munthe-kaas") == (name == "integrator")
    assert ("nutation" in run) == (name == "observable")


@pytest.mark.parametrize("has_processes", [False, pytest.param(True, marks=pytest.mark.long)])
def test_dask_workers_import_modules(has_processes, here, write, monkeypatch):
    """Threads or processes, which do not begin in this folder."""
    own = distributed.LocalCluster.__init__
    monkeypatch.setattr(distributed.LocalCluster, "__init__", partialmethod(own, processes=has_processes))
    monkeypatch.syspath_prepend(here)
    shutil.copy(ROOT / "examples" / "own_load.py", "own_load.py")
    over = 'time.step = 0.1\n[[sweep.over]]\nkey = "load.0.scale"\nkind = "list"\nvalues = [1, 2]\n'
    write(MAGNET + over, "sweep.toml")
    words = ["sweep", "sweep.toml", "--import", "own_load", "--dask", "local", "--workers", "1"]
    assert "2, 0 failed" in importing(LOADS, *words).stdout


def test_missing_module_is_named(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "broken.py").write_text("raise ValueError('at its end')\n", encoding="utf-8")
    for name, message in (
        ("elsewhere", "elsewhere cannot be imported: ModuleNotFoundError: No module named 'elsewhere'"),
        ("broken", "broken cannot be imported: ValueError: at its end"),
        ("own_load.py", "'own_load.py' is not the name of a module, as own_load"),
        ("", "'' is not the name of a module, as own_load"),
    ):
        refused = ended(2, f"--import={name}", "check", "run.toml")
        assert refused.stderr.splitlines()[-1] == f"Error: Invalid value for --import: {message}"
    assert "--import" in ended(2, "check", "run.toml", "--import").stderr.splitlines()[-1]


@patch.dict(BODIES, moon=MOON)
def test_default_of_a_body(write):
    body = 'kind = "moon"\ninertia = [2, 2, 1]\nmass = 3\ncentre_of_mass = [0, 0, 0.5]\n'
    path = write(f"[body]\n{body}[time]\nt_end = 1\n")
    for overrides, gravity in (([], 1.62), (["body.gravity=[0, 0, -3.7]"], 3.7)):
        system = read_run_file(path, overrides).problem.system
        assert system.dead_force[2] == pytest.approx([0, 0, -gravity * 3 * 0.5], rel=1e-15)
