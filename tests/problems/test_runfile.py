"""Run files: what they say is what runs, and what is wrong with them is told, all at once."""

import json
import pickle
import re
import warnings
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import ended, problems_of
from nontwist import heavy_top, inertia, pulse, simulate, space_moment, suslov
from nontwist import nontwisting as nontwisting_body
from nontwist.analysis.invariants import drifts
from nontwist.cli.run_commands import example_names
from nontwist.errors import RunFileError, SimulationError
from nontwist.integrators import INTEGRATORS
from nontwist.models.bodies import BODIES as KINDS_OF_BODIES
from nontwist.paper.tables import invariants_table
from nontwist.runfile import read_run_file
from nontwist.runfile.basic_tables import Start
from nontwist.runfile.body import MAKERS, Body
from nontwist.runfile.document import Integrator, Output, Time, checked, forecast
from nontwist.runfile.files import Folder, document, toml_text
from nontwist.runfile.load_tables import TABLES
from refusals import said, says

PLACE = Path(__file__).parents[2]
EXAMPLES = PLACE / "src" / "nontwist" / "runfile" / "examples"
BODY = '[body]\nkind = "standard"\ninertia = [1, 2, 2.5]\n'
TIME = "[time]\nt_end = 1\nstep = 0.1\n"
HELD = BODY.replace("standard", "nontwisting")


def read(write, text, *overrides):
    return read_run_file(write(text), overrides)


def lines(write, text, *overrides):
    return problems_of(write(text), *overrides)


ONE_LINE = {
    "JSON": '{"body": {}}',
    "comma": "[body]\nmass = 0,5\n",
    "commas": "[body]\ncentre_of_mass = [0,0 0,0 0,6]\n",
    "semicolons": "[body]\ngravity = [0.0; 0.0; -9.81]\n",
    "typographic quotes": "[body]\nkind = “heavy_top”\n",
    "no brackets": "start\n",
    "YAML": "body:\n  kind: standard\n",
    "bare word": "[body]\nkind = standard\n",
    "bare words": "title = My top\n",
    "unit": "[body]\nmass = 0.5 kg\n",
    "key twice": '[body]\nkind = "standard"\nkind = "suslov"\n',
    "table twice": f"{BODY}{TIME}[body]\n",
    "single brackets at first": f"{BODY}{TIME}[load]\nkind = 'damping'\n[[load]]\nkind = 'damping'\n",
    "single brackets twice": f"{BODY}{TIME}[sweep.over]\nkey = 'body.mass'\n[ sweep.over ]  # more\n",
    "expression": "a = 1/7\n",
    "UTF-16": "[body]".encode("utf-16"),
    "Latin-1": b'title = "ok"\n# caf\xe9\n',
    "nested": "a = " + "[" * 10**5,
    "digits": "a = " + "9" * 5000,
    "spaced dots": '"a" .\t' * 10**5 + "a = 1",
    "10^400": BODY + TIME.replace("end = 1", "end = 1" + "0" * 400),
    "nan": f"{BODY}{TIME}[start]\nangular_velocity = {{ body = [0, nan, 0] }}",
    "tiny": f"{BODY}mass = 1e-100\n{TIME}",
    "boolean": f"{BODY}mass = true\n{TIME}",
    "empty": "",
    "load table": f"{BODY}{TIME}[load]\nkind = 'sine'\n",
    "list of bodies": "[[body]]\nx = 1\n" + TIME,
    "unknown section": f"{BODY}{TIME}[intergrator]\n",
    "a key without its table": f"mass = 1\n{BODY}{TIME}",
    "a name of other programs": f"{BODY}{TIME}dt = 0.1\n",
    "a name of other programs without its table": f"omega = [0, 0, 1]\n{BODY}{TIME}",
    "a word for a list": f'{BODY}{TIME}[output]\nfigures = "path"\n',
    "escape": f'"\\u001b[2J" = 1\n{BODY}{TIME}',
    "unknown key": BODY + TIME.replace("t_end", "t_start = 0\nt_edn"),
    "key of another kind": f"{BODY}{TIME}[[load]]\nkind = 'table'\nframe = 'body'\ntimes = [0, 1]\n"
    "values = [[0, 0, 1], [0, 0, 1]]\nfile = 'moment.csv'\n",
    "nearest word": BODY.replace("standard", "Standard") + TIME,
    "triangle": BODY.replace("2.5", "5") + TIME,
    "no axis": BODY.replace("standard", "suslov") + TIME,
    "axis by an unknown letter": BODY.replace("standard", "suslov") + 'axis = "w"\n' + TIME,
    "option beside the integrator": BODY + TIME + '[integrator]\nname = "lie-midpoint"\ndissipation = 0.5\n',
    "axis": f"{HELD}axis = [1, 0, 0]\n{TIME}",
    "no centre": f"{BODY}mass = 1\n{TIME}",
    "two shapes": f'[body]\nkind = "standard"\n[body.inertia]\ncuboid = {{ mass = 1, lengths = [1, 1, 1] }}\n'
    f"ellipsoid = {{ mass = 1, semi_axes = [1, 1, 1] }}\n{TIME}",
    "mass of a shape": f'[body]\nkind = "standard"\nmass = 1\n'
    f"inertia = {{ cuboid = {{ mass = 1, lengths = [1, 1, 1] }} }}\n{TIME}",
    "two forms": f"{BODY}{TIME}[start]\nrotation = {{ matrix = 1, vector = 2 }}",
    "quaternion": f'{BODY}{TIME}[start]\nrotation = {{ quaternion = [1, 1, 0, 0], order = "wxyz" }}',
    "no order": f"{BODY}{TIME}[start]\nrotation = {{ quaternion = [1, 0, 0, 0] }}",
    "Euler axis twice": f'{BODY}{TIME}[start]\nrotation = {{ euler = [1, 2, 3], sequence = "ZZX", unit = "deg" }}',
    "spin": f"{HELD}{TIME}[start]\nangular_velocity = {{ body = [1, 2, 0.5] }}",
    "load kind": f'{BODY}{TIME}[[load]]\nkind = "impulse"\n',
    "pulse": f'{BODY}{TIME}[[load]]\nkind = "pulse"\nframe = "body"\namplitude = [1, 0, 0]\nstart = 2\nend = 1\n',
    "no file": f'{BODY}{TIME}[[load]]\nkind = "csv"\nframe = "body"\nfile = "load.csv"\n',
    "t_end": BODY + TIME.replace("end = 1", "end = -1"),
    "step": BODY + TIME.replace("0.1", "0.3"),
    "10^12 steps": BODY + TIME.replace("0.1", "1e-12"),
    "automatic step": f"{BODY}[time]\nt_end = 1e9\n[start]\nangular_velocity = {{ body = [1, 0, 0] }}",
    "store": f"{BODY}{TIME}store = 0\n",
    "order": f"{BODY}{TIME}[integrator]\norder = 5\n",
    "no order of exact": f'{BODY}{TIME}[integrator]\nname = "exact"\norder = 2\n',
    "option": f'{BODY}{TIME}[integrator]\nname = "continuous"\noptions = {{ rtoll = 1e-9 }}\n',
    "value of an option": f'{BODY}{TIME}[integrator]\nname = "continuous"\noptions = {{ method = "RK4" }}\n',
    "path": f'{BODY}{TIME}[output]\npath = "run.csv"\n',
    "unit in capitals": f'{BODY}{TIME}[start]\nangular_velocity = {{ body = [1, 0, 0], unit = "RPM" }}',
    "gravity by its letter": f"{BODY}g = [0, 0, -9.81]\n{TIME}",
    "times beside a step": f'{BODY}{TIME}times = [0, 1]\n[integrator]\nname = "exact"\n',
    "an axis of length zero": f"{BODY}{TIME}[[load]]\nkind = 'rotor'\naxis = [0, 0, 0]\nmomentum = 1\n",
}


@pytest.mark.parametrize("case", ONE_LINE)
def test_error_in_a_line(case, write):
    said(lines(write, ONE_LINE[case])[0])


def test_too_many_stored_steps(write):
    (line,) = lines(write, BODY + TIME.replace("0.1", "1e-9"))
    assert re.match(
        r"time\.store: 1 \(1e\+09 stored states need 800 GB, .* GB are free; store=\d+ fits, or store='end'\)", line
    )
    assert read(write, BODY + TIME.replace("0.1", '1e-9\nstore = "end"')).time.store == "end"


def test_too_many_skipped_states(write):
    assert simulate(read(write, f"{BODY}{TIME}store = {10**20}\n").problem).sizes["time"] == 2


def test_byte_order_mark(write):
    text = (BODY + TIME).replace("\n", "\r\n")
    assert read(write, b"\xef\xbb\xbf" + text.encode()) == read(write, BODY + TIME)
    assert lines(write, ONE_LINE["Latin-1"])[0].startswith("line 2: ")


WRONG_ALL_OVER = """
titel = "x"
body = { kind = "suslov", inertia = [1, 2, 5], axes = [0, 0, 1] }
load = [{ kind = "damping", coefficient = -1 }, { kind = "sine", frame = "bdy" }]
time = { t_end = 1, step = 0.3, store = "last" }
integrator = { order = 3 }
output = { figures = ["paths"] }
[start]
rotation = { euler = [1, 2], sequence = "xyz", unit = "degrees" }
angular_velocity = { body = [1, nan, 0] }
"""


def test_all_errors_at_once(write):
    keys = "body.axes start.angular_velocity.body.1 load.1.frame load.1.amplitude load.1.frequency time.store "
    keys += "output.figures.0 titel body.axis start.rotation.euler load.0.coefficient integrator.order time.step"
    assert [line.split(": ")[0] for line in lines(write, WRONG_ALL_OVER)] == keys.split()


def test_no_error_is_reported_twice(write):
    text = BODY.replace("standard", "heavy_top") + "mass = -1\ncentre_of_mass = [0, 0, 0.1]\n" + TIME
    assert lines(write, text) == ["body.mass: -1 -> a positive number, kg"]


def test_an_error_travels_between_processes(write):
    with pytest.raises(RunFileError) as caught:
        read(write, BODY)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.problems) == (str(caught.value), caught.value.problems)
    assert again.problems[0].key == "time"
    assert caught.value.__cause__ is caught.value.__context__ is None  # Dask sends them; Pydantic 2.13 refuses its own


R = Rotation.from_euler("ZYX", [30, -40, 50], degrees=True)
FORMS = {
    "matrix": f"{{ matrix = {R.as_matrix().tolist()} }}",
    "wxyz": f'{{ quaternion = {R.as_quat()[[3, 0, 1, 2]].tolist()}, order = "wxyz" }}',
    "xyzw": f'{{ quaternion = {(-R.as_quat()).tolist()}, order = "xyzw" }}',
    "vector": f'{{ vector = {R.as_rotvec().tolist()}, unit = "radians" }}',
    "vector in degrees": f'{{ vector = {R.as_rotvec(degrees=True).tolist()}, unit = "degrees" }}',
    "turning axes": '{ euler = [30, -40, 50], sequence = "ZYX", unit = "degrees" }',
    "fixed axes": f'{{ euler = {np.radians([50, -40, 30]).tolist()}, sequence = "xyz", unit = "radians" }}',
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_the_start(form, write):
    run_file = read(write, f"{BODY}{TIME}[start]\nrotation = {FORMS[form]}\n")
    assert run_file.problem.rotation.as_matrix() == pytest.approx(R.as_matrix(), abs=1e-15)


def test_angular_velocity_frames(write):
    W = np.array([0.3, -0.2, 0.7])
    start = f"{BODY}{TIME}[start]\nrotation = {FORMS['matrix']}\n"
    body = simulate(read(write, f"{start}angular_velocity = {{ body = {W.tolist()} }}").problem)
    space = simulate(read(write, f"{start}angular_velocity = {{ space = {R.apply(W).tolist()} }}").problem)
    assert body.material_angular_velocity[0].values == pytest.approx(W, abs=1e-15)
    assert space.directors.values == pytest.approx(body.directors.values, abs=1e-14)


@pytest.mark.parametrize("name", example_names())
def test_examples_keep_invariants(name):
    """And the paper's cases have every printed digit."""
    run_file = read_run_file(EXAMPLES / f"{name}.toml")
    if run_file.time.t_end > 5:
        run_file = read_run_file(EXAMPLES / f"{name}.toml", ["time.t_end=5"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "the step is coarse")  # as in the paper's cases
        run = simulate(run_file.problem)
    assert len(drifts(run)) >= 2
    assert max(drift.relative for drift in drifts(run).values()) < 1e-13
    assert run.title == run_file.title
    if name.startswith("case"):
        table = invariants_table(int(name.removeprefix("case")), run)
        assert len(table.rows) == 15
        assert table.agrees


def test_example_of_every_body():
    kinds = {read_run_file(EXAMPLES / f"{name}.toml").body.kind for name in example_names()}
    assert kinds == set(KINDS_OF_BODIES)


J, OFFSET = [[1.2, 0.1, 0.0], [0.1, 1.5, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.1, 0.3]
BODIES = {
    "nontwisting under gravity": (
        f'kind = "nontwisting"\ninertia = {J}\nmass = 0.5\ncentre_of_mass = {OFFSET}\n',
        lambda: nt.with_gravity(nontwisting_body(J), 0.5, OFFSET),
    ),
    "heavy box": (
        f'kind = "heavy_top"\ninertia = {{ cuboid = {{ mass = 2, lengths = [1, 2, 3] }}, offset = {OFFSET} }}\n',
        lambda: heavy_top(inertia.shift(inertia.of_cuboid(2, [1, 2, 3]), 2, OFFSET), 2, OFFSET),
    ),
    "weightless box": (
        'kind = "suslov"\naxis = [1, 0, 0]\n'
        f"inertia = {{ cuboid = {{ mass = 2, lengths = [1, 2, 3] }}, offset = {OFFSET} }}\n",
        lambda: suslov(inertia.shift(inertia.of_cuboid(2, [1, 2, 3]), 2, OFFSET), [1, 0, 0]),
    ),
    "tube": (
        'kind = "suslov"\naxis = [1, 0, 0]\n'
        "inertia = { cylinder = { mass = 2, radius = 0.5, inner_radius = 0.1, length = 1, axis = [1, 1, 0] } }\n",
        lambda: suslov(inertia.of_cylinder(2, 0.5, 1, inner_radius=0.1, axis=(1, 1, 0)), [1, 0, 0]),
    ),
    "egg": (
        'kind = "suslov"\naxis = "-x"\ninertia = { ellipsoid = { mass = 2, semi_axes = [1, 2, 3] } }\n',
        lambda: suslov(inertia.of_ellipsoid(2, [1, 2, 3]), [-1, 0, 0]),
    ),
    "points": (
        'kind = "heavy_top"\n'
        f"inertia = {{ points = {{ masses = [1, 3], positions = [[1, 0, 0], [0, 1, 0]] }}, offset = {OFFSET} }}\n",
        lambda: heavy_top(
            inertia.of_points([1, 3], np.add([[1, 0, 0], [0, 1, 0]], OFFSET)), 4, np.add([0.25, 0.75, 0], OFFSET)
        ),
    ),
}


@pytest.mark.parametrize("case", BODIES)
def test_bodies(case, write):
    text, expected = BODIES[case]
    found, wanted = read(write, f"[body]\n{text}{TIME}").problem.system, expected()
    for name in ("euler_inertia", "dead_force", "axis"):
        one, other = getattr(found, name), getattr(wanted, name)
        assert one is other is None or one == pytest.approx(other, abs=1e-14)


def test_mesh_beside_the_file(write, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((1000, 2000, 3000)).apply_translation((500, 0, 0)).export(tmp_path / "box.stl")
    mesh = 'mesh = { file = "box.stl", mass = 6, scale = 0.001, about = "origin" }'
    found = read(write, f'[body]\nkind = "heavy_top"\ninertia = {{ {mesh} }}\n{TIME}').problem.system
    _, centre, _ = inertia.of_mesh(tmp_path / "box.stl", mass=6, scale=0.001)
    assert centre == pytest.approx([0.5, 0, 0])
    assert found.convected_inertia == pytest.approx(inertia.shift(inertia.of_cuboid(6, [1, 2, 3]), 6, centre))
    assert found.dead_force == pytest.approx(6 * np.outer(centre, [0, 0, -9.81]))
    gone = f'[body]\nkind = "heavy_top"\ninertia = {{ {mesh.replace("box", "bx")} }}\n{TIME}'
    assert "body.inertia: a table with mesh (no such file: " in lines(write, gone)[0]


F = 'frame = "space"\n'
LOADS = {
    "constant": (f'kind = "constant"\n{F}moment = [1, 2, 3]', space_moment([0, 2], [[1, 2, 3], [1, 2, 3]])),
    "constant for a while": (
        f'kind = "constant"\n{F}moment = [1, 2, 3]\nstart = 0.25\nend = 0.5',
        pulse([1, 2, 3], 0.25, 0.5, shape="rectangle", frame="space"),
    ),
    "constant until an end": (
        f'kind = "constant"\n{F}moment = [1, 2, 3]\nend = 0.5',
        pulse([1, 2, 3], -1, 0.5, shape="rectangle", frame="space"),
    ),
    "constant from a start on": (
        f'kind = "constant"\n{F}moment = [1, 2, 3]\nstart = 0.25',
        pulse([1, 2, 3], 0.25, 2, shape="rectangle", frame="space"),
    ),
    "damping, sine": (
        'kind = "damping"\ncoefficient = [1, 2, 3]\n[[load]]\nkind = "sine"\nframe = "body"\n'
        "amplitude = [1, 2, 3]\nfrequency = 2\nphase = 0.3\nscale = -1",
        nt.damping([1, 2, 3]) - nt.sine([1, 2, 3], 2, phase=0.3),
    ),
    "half-sine": (
        f'kind = "pulse"\n{F}amplitude = [1, 2, 3]\nstart = 0.1\nend = 0.7\nshape = "half-sine"',
        pulse([1, 2, 3], 0.1, 0.7, shape="half-sine", frame="space"),
    ),
    "csv, decimal commas": (
        f'kind = "csv"\n{F}file = "commas.csv"',
        space_moment([0, 0.5, 2], [[0, 0, 0], [1, 2.5, 3], [0, 1, 0]]),
    ),
    "csv": (f'kind = "csv"\n{F}file = "täglich 1.csv"', space_moment([0, 0.5, 2], [[0, 0, 0], [1, 2, 3], [0, 1, 0]])),
    "csv columns": (
        'kind = "csv"\nframe = "body"\nfile = "wide.csv"\ncolumns = ["t", "M3", "M2", "M1"]\nscale = 0.001',
        0.001 * nt.body_moment([0, 2], [[3, 2, 1], [6, 5, 4]]),
    ),
}


@pytest.mark.parametrize("case", LOADS)
def test_loads(case, write, tmp_path):
    write("\ufeffTime (s); mx ;my;mz\n0;0;0;0\n0.5;1;2;3\n2;0;1;0\n", "täglich 1.csv")
    write("Zeit (s);mx;my;mz\n0;0;0;0\n0,5;1;2,5;3,0e0\n2;0;1;0\n", "commas.csv")
    write("t,quality,M1,M2,M3\n0,good,1,2,3\n2,bad,4,5,6\n", "wide.csv")
    text, expected = LOADS[case]
    file = read(write, f"{BODY}{TIME}[[load]]\n{text}\n")
    found = file.problem.load
    if case == "csv":
        assert forecast(file).loads == ("csv (täglich 1.csv: 3 rows, 0 s to 2 s, up to 3 N m along an axis)",)
    t = np.array([0.05, 0.1, 0.25, 0.3, 0.49, 0.6, 0.95])
    for frame in ("body", "space"):
        assert found.sample(t, frame) == pytest.approx(expected.sample(t, frame), abs=1e-15)
    assert np.array_equal(found.damping, expected.damping)


WRONG_CSV = {
    "headers": "0,1,2,3\n1,1,2,3\n",
    "empty": "",
    "columns": "t,a,b\n0,1,2\n",
    "a word": "t,a,b,c\n0,1,2,3\n1,1,x,3\n",
    "an empty cell": "t,a,b,c\n0,1,2,3\n1,1,,3\n",
    "a decimal comma": "t;a;b;c\n0;1;2.5;3\n1;1;0,5;3\n",
    "infinite": "t,a,b,c\n0,1,2,3\n1,1,1e999,3\n",
    "milliseconds": "t [ms],a,b,c\n0,1,2,3\n1,1,1,3\n",
    "millimetres": "t [s],a [N m],b (N mm),c\n0,1,2,3\n1,1,1,3\n",
    "a long row": "t,a,b,c\n0,1,2,3\n1,2,3,4,5,6\n",
    "no rows": "t,a,b,c\n",
    "times": "t,a,b,c\n0,1,2,3\n0,1,2,3\n",
}


@pytest.mark.parametrize("case", WRONG_CSV)
def test_csv_errors(case, write):
    write(WRONG_CSV[case], "load.csv")
    (line,) = lines(write, f'{BODY}{TIME}[[load]]\nkind = "csv"\nframe = "body"\nfile = "load.csv"\n')
    said(line)


def test_csv_file_of_a_rotor(write):
    write("t,h\n0,1\n0,2\n", "load.csv")
    (line,) = lines(write, f'{BODY}{TIME}[[load]]\nkind = "rotor"\naxis = "z"\nfile = "load.csv"\n')
    assert line.startswith('load.0.file: "load.csv" (times must increase')


def test_overrides(write):
    text = f'{BODY}{TIME}[[load]]\nkind = "damping"\ncoefficient = 1\n'
    changes = 'body.kind="suslov"', "body.axis=[0, 0, 1]", "load.0.coefficient = 2", "integrator.order=6"
    run_file = read(write, text, *changes)
    assert (run_file.body.kind, run_file.integrator.order, run_file.load[0].coefficient) == ("suslov", 6, 2)
    assert lines(write, text, "body.mas=2")[0].startswith("body.mas: unknown key -> did you mean mass?")
    assert lines(write, text, "step=0.1")[0].startswith("step: unknown key -> did you mean time.step?")
    assert 'did you mean "wheel"?' in lines(write, text, 'load.0={kind="reaction_wheel"}')[0]
    assert lines(write, text, 'load.0={kind="wheel", axis=[0, 0, 0], inertia=1}')[0].endswith('"-y", "-z"')
    assert lines(write, text, "load.0.frequency=2")[0].endswith('; it belongs to kind = "sine"')
    turned = "start.rotation={matrix=[[1, 0, 0], [0, 1, 0], [0, 0, 1]], unit='deg'}"
    assert lines(write, text, turned)[0].endswith("; it belongs to { vector = ... } or { euler = ... }")
    shape = "body.inertia={cuboid={mass=1, lengths=[1, 2, 3], offset=[0, 0, 1]}}"
    (told,) = lines(write, text, shape)
    assert told.endswith("cuboid.offset: unknown key -> did you mean body.inertia.offset? known are mass, lengths")
    assert lines(write, text, "load.1.x=2") == ["set load.1.x=2: load has no entry 1 -> 0 to 0"]
    assert lines(write, text, "body.kind.x=2") == [
        'set body.kind.x=2: body.kind is "standard", not a table -> a key of the file'
    ]


INVALID = ["body.mass", "body.kind=suslov", "body.mass=1/7", "body.mass=0,6", "body.mass=2\nbody.kind=1"]


@pytest.mark.parametrize("override", INVALID)
def test_invalid_overrides(override, write):
    with says():
        read(write, BODY + TIME, override)


def test_script_is_refused(write):
    with says(RunFileError):
        read_run_file(write("x = 1\n", "body.py"))


@pytest.mark.parametrize("name", ["case2", "heavy_top"])
def test_result_can_be_made_again(name, write):
    run = simulate(read_run_file(EXAMPLES / f"{name}.toml", ["time.t_end=0.5", "time.step=0.005"]).problem)
    again = simulate(read(write, run.attrs["run_file"]).problem)
    assert np.array_equal(again.directors, run.directors)
    for key in ("run_file", "run_file_sha256"):
        assert again.attrs[key] == run.attrs[key]
    assert "t_start = 0.0" in run.attrs["run_file"]
    assert "{  }" not in run.attrs["run_file"]  # options of the integrator: there are none


def test_changed_csv_file(write):
    write("t,a,b,c\n0,1,2,3\n1,0,0,0\n", "load.csv")
    first = read(write, f'{BODY}{TIME}[[load]]\nkind = "csv"\nframe = "body"\nfile = "load.csv"\n')
    assert forecast(first).loads == ("csv (load.csv: 2 rows, 0 s to 1 s, up to 3 N m along an axis)",)
    text = first.text()
    assert read(write, text).text() == text
    write("t,a,b,c\n0,1,2,3.1\n1,0,0,0\n", "load.csv")
    assert lines(write, text)[0].startswith('load.0.file: "load.csv" (it has changed: its SHA-256 is ')


@pytest.mark.parametrize(
    "value", ['a"b\\c\n\t\x7f\u2028é', 1e-50, -0.0, 10**20, True, [], [[1.0], ["x"]], {"a b": 1, "c": {}}]
)
def test_toml_round_trip(value):
    text = toml_text({"key": value, "table": {"x": value}, "many": [{"x": value}, {}]})
    assert document("", text.encode()) == {"key": value, "table": {"x": value}, "many": [{"x": value}, {}]}


def test_schema():
    committed = (PLACE / "docs" / "runfile.schema.json").read_text(encoding="utf-8")
    assert ended(0, "schema").stdout == committed, "run: nontwist schema > docs/runfile.schema.json"
    validator = pytest.importorskip("jsonschema").Draft202012Validator(json.loads(committed))
    validator.check_schema(json.loads(committed))
    for name in example_names():
        data = document(name, (EXAMPLES / f"{name}.toml").read_bytes())
        assert not list(validator.iter_errors(data)), name
        assert list(validator.iter_errors(data | {"titel": "x"}))
    assert "null" not in committed


def test_page_holds_a_run_file(write):
    page = (PLACE / "docs" / "run-files.md").read_text(encoding="utf-8")
    text = page.split("```toml\n")[1].split("```")[0]
    run = simulate(read(write, text).problem)
    assert drifts(run)["energy_balance"].relative < 1e-13
    wrong = text.replace('"heavy_top"  ', '"Standard"').replace("[start]", "axes = [0, 0, 1]\n[start]")
    path = write(wrong.replace("t_end = 2.0", "t_end = inf"))
    with pytest.raises(RunFileError) as caught:
        read_run_file(path)
    told = str(caught.value).replace(str(path), "run.toml").splitlines()
    assert len(told) == 3
    for line in told:
        assert f"\n{line}\n" in page
    for keys in (section.model_fields for section in (Body, Start, Time, Integrator, Output)):
        assert all(f"`{key}`" in page for key in keys)
    assert all(f"`{kind}`" in page for kind in (*TABLES, *MAKERS))


def test_a_coarse_step_is_forecast():
    coming = forecast(read_run_file(EXAMPLES / "case1.toml"))
    assert (coming.steps, coming.states) == (1000, 1001)
    slowest = np.linalg.eigvalsh([[3, -1 / 7], [-1 / 7, 4]])[0]
    turn = 0.005 * np.sqrt(2 * 717.428571428 / slowest)
    assert coming.turn == pytest.approx(np.degrees(turn))
    assert coming.phase_error == pytest.approx(np.degrees(1000 * turn**3 / 12), rel=1e-2)
    (told,) = coming.warnings
    said(told)
    fine = forecast(read_run_file(EXAMPLES / "case1.toml", ['integrator.name="gauss"', "integrator.order=4"]))
    assert fine.warnings == ()
    assert fine.phase_error < 1e-2
    off_grid = forecast(read_run_file(EXAMPLES / "case2.toml", ["load.0.end=0.999"]))
    assert "off the grid of step 0.005 s" in off_grid.warnings[0]


WORDS = st.sampled_from(["body", "space", "standard", "pulse", "split", "wxyz", "", "é\u0007", "1e400"])
ANY_NUMBER = st.one_of(st.floats(), st.integers(-(10**30), 10**400))
GARBAGE = st.one_of(ANY_NUMBER, WORDS, st.booleans(), st.just([]), st.just({}), st.lists(ANY_NUMBER, max_size=4))
PLAIN = [load for load, _ in LOADS.values() if "file" not in load]
SOUND = [
    *((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8") for name in example_names()),
    *(
        f"[body]\n{body}[start]\nproject = true\nrotation = {form}\n[[load]]\n{load}\n"
        for (body, _), form, load in zip(BODIES.values(), FORMS.values(), cycle(PLAIN), strict=False)
    ),
]


@st.composite
def documents(draw):
    """A document, with up to three of its values put wrong."""
    data, one_of = document("", draw(st.sampled_from(SOUND)).encode()), st.sampled_from
    t_end, steps, name = draw(one_of([0.2, 0.05, 1e-3])), draw(st.integers(1, 40)), draw(one_of([*INTEGRATORS]))
    data["time"] = {"t_end": t_end, "step": t_end / steps, "store": draw(one_of([1, 3, "end"]))}
    data["integrator"] = {"name": draw(one_of(["gauss", "gauss", "lie-midpoint", "energy-momentum", name]))}
    data.pop("sweep", None)
    for _ in range(draw(one_of([0] * 30 + [1, 1, 3]))):
        spoil(draw, data)
    return data


def spoil(draw, data):
    """Put one value of the document wrong, or only extreme, or take it away, or add a key."""
    place = data
    while keys := list(place) if isinstance(place, dict) else list(range(len(place))):
        key = draw(st.sampled_from(keys))
        if isinstance(place[key], (dict, list)) and draw(st.integers(0, 5)):
            place = place[key]
            continue
        what = draw(st.sampled_from(["garbage", "garbage", "number", "number", "take", "add"]))
        if what == "take":
            del place[key]
        elif what == "add" and isinstance(place, dict):
            place[draw(st.sampled_from(["kindd", "x", "a b", "order", "mass"]))] = draw(GARBAGE)
        else:
            place[key] = draw(ANY_NUMBER if what == "number" else GARBAGE)
        return


def outcome(data):
    """Read and run a document as a user's file; nothing but an error in clear words, or a run of numbers."""
    try:
        run_file = checked("doc", document("doc", toml_text(data).encode()), Folder(Path()))
    except RunFileError as error:
        for line in str(error).splitlines():
            assert re.fullmatch(r"doc: \S+.*: .+ -> .+", line), line
        return str(error)
    coming = forecast(run_file)
    if coming.steps > 2000 or (run_file.integrator.name == "continuous" and coming.steps * coming.turn > 1e3):
        return "long"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=UserWarning)
        try:
            run = simulate(run_file.problem)
        except (ValueError, SimulationError) as error:
            return str(error)
    assert all(np.isfinite(v.values).all() for v in run.variables.values() if v.dtype.kind == "f")
    return "run"


@pytest.mark.filterwarnings("ignore:the centre of mass is the fixed point")
@pytest.mark.parametrize("count", [20, pytest.param(10_000, marks=pytest.mark.long)])
def test_generated_documents(count):
    """Whether the runs are right, `test_generated_problems` asks."""
    ends = []

    @settings(max_examples=count, deadline=None, derandomize=True)
    @given(documents())
    def each(data):
        ends.append(outcome(data))

    each()
    assert ends.count("run") >= 0.6 * len(ends), ends
