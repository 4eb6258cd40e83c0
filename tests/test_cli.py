import errno
import inspect
import itertools
import json
import re
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
from nontwist.cli.options import command
from nontwist.cli.recording_commands import twist_command
from nontwist.runfile.document import Integrator, Start, Time
from refusals import said


def test_reproduce_prints_tables_and_exits_with_0(tmp_path):
    result = ended(0, "reproduce", "--case", "1", "--quick", "--out", str(tmp_path))
    assert "20.571428571" in result.stdout
    assert "3.994933" in result.stdout
    assert "20 of 20 printed numbers agree" in result.stdout
    assert "step 0.005" not in result.stdout


def test_reproduce_exits_with_1_when_a_number_differs(tmp_path):
    result = ended(1, "reproduce", "--case", "3", "--quick", "--printed-loads", "--out", str(tmp_path))
    assert "DIFFERS" in result.stdout
    assert "20 times smaller" in result.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("twist a.csv --rate fast", " for '--rate': fast is not a number"),
        ("twist a.csv --order 2.5", " for '--order': 2.5 is not a whole number"),
        ("reproduce --case 4", " for '--case': 4 is above 3, the largest value"),
        ("twist a.csv --rate -1", ": --rate re"),
        ("view a.csv --euler XXZ", ": --euler re"),
        ("twist a.csv --align foo", " for '--align': 'foo' is not one of '"),
    ],
)
def test_a_value_that_an_option_cannot_take_is_an_error_of_usage(words, message):
    told = ended(2, *words.split()).stderr.replace("must be", "requires")
    assert f"Error: Invalid value{message}" in told


def test_an_output_that_cannot_be_written_exits_with_5(tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    result = nontwist("reproduce", "--quick", "--out", str(tmp_path / "file"))
    assert (result.exit_code, result.stderr) == (5, f"{tmp_path}/file/case1: Not a directory\n")


IMU = Path(__file__).parents[1] / "examples" / "imu" / "quaternion.csv"
COMMANDS = {  # with what each may not import
    "--version": "numpy scipy matplotlib xarray h5py",
    "--help": "numpy scipy matplotlib xarray h5py",
    f"twist {IMU} --inverse --out u": "dask.array scipy",
    "info u.nc": "dask.array scipy",
    "example suslov": "dask.array scipy",
    "run suslov.toml --set time.t_end=1": "dask.array",
}
IMPORTING = f"""
import sys; from typer.testing import CliRunner; from nontwist.cli import app
for command, slow in {COMMANDS}.items():
    result = CliRunner().invoke(app, command.split())
    print(result.exit_code, [name for name in slow.split() if name in sys.modules], result.stdout.split()[:2])
"""


def test_commands_import_nothing_that_is_slow_and_not_needed(tmp_path):
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
    assert run.twist_angle.values == pytest.approx(expected.twist_angle.values, abs=1e-12)
    assert f"{np.degrees(float(expected.twist_angle[-1])):.6g}°" in result.stdout
    assert "499" in result.stdout
    assert "written" not in result.stdout
    table = pandas.read_csv(tmp_path / "out.csv")
    angle = np.degrees(expected.twist_angle.values)
    assert table["twist_angle [degree]"].to_numpy() == pytest.approx(angle, abs=1e-9)
    assert table["solid_angle [sr]"].to_numpy() == pytest.approx(expected.solid_angle.values, abs=1e-12)
    assert table["twist_rate [degree s-1]"].to_numpy() == pytest.approx(np.degrees(run.twist_rate.values), abs=1e-9)
    assert f"range of the twist angle     │ {angle.min():.6g}° to {angle.max():.6g}°" in result.stdout
    twisted(tmp_path, "--inverse", "--csv", "--degrees", "--decimal-comma", "--no-figure")
    header, *_, last = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()
    assert header.startswith("time [s];twist_angle [degree];")
    assert float(last.split(";")[1].replace(",", ".")) == np.degrees(run.twist_angle.values[-1])
    assert "." not in last
    assert "applies to CSV only; add --csv" in ended(2, "twist", str(IMU), "--decimal-comma").stderr


def test_a_body_of_a_recording_is_viewed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0, 1, 20)
    quaternions = {f"{name}_q{x}": np.full(20, float(x == "w")) for name in ("upper", "fore") for x in "wxyz"}
    pandas.DataFrame({"time (s)": t} | quaternions).to_csv("two.csv", index=False)
    assert "--body takes one of upper, fore" in ended(3, "view", "two.csv", "--png", "x.png").stderr
    assert "fore_qw" in ended(0, "view", "two.csv", "--body", "fore", "--png", "x.png").stderr
    assert Path("x.png").exists()
    save_run(simulate(standard([1, 2, 2]), t_end=1), "run.nc")
    refused = ended(2, "view", "run.nc", "--body", "fore").stderr
    assert "applies to recordings only; run.nc is a result" in refused


@pytest.mark.parametrize(
    ("axis", "vector", "frame"),
    [("x", [1, 0, 0], "body"), ("-y", [0, -1, 0], "space"), ("0.1,0.2,0.97", [0.1, 0.2, 0.97], "space")],
)
def test_axes(tmp_path, axis, vector, frame):
    _, run = twisted(tmp_path, f"--axis={axis}", "--axis-frame", frame, "--no-figure")
    assert run.attrs["axis"] == pytest.approx(np.array(vector) / np.linalg.norm(vector))
    expected = twist(pandas.read_csv(IMU), axis=vector, axis_frame=frame)
    assert run.twist_angle.values == pytest.approx(expected.twist_angle.values, abs=1e-12)


def test_options_say_how_a_recording_is_read(tmp_path):
    recording = pandas.read_csv(IMU)
    R, t = rotation(recording), recording["Time (s)"].to_numpy()
    expected, quat = twist(R, t).twist_angle.values, R.as_quat()
    np.savez(tmp_path / "last.npz", quaternion=quat, t=t)
    np.savez(tmp_path / "columns.npz", a=t, b=quat[:, 3], c=quat[:, 0], d=quat[:, 1], e=quat[:, 2])
    for name, options in {"last": "--scalar-last", "columns": "--columns a,b,c,d,e --scalar-first"}.items():
        _, run = twisted(tmp_path, "--no-figure", *options.split(), data=tmp_path / f"{name}.npz")
        assert run.twist_angle.values == pytest.approx(expected, abs=1e-9), name
        assert run.time.values == pytest.approx(t)
    _, run = twisted(tmp_path, "--no-figure", data="-", stdin=IMU.read_text(encoding="utf-8"))
    assert run.twist_angle.values == pytest.approx(expected, abs=1e-12)
    (tmp_path / "plain.csv").write_text(IMU.read_text(encoding="utf-8").replace("Time (s)", "Time"), encoding="utf-8")
    _, run = twisted(tmp_path, "--no-figure", "--time-unit", "ms", data=tmp_path / "plain.csv")
    assert run.time.values == pytest.approx(t / 1000)


def test_a_damaged_npz_file_is_reported_in_a_line(tmp_path):
    data, text = tmp_path / "data.npz", tmp_path / "text.npz"
    np.savez_compressed(data, quaternion=np.tile([0.0, 0, 0, 1], (20, 1)), t=np.arange(20.0))
    sound, rng = data.read_bytes(), np.random.default_rng(0)
    np.save(tmp_path / "one.npy", np.eye(3))
    damages = [b"", b"garbage", b"PK\x03\x04garbage", sound[:200], (tmp_path / "one.npy").read_bytes()]
    for at in rng.integers(len(sound), size=100):
        damages.append(sound[:at] + bytes([sound[at] ^ 1 << int(rng.integers(8))]) + sound[at + 1 :])
    for damaged in damages:
        data.write_bytes(damaged)
        with suppress(ValueError):
            read_motion(data, scalar_first=False)
    data.write_bytes(sound[:200])
    result, _ = twisted(tmp_path, data=data)
    assert (result.exit_code, result.stderr) == (3, f"{data}: it is not a readable NPZ file: damaged or cut short\n")
    with zipfile.ZipFile(text, "w") as file:
        file.writestr("notes.txt", "no array")
    result, _ = twisted(tmp_path, data=text)
    assert (result.exit_code, result.stderr.count("\n")) == (3, 1)


def test_twist_of_a_run_of_ours(tmp_path):
    run = simulate(standard([1, 2, 2.5]), t_end=1, step=0.01, angular_velocity=[1, 2, 3])
    save_run(run, tmp_path / "run.nc")
    _, result = twisted(tmp_path, "--no-figure", data=tmp_path / "run.nc")
    assert np.array_equal(result.twist_angle, twist(run).twist_angle)


def test_warnings_go_to_stderr(tmp_path):
    lines = IMU.read_text(encoding="utf-8").splitlines(keepends=True)
    result, run = twisted(tmp_path, "--no-figure", data="-", stdin="".join([*lines[:5], "9,,0,0,0\n", *lines[5:]]))
    assert result.exit_code == 0
    dropped = "dropped 1 row with a zero or missing attitude or a missing time, the first is line 6"
    assert f"warning: {dropped}\n" in result.stderr
    assert "warning" not in result.stdout
    assert run.attrs["samples_left_out"] == 1


def test_a_recording_without_headers_and_without_times(tmp_path):
    _, result = twisted(tmp_path, "--no-figure")
    _, *lines = IMU.read_text(encoding="utf-8").splitlines(keepends=True)
    how = ["--no-figure", "--scalar-first"]
    _, same = twisted(tmp_path, *how, data="-", stdin="".join(lines))
    assert np.array_equal(result.twist_angle, same.twist_angle)
    without = "".join(line.split(",", 1)[1] for line in lines)
    given, rated = twisted(tmp_path, *how, "--rate", "50", "--json", "--quiet", data="-", stdin=without)
    assert np.array_equal(rated.time, np.arange(len(lines)) / 50)
    assert np.array_equal(rated.twist_angle, result.twist_angle)
    assert given.stderr == ""
    facts = json.loads(given.stdout)
    assert facts["twist_angle"] == rated.twist_angle[-1]
    assert facts["largest_twist_rate"] == rated.twist_rate[np.argmax(abs(rated.twist_rate.data))]
    assert (facts["file"], facts["samples"], facts["median_interval"]) == ("-", len(lines), pytest.approx(0.02))


WRONG = {
    "no file": (["nothing.csv"], 5),
    "no order": (["-"], 3),
    "rate": ([str(IMU), "--rate", "50", "--time-column", "Time (s)"], 3),
    "axis": ([str(IMU), "--axis", "1,2"], 2),
    "axis zero": ([str(IMU), "--axis", "0,0,0"], 3),
    "order": ([str(IMU), "--order", "3"], 2),
    "unit": ([str(IMU), "--time-unit", "weeks"], 3),
    "output": ([str(IMU), "--out", "/nonexistent/x"], 5),
}
NO_ORDER = "0,0.8,0,0,0.6\n1,0.8,0,0.6,0\n"


@pytest.mark.parametrize("case", WRONG)
def test_errors_are_reported(case, tmp_path):
    arguments, code = WRONG[case]
    if "--out" not in arguments:
        arguments = [*arguments, "--out", str(tmp_path / "x")]
    result = CliRunner().invoke(app, ["twist", *arguments], input=NO_ORDER, env={"COLUMNS": "200"})
    assert result.exit_code == code
    said(result.stderr.rpartition("Error: ")[2])


@pytest.mark.parametrize("command", [one.name for one in app.registered_commands])
@pytest.mark.parametrize("width", [60, 80])
def test_help_fits_the_terminal_and_ends_with_the_option_of_all_commands(command, width):
    shown = CliRunner().invoke(app, [command, "--help"], terminal_width=width - 2).stdout
    text, _, tables = re.split(r"\n(Arguments|Options):\n", shown, maxsplit=1)
    assert "…" not in shown
    assert "Default: ." not in shown
    own = get_command(app).commands[command]
    assert " ".join(own.help.split()) in " ".join(text.split())
    usage = shown.partition("\n\n")[0]
    assert ("..." in usage) == any(one.nargs == -1 for one in own.params if one.param_type_name == "argument")
    for option in own.params:
        for name in (*option.opts, *option.secondary_opts):
            assert not name.startswith("--") or re.search(rf"{name}\b", tables), name
        assert option.is_eager or getattr(option, "is_flag", False) or option.metavar, option.name
    assert max(map(len, shown.splitlines())) <= width
    assert not re.search(r"\w-$", shown, re.MULTILINE)  # no line is broken at a hyphen
    for line, after in itertools.pairwise(map(str.strip, text.splitlines())):
        assert not (line and after) or len(line) + 1 + len(after.split()[0]) > width - 4, line
    words = "--import MODULE Import this module first, from here or the Python path. It adds bodies, loads, "
    assert f"{words}integrators or readers. Repeatable." in " ".join(shown.split())
    assert shown.count("--import") == 1
    assert "-h, --help" in tables


def test_the_options_of_twist_have_the_defaults_of_python():
    own, plain = (inspect.signature(one).parameters for one in (command(twist_command), twist))
    shared = ("axis", "axis_frame", "order", "scalar_first")
    assert [own[name].default for name in shared] == [plain[name].default for name in shared]


def test_run_files_have_the_defaults_of_simulate():
    plain = {name: one.default for name, one in inspect.signature(simulate).parameters.items()}
    tables = {**Time.model_fields, **Start.model_fields}
    for name in tables.keys() & plain.keys() - {"t_end", "t_start", "rotation", "angular_velocity"}:
        assert tables[name].default == plain[name], name
    fields = Integrator.model_fields
    assert (fields["name"].default, fields["order"].default) == (plain["integrator"], plain["order"])


def test_a_read_only_file_system_is_answered_with_the_option_of_another_place():
    error, words = OSError(errno.EROFS, "Read-only file system", "a.nc"), "Read-only file system; --out names another"
    assert outcomes._message(error) == f"a.nc: {words} place to write to"
    with pytest.raises(outcomes.CommandError) as told, outcomes.about("cannot write a.nc", OSError):
        raise error
    assert str(told.value) == f"cannot write a.nc: {words} place to write to"
