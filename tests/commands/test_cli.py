import errno
import inspect
import itertools
import json
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from conftest import ended, nontwist
from nontwist import open_run, read_motion, rotation, save_run, simulate, standard, twist
from nontwist.cli import app, outcomes
from nontwist.cli.recording_commands import parse_axis, twist_command
from nontwist.cli.shared_options import command
from nontwist.runfile.document import Integrator, Start, Time
from refusals import said


def test_reproduce_prints_tables(tmp_path):
    result = ended(0, "reproduce", "--case", "1", "--quick", "--out", str(tmp_path))
    assert "20.571428571" in result.stdout
    assert "3.994933" in result.stdout
    assert "20 of 20 printed numbers agree" in result.stdout
    assert "step 0.005" not in result.stdout


IMU = Path(__file__).parents[2] / "examples" / "imu" / "quaternion.csv"
COMMANDS = {  # with what each may not import
    "--version": "numpy scipy matplotlib xarray h5py",
    "--help": "numpy scipy matplotlib xarray h5py",
    f"twist {IMU} --inverse --out u": "dask.array scipy",
    "info u.nc": "dask.array scipy",
    "example standard": "dask.array scipy",
    "run standard.toml --set time.t_end=1 --set output.figures=[]": "dask.array",
}
IMPORTING = f"""
import sys; from typer.testing import CliRunner; from nontwist.cli import app
for command, slow in {COMMANDS}.items():
    result = CliRunner().invoke(app, command.split())
    print(result.exit_code, [name for name in slow.split() if name in sys.modules], result.stdout.split()[:2])
"""


def test_commands_import_little(tmp_path):
    command = [sys.executable, "-c", IMPORTING]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    lines = done.stdout.splitlines()
    assert [line[:4] for line in lines] == ["0 []"] * len(COMMANDS)
    assert "['nontwist', '0." in lines[0]


def twisted(tmp_path, *arguments, data=IMU, stdin=None):
    """Run `nontwist twist`; the result and the dataset it wrote."""
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["twist", str(data), "--out", str(out), "--force", *arguments], input=stdin)
    return result, open_run(f"{out}.nc") if result.exit_code == 0 else None


def test_twist_of_the_recording(tmp_path):
    """Its curves have degrees, and decimal commas on request."""
    result, run = twisted(tmp_path, "--inverse", "--csv", "--degrees")
    assert result.exit_code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"out.nc", "out.csv", "out.pdf", "out.png"}
    recording = pandas.read_csv(IMU)
    expected = twist(rotation(recording).inv(), recording["Time (s)"])
    angle, table = np.degrees(expected.twist_angle.values), pandas.read_csv(tmp_path / "out.csv")
    assert run.twist_angle.values == pytest.approx(expected.twist_angle.values, abs=1e-12)
    assert f"{angle[-1]:.6g}°" in result.stdout
    assert "written" not in result.stdout
    assert table["twist_angle [degree]"].to_numpy() == pytest.approx(angle, abs=1e-9)
    assert table["solid_angle [sr]"].to_numpy() == pytest.approx(expected.solid_angle.values, abs=1e-12)
    assert f"range of the twist angle     │ {angle.min():.6g}° to {angle.max():.6g}°" in result.stdout
    twisted(tmp_path, "--inverse", "--csv", "--degrees", "--decimal-comma", "--no-figure")
    header, *_, last = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()
    assert header.startswith("time [s];twist_angle [degree];")
    assert float(last.split(";")[1].replace(",", ".")) == np.degrees(run.twist_angle.values[-1])
    assert "." not in last


@pytest.mark.usefixtures("here")
def test_body_of_recording_is_viewed():
    t = np.linspace(0, 1, 20)
    quaternions = {f"{name}_q{x}": np.full(20, float(x == "w")) for name in ("upper", "fore") for x in "wxyz"}
    pandas.DataFrame({"time (s)": t} | quaternions).to_csv("two.csv", index=False)
    assert "--body takes one of upper, fore" in ended(3, "view", "two.csv", "--png", "x.png").stderr
    assert "fore_qw" in ended(0, "view", "two.csv", "--body", "fore", "--png", "x.png").stderr
    assert Path("x.png").exists()


def test_reading_options(tmp_path):
    assert [parse_axis(text).tolist() for text in ("x", "0.1,0.2,0.97")] == [[1, 0, 0], [0.1, 0.2, 0.97]]
    recording = pandas.read_csv(IMU)
    R, t = rotation(recording), recording["Time (s)"].to_numpy()
    expected, quat = twist(R, t, axis=[0, -1, 0], axis_frame="space").twist_angle.values, R.as_quat()
    np.savez(tmp_path / "columns.npz", a=t, b=quat[:, 3], c=quat[:, 0], d=quat[:, 1], e=quat[:, 2])
    np.savez(tmp_path / "last.npz", quaternion=quat, t=t)
    plain = IMU.read_text(encoding="utf-8").replace("Time (s)", "Time")
    for unit, data, options, stdin in (
        (1, tmp_path / "last.npz", "--scalar-last", None),
        (1, tmp_path / "columns.npz", "--columns a,b,c,d,e --scalar-first", None),
        (1000, "-", "--time-unit ms", plain),
    ):
        how = ["--axis=-y", "--axis-frame", "space", "--no-figure", *options.split()]
        _, run = twisted(tmp_path, *how, data=data, stdin=stdin)
        assert run.attrs["axis"].tolist() == [0, -1, 0]
        assert run.twist_angle.values == pytest.approx(expected, abs=1e-9)
        assert run.time.values == pytest.approx(t / unit)


def test_damaged_npz_file(tmp_path):
    data, rng = tmp_path / "data.npz", np.random.default_rng(0)
    np.savez_compressed(data, quaternion=np.tile([0.0, 0, 0, 1], (20, 1)), t=np.arange(20.0))
    sound = data.read_bytes()
    for at in rng.integers(len(sound), size=50):
        data.write_bytes(sound[:at] + bytes([sound[at] ^ 1 << int(rng.integers(8))]) + sound[at + 1 :])
        with suppress(ValueError):
            read_motion(data, scalar_first=False)
    with zipfile.ZipFile(data, "w") as file:
        file.writestr("notes.txt", "no array")
    result, _ = twisted(tmp_path, data=data)
    assert (result.exit_code, result.stderr.count("\n")) == (3, 1)


def test_recording_without_headers_or_times(tmp_path, monkeypatch):
    """Warnings of a row that is left out go to stderr."""
    _, result = twisted(tmp_path, "--no-figure")
    _, *lines = IMU.read_text(encoding="utf-8").splitlines(keepends=True)
    how = ["--no-figure", "--scalar-first"]
    told, same = twisted(tmp_path, *how, data="-", stdin="".join([*lines[:5], "9,,0,0,0\n", *lines[5:]]))
    assert np.array_equal(result.twist_angle, same.twist_angle)
    dropped = "dropped 1 row with a zero or missing attitude or a missing time, the first is line 6"
    assert f"warning: {dropped}\n" in told.stderr
    assert same.attrs["samples_left_out"] == 1
    without = "".join(line.split(",", 1)[1] for line in lines)
    given, rated = twisted(tmp_path, *how, "--rate", "50", "--json", "--quiet", data="-", stdin=without)
    assert np.array_equal(rated.time, np.arange(len(lines)) / 50)
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["twist", "-", *how, "--rate", "50"], input=without).exit_code == 0
    assert (
        CliRunner().invoke(app, ["twist", "-", *how, "--rate", "50", "--out", "own.nc"], input=without).exit_code == 0
    )
    for name in ("stdin-twist.nc", "own.nc"):
        assert np.array_equal(open_run(name).twist_angle, rated.twist_angle)
    assert np.array_equal(rated.twist_angle, result.twist_angle)
    assert given.stderr == ""
    facts = json.loads(given.stdout)
    assert facts["twist_angle"] == rated.twist_angle[-1]
    assert facts["largest_twist_rate"] == rated.twist_rate[np.argmax(abs(rated.twist_rate.data))]
    assert (facts["file"], facts["samples"], facts["median_interval"]) == ("-", len(lines), pytest.approx(0.02))


BODY = '[body]\nkind = "standard"\ninertia = [1, 2, 2.5]\n'
TIME = "[time]\nt_end = 1\nstep = 0.1\n"
REST = '[start]\nrun = "run.nc"\n[time]\nt_start = 1\nt_end = 2\nstep = 0.1\n'
FILES = {
    "run.toml": BODY + TIME,
    "sub/run.toml": BODY + TIME,
    "rest.toml": BODY + REST,
    "spun.toml": "load = [{ kind = 'dry_friction', limit = 1 }]\n"
    + BODY.replace("standard", "nontwisting")
    + "spin = 1\n"
    + TIME,
    "rubbed.toml": f"load = [{{ kind = 'wheel', axis = 'z', inertia = 0.1, viscous = 0.1 }}]\n{BODY}{TIME}",
    "bad.toml": f"{BODY}mass = -1\n[bdy]\n",
    "worse.toml": "a: 1",
    "order.csv": "0,0.8,0,0,0.6\n1,0.8,0,0.6,0\n",
    "page.html": "",
    "file": "",
}
OLD_ORDER = """--set integrator.name='"lie-midpoint"' --set integrator.order=4"""
ENDS = {
    2: """
        twist imu.csv --rate fast
        twist imu.csv --order 2.5
        twist imu.csv --order 3
        twist imu.csv --align foo
        twist imu.csv --axis 1,2
        twist imu.csv --decimal-comma
        twist run.nc --out x.csv
        view imu.csv --euler XXZ
        view run.nc --out x.gif
        view run.nc --body fore
        play --out x.pdf
        export run.nc --to npz
        export run.nc --out x.mat
        export run.nc --to csv --out x.json
        export run.nc --to json --decimal-comma
        example case1 --out x.nc
        example heavytop
        reproduce --case 4
        reproduce --out x.pdf
        validate --page x.html
        run run.toml sub/run.toml --out x.nc
        run run.toml --out a.csv
        sweep run.toml --out a.csv
        compare run.toml --against steps
        compare run.toml --integrator gauss:two
        plot run.nc
        steer
        bogus
    """,
    3: f"""
        twist order.csv
        twist imu.csv --rate 50 --time-column 'Time (s)'
        twist imu.csv --axis 0,0,0
        twist imu.csv --time-unit weeks
        twist run.toml
        view run.toml
        view page.html
        info run.toml
        export run.toml
        fit run.toml
        info order.csv
        run run.toml bad.toml worse.toml
        run run.toml --set body.mss=2 --set time.step=0.3
        run run.toml --set 'integrator.name="exact"' --set body.mass=1 --set 'body.centre_of_mass=[0,0,0.1]' --out x.nc
        check run.nc
        check run.toml {OLD_ORDER}
        compare run.toml --integrator lie-midpoint:4
        compare run.toml --integrator euler
        precision run.toml --set 'integrator.name="exact"'
        check spun.toml
        check rubbed.toml --set 'integrator.name="split"'
        check rest.toml --set time.t_start=1.5
        check rest.toml --set 'start.run="no.nc"'
        check rest.toml --set 'start.run="rest.toml"'
        check rest.toml --set 'start.angular_velocity.body=[0, 1, 0]'
        check rest.toml --set 'sweep={{over=[{{key="body.inertia.0", kind="list", values=[3, 4]}}]}}'
        check run.toml --set 'sweep={{over=[{{key="body.inertia.0", kind="list", values=[9, 8]}}]}}'
    """,
    5: """
        twist nothing.csv
        twist imu.csv --out /nonexistent/x
        info none.nc
        info .
        info relative_to.nc
        export run.nc --out none/x.csv
        run run.toml --out no/x.nc
        run run.toml sub/run.toml
        run nothing.toml
        run run
        run case2.toml
        run case2.nc
        run rest.nc
        run sub
        reproduce --quick --out file
    """,
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with run files, two of which are wrong, a result, a page, and recordings."""
    folder = tmp_path_factory.mktemp("ends")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    shutil.copy(IMU, folder / "imu.csv")
    save_run(simulate(standard([1, 2, 2.5]), t_end=1, step=0.1), folder / "run.nc")
    return folder


@pytest.mark.parametrize(
    ("code", "line"), [(code, line.strip()) for code, lines in ENDS.items() for line in lines.strip().splitlines()]
)
def test_how_commands_end(code, line, place, monkeypatch):
    """Whatever is refused is so before anything is printed or written."""
    monkeypatch.chdir(place)
    before = sorted(place.rglob("*"))
    result = nontwist(*shlex.split(line))
    assert (result.exit_code, result.stdout, sorted(place.rglob("*"))) == (code, "", before)
    is_elsewhere = line.endswith(" run.toml") and code == 3 and not line.startswith("run ")
    assert result.stderr.endswith("nontwist run run.toml runs it\n") == is_elsewhere
    said(result.stderr.rpartition("Error: ")[2])


@pytest.mark.parametrize("command", list(get_command(app).commands))
def test_help_fits_the_terminal(command):
    width = 60
    shown = CliRunner().invoke(app, [command, "--help"], terminal_width=width - 2).stdout
    text, _, tables = re.split(r"\n(Arguments|Options):\n", shown, maxsplit=1)
    assert not re.search(r"…|Default: \.|\w-$", shown, re.MULTILINE)  # no line is broken at a hyphen
    own = get_command(app).commands[command]
    assert " ".join(own.help.split()) in " ".join(text.split())
    usage = shown.partition("\n\n")[0]
    assert ("..." in usage) == any(one.nargs == -1 for one in own.params if one.param_type_name == "argument")
    for option in own.params:
        for name in (*option.opts, *option.secondary_opts):
            assert not name.startswith("--") or re.search(rf"{name}\b", tables), name
        assert option.is_eager or getattr(option, "is_flag", False) or option.metavar, option.name
    assert max(map(len, shown.splitlines())) <= width
    for line, after in itertools.pairwise(map(str.strip, text.splitlines())):
        assert not (line and after) or len(line) + 1 + len(after.split()[0]) > width - 4, line
    words = "--import MODULE Import this module first, from here or the Python path. It adds bodies, loads, "
    assert " ".join(shown.split()).count(f"{words}integrators or readers. Repeatable.") == 1
    assert "-h, --help" in tables


def test_twist_options_default_as_python():
    own, plain = (inspect.signature(one).parameters for one in (command(twist_command), twist))
    shared = ("axis", "axis_frame", "order", "scalar_first")
    assert [own[name].default for name in shared] == [plain[name].default for name in shared]


def test_run_files_default_as_simulate():
    plain = {name: one.default for name, one in inspect.signature(simulate).parameters.items()}
    tables = {**Time.model_fields, **Start.model_fields}
    for name in tables.keys() & plain.keys() - {"t_end", "t_start", "rotation", "angular_velocity"}:
        assert tables[name].default == plain[name], name
    fields = Integrator.model_fields
    assert (fields["name"].default, fields["order"].default) == (plain["integrator"], plain["order"])


def test_read_only_file_system():
    error, words = OSError(errno.EROFS, "Read-only file system", "a.nc"), "Read-only file system; --out names another"
    assert outcomes._message(error) == f"a.nc: {words} place to write to"
    with pytest.raises(outcomes.CommandError) as told, outcomes.about("cannot write a.nc", OSError):
        raise error
    assert str(told.value) == f"cannot write a.nc: {words} place to write to"
    assert [*map(outcomes._message, (KeyboardInterrupt(), KeyboardInterrupt("by")))] == ["interrupted", "by"]
