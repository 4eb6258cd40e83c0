"""`nontwist info` and `nontwist export`: what they print, and how they end."""

import csv
import io
import json
import os
import re
import subprocess
import sys

import numpy as np
import pandas
import pytest
import xarray

import nontwist as nt
from conftest import ended, nontwist
from nontwist import nontwisting, open_run, save_run, simulate, twist
from nontwist.cli.printing import print_rows, shown_unit

W = {"material_angular_velocity": [0.6, -0.8, 0], "t_end": 1, "step": 0.01}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A free non-twisting body, a loaded heavy top, the twist of the first."""
    folder = tmp_path_factory.mktemp("results")
    free = simulate(nontwisting([3, 4, 5]), **W)
    load = 2 * nt.body_moment([0, 0.5, 1], [[0, 0, 0], [1, 1, 0], [0, 0, 0]]) + nt.damping(0.1)
    top = simulate(nt.heavy_top([2, 2.2, 1], 1.5, [0.1, 0, 0.6]), **W, load=load, store=10, integrator="split")
    for name, run in {"free": free, "top": top.assign_attrs(run_file="[body]\n# é\n"), "twist": twist(free)}.items():
        save_run(run, folder / f"{name}.nc")
    save_run(simulate(nontwisting([3, 4, 5], spin=60), **W), folder / "spun.nc")
    save_run(nt.sensitivities(nontwisting([3, 4, 5]), **W, store=10, wrt="rotation"), folder / "tangents.nc")
    return folder


def test_info_tells_all(files):
    result = ended(0, "info", files / "top.nc")
    for text in (
        "heavy_top rigid body, split",
        f"{(files / 'top.nc').stat().st_size / 1e6:.3g} MB, checksum verified",
        "heavy_top; principal moments (1, 2, 2.2) kg m²",
        "d1: (0, 0, -1.4715) N m; d3: (0, 0, -8.829) N m",
        "table of 3 moments of up to 2.828 N m along the directors; damping 0.1 N m s",
        "0 s to 1 s, 11 stored states",
        "split, order 4 ",
        "100 of 0.01 s",
        "0 (done)",
        "drift of energy balance",
        "drift of orthonormality",
        "python 3.",
        "[body] … (2 lines; all of it with --json)",
        "kg m² s⁻¹",
        "midtime 10, axis 3",
    ):
        assert text in result.stdout, text
    for name, words in (("free", "no twist about (0, 0, 1)"), ("spun", "a prescribed spin about (0, 0, 1)")):
        shown = nontwist("info", files / f"{name}.nc").stdout
        assert words in shown
        assert float(re.search(r"largest error of the twist rate +│ (\S+) rad/s", shown)[1]) < 1e-12
    turned, psi = nontwist("info", files / "twist.nc").stdout, open_run(files / "twist.nc").twist_angle[-1].item()
    assert "twist about the axis" in turned
    assert "drift" not in turned
    assert re.search(rf"total.* {psi:.4g} rad \({np.degrees(psi):.4g}°\)", turned)


def test_info_as_json(files):
    result = nontwist("info", files / "free.nc", "--json")
    facts, run = json.loads(result.stdout), open_run(files / "free.nc")
    assert facts["system"] == json.loads(run.attrs["system"])
    assert facts["integrator"] == {"name": "gauss", "order": 8}
    assert (facts["step"], facts["status"], facts["message"]) == (0.01, 0, "done")
    assert facts["time"] == {"first": 0.0, "last": 1.0, "states": 101}
    assert facts["dimensions"]["midtime"] == 100
    assert facts["variables"]["moment"]["units"] == "N m"
    energy = run["kinetic_energy"].values
    assert facts["drift"]["kinetic_energy"]["absolute"] == abs(energy - energy[0]).max()
    assert facts["twist_defect"] == abs(run["twist_rate"].values).max()


def test_csv_is_exact(files, tmp_path, monkeypatch):
    """On stdout, in a file, and in blocks of any size."""
    run, shown = open_run(files / "top.nc"), nontwist("export", files / "top.nc").stdout
    ended(0, "export", files / "top.nc", "--out", tmp_path / "top.csv")
    assert shown == (tmp_path / "top.csv").read_text(encoding="utf-8")
    for rows in (1, 2, 3, 11):
        monkeypatch.setattr("nontwist.io.run_files.ROWS", rows)
        assert nontwist("export", files / "top.nc").stdout == shown
    header, *rows = csv.reader(shown.splitlines())
    assert header[:5] == ["time [s]", *(f"directors_1_{x}" for x in "xyz"), "directors_2_x"]
    table = dict(zip(header, zip(*rows, strict=True), strict=True))
    for name, values in (
        ("time [s]", run["time"]),
        ("spatial_momentum_y [kg m2 s-1]", run["spatial_momentum"][:, 1]),
        ("directors_3_z", run["directors"][:, 2, 2]),
    ):
        assert list(map(float, table[name])) == values.values.tolist()
    assert table["load_work [J]"] == ("", *map(repr, run["load_work"].values.tolist()))
    assert table["newton_iterations"] == ("", *map(str, run["newton_iterations"].values))


def test_npz_and_json_columns(files, tmp_path):
    """And what is not finite is null in JSON."""
    run = open_run(files / "top.nc")
    ended(0, "export", files / "top.nc", "--to", "npz", "--out", tmp_path / "top.npz")
    with np.load(tmp_path / "top.npz", allow_pickle=False) as arrays:
        assert np.array_equal(arrays["moment_z [N m]"], run["moment"][:, 2])
        assert np.array_equal(arrays["midtime [s]"], run["midtime"])
        assert json.loads(arrays["record"].item())["run_file"] == "[body]\n# é\n"
    run["twist_rate"][1] = np.nan
    save_run(run, tmp_path / "run.nc")
    data = json.loads(nontwist("export", tmp_path / "run.nc", "--to", "json").stdout, parse_constant=pytest.fail)
    assert data["columns"]["time [s]"] == run["time"].values.tolist()
    assert data["columns"]["kinetic_energy [J]"] == run["kinetic_energy"].values.tolist()
    assert data["columns"]["twist_rate [rad s-1]"][1] is None
    assert data["record"]["integrator"] == {"name": "split", "order": 4}


def table_of(*arguments):
    return pandas.read_csv(io.StringIO(nontwist("export", *arguments).stdout))


@pytest.mark.parametrize(("name", "kind"), [("twist", "csv"), ("free", "json"), ("free", "npz"), ("tangents", "csv")])
def test_angles_are_exported_in_degrees(files, tmp_path, name, kind):
    """All others are as without the option, to the bit: solid angles, and ∂Λ/∂Λ, which is rad per rad."""

    def exported(*options):
        place = tmp_path / f"a.{kind}"
        ended(0, "export", files / f"{name}.nc", "--force", "--out", place, *options)
        if kind == "csv":
            return {header: column.values for header, column in pandas.read_csv(place).items()}
        if kind == "json":
            return json.loads(place.read_text(encoding="utf-8"))["columns"]
        return {header: column for header, column in np.load(place).items() if header != "record"}

    plain, turned = exported(), exported("--degrees")
    assert (sum(header.startswith("d_") for header in plain) >= 18) == (name == "tangents")
    angles = {one: one.replace("[rad", "[degree") for one in plain if re.search(r"^(?!d_).*\[rad\b", one)}
    assert len(angles) >= 3
    assert [angles.get(header, header) for header in plain] == list(turned)
    for header, column in plain.items():
        scale = 180 / np.pi if header in angles else 1.0
        found = np.asarray(turned[angles.get(header, header)], dtype=float)
        assert found == pytest.approx(scale * np.asarray(column, dtype=float), rel=1e-15, abs=0, nan_ok=True)


def test_twist_is_exported_in_degrees(files, tmp_path):
    columns = "twist_angle,twist_rate,swing_twist_angle,solid_angle,path_length,error_estimate,noise_estimate"
    ended(0, "twist", files / "free.nc", "--csv", "--degrees", "--no-figure", "--out", tmp_path / "o")
    assert np.array_equal(open_run(tmp_path / "o.nc").twist_angle, open_run(files / "twist.nc").twist_angle)
    one, other = pandas.read_csv(tmp_path / "o.csv"), table_of(tmp_path / "o.nc", "--degrees", "--columns", columns)
    assert "twist_rate [degree s-1]" in one
    assert one[sorted(one)].equals(other[sorted(other)])


def test_chosen_columns_have_times(files):
    """With decimal commas for spreadsheets, where wanted."""
    place = files / "free.nc"
    plain = nontwist("export", place, "--columns", "kinetic_energy, angular_velocity").stdout
    header, *rows = csv.reader(plain.splitlines())
    assert header == ["time [s]", "kinetic_energy [J]", *(f"angular_velocity_{axis} [rad s-1]" for axis in "xyz")]
    assert [float(row[1]) for row in rows] == open_run(place).kinetic_energy.values.tolist()
    columns = ["--columns", "time,kinetic_energy, angular_velocity"]
    assert ended(0, "export", place, *columns).stdout == plain
    comma = nontwist("export", place, *columns, "--decimal-comma").stdout
    assert comma == plain.replace(",", ";").replace(".", ",")
    unknown = ended(2, "export", place, "--columns", "kinetic_energi").stderr
    assert "there is no variable 'kinetic_energi'; did you mean kinetic_energy? known are directors, " in unknown


def test_info_of_chosen_variables(files, tmp_path):
    place = tmp_path / "some variables.nc"
    save_run(open_run(files / "free.nc")[["kinetic_energy"]], place)
    result = ended(0, "info", place)
    assert "drift" not in result.stdout
    assert "kinetic energy" in result.stdout
    assert f"next: nontwist export '{place}' --out" in result.stderr  # not view, which needs more of them
    run = open_run(files / "free.nc")
    for other in (run.isel(time=[3]), twist(run, axis_frame="space"), twist(nt.rotation(run))):
        save_run(other, place, force=True)
        assert f"next: nontwist export '{place}' --out" in ended(0, "info", place).stderr
        ended(3, "view", place)


def test_view_of_parts(files, tmp_path):
    """Refused in words where nothing moves; a run that ends in NaN, or is rounded, is shown."""
    run, place = open_run(files / "top.nc"), tmp_path / "part.nc"
    for code, part in (
        (3, run.isel(time=3)),
        (3, run.isel(time=[])),
        (3, run.drop_vars("time")),
        (0, run.where(run.time < 0.5)),
        (0, run.astype("float32")),
    ):
        save_run(part, place, force=True)
        ended(code, "view", place, "--force", "--out", tmp_path / "part.html")


def test_export_of_thinned_runs(files, tmp_path):
    """Lines of a table are states: what belongs to intervals between others is not written beside them."""
    run = open_run(files / "top.nc")
    save_run(run.isel(time=slice(None, None, 3)), place := tmp_path / "thin.nc")
    assert "not those between its states" in ended(3, "export", place).stderr
    assert (
        table_of(place, "--columns", "kinetic_energy")["kinetic_energy [J]"].tolist()
        == run.kinetic_energy[::3].values.tolist()
    )
    save_run(run.isel(time=slice(3, 7)), tmp_path / "part.nc")
    assert table_of(tmp_path / "part.nc")["load_work [J]"][1:].tolist() == run.load_work[3:6].values.tolist()


@pytest.mark.parametrize("kept", [{}, {"variables": (), "reduce": "extrema"}, {"variables": "all"}])
def test_ensembles(tmp_path, kept):
    W = [(1, 2, 0), (2, 1, 0)]
    many = nt.simulate_ensemble(nontwisting([3, 4, 5]), t_end=1, step=0.1, material_angular_velocity=W, **kept)
    save_run(many, tmp_path / "many.nc")
    told = ended(0, "info", tmp_path / "many.nc", "--json")
    assert {name: json.loads(told.stdout)[name] for name in ("members", "failed")} == {"members": 2, "failed": 0}
    assert ended(0, "info", tmp_path / "many.nc").stderr.split()[1:3] == ["nontwist", "export"]
    lines = list(csv.reader(io.StringIO(ended(0, "export", tmp_path / "many.nc").stdout)))
    if "reduce" in kept:
        assert float(lines[2][lines[0].index("kinetic_energy_max [J]")]) == many.kinetic_energy_max[1]
    else:
        assert float(lines[2][lines[0].index("quaternion_1_w")]) == many.quaternion[1, -1, 3]
    assert "2 runs" in ended(3, "view", tmp_path / "many.nc").stderr


@pytest.mark.parametrize("width", [60, 120])
def test_tables_cut_no_name(files, width):
    shown = nontwist("info", files / "top.nc", COLUMNS=str(width))
    assert "…" not in shown.stdout.replace(" … (", "")  # of a text of several lines the first is shown
    for name in open_run(files / "top.nc"):
        assert f"│ {name} " in shown.stdout, name
    assert max(map(len, shown.stdout.splitlines())) <= width
    assert shown.stderr.startswith("next: nontwist view ")
    ended(0, "info", files / "top.nc", COLUMNS="9")  # no room for a word of each column


def test_tables_fit_the_terminal(capsys, monkeypatch):
    """A word that is wider is folded; a title may be wider than its table."""
    monkeypatch.setenv("COLUMNS", "30")
    print_rows("title", {"name": "a" * 40})
    shown = capsys.readouterr().out
    assert shown.count("a") == 41
    assert max(map(len, shown.splitlines())) == 30
    monkeypatch.setenv("COLUMNS", "60")
    title = "a body with a long title, which is wider than the table"
    print_rows(title, {"a": "b"})
    assert capsys.readouterr().out.splitlines() == [title, "┌───┬───┐", "│ a │ b │", "└───┴───┘"]
    units = {"kg m2 s-1": "kg m² s⁻¹", "rad s-1": "rad/s", "N m": "N m", "1": "", "s-1": "s⁻¹", "degree": "°"}
    assert {unit: shown_unit(unit) for unit in units} == units


def test_sealed_file_without_times(files, tmp_path):
    """And one without a title is told of."""
    path, version = tmp_path / "run.nc", {"format_version": 1}
    for command, data in (
        ("info", xarray.Dataset({"a": ("x", [1.0, 2.0])}, attrs=version)),
        ("export", open_run(files / "free.nc").isel(time=3)),
        ("info", xarray.Dataset({"a": ("time", [1.0, 2.0])}, attrs=version)),
    ):
        save_run(data, path, force=True)
        wanted = f"{path} does not contain a run: it has no coordinate time with its states along it\n"
        assert ended(3, command, path).stderr == wanted
    save_run(xarray.Dataset({"a": ("time", [1.0, 2.0])}, {"time": [0.0, 1.0]}, version), path, force=True)
    assert "0 s to 1 s, 2 stored states" in ended(0, "info", path).stdout


@pytest.mark.long  # in the quick suite: commands/test_run_command.py, a closed pipe
@pytest.mark.skipif(os.name != "posix", reason="a shell with head")
def test_reader_stops_early(files):
    assert len(nontwist("export", files / "free.nc").stdout) > 76_000  # more than a pipe and head take
    command = f"{sys.executable} -m nontwist export {files / 'free.nc'} | head -n 3; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    assert (done.stderr, len(lines), lines[-1]) == ("", 4, "0")


PULSED = """
body = { kind = "standard", inertia = [1, 2, 3] }
start = { angular_velocity = { body = [1, 2, 3] } }
time = { t_end = 4, tolerance = 1e-6 }
load = [{ kind = "pulse", frame = "body", amplitude = [1, 0, 0], end = 0.7 }]
"""


def test_exported_counts_equal_printed_ones(write, tmp_path):
    t = 293.58 + 0.1 * np.arange(60)
    assert repr(float(t[-1])) == "299.47999999999996"
    save_run(twist(np.tile([0.0, 0, 0, 1], (60, 1)), t, scalar_first=False), tmp_path / "twist.nc")
    assert "293.58 s to 299.48 s, 60 stored states" in nontwist("info", tmp_path / "twist.nc").stdout
    ran = nontwist("run", write(PULSED), "--out", tmp_path / "run.nc").stdout
    steps = next(line for line in ran.splitlines() if "steps" in line).split("│")[2].strip()
    assert " of at most " in steps
    assert steps in nontwist("info", tmp_path / "run.nc").stdout
