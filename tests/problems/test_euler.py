"""Euler angles and their rates in exports, angles and angular velocities of run files in other units."""

import json
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import STANDARD, ended, nontwist
from nontwist import save_run, simulate
from nontwist.geometry.attitudes import euler_angles
from nontwist.io.run_files import with_euler
from nontwist.runfile import read_run_file
from refusals import refused, warned

LETTERS = ["".join(x) for x in product("xyz", repeat=3) if x[0] != x[1] != x[2]]
TILTED = {"rotation": Rotation.from_euler("ZXZ", [0.3, 0.9, -0.4]), "material_angular_velocity": (0.3, 0.5, 0.8)}


@pytest.fixture(scope="module")
def run():
    return simulate(STANDARD, t_end=1, step=1e-3, **TILTED)


@pytest.mark.parametrize("letters", [*LETTERS, *(x.upper() for x in LETTERS)])
def test_angles_by_scipy(run, letters):
    found = with_euler(run, letters)
    angles, rates, h = found.euler_angles.values, found.euler_rates.values, 1e-3
    assert np.array_equal(angles, Rotation.from_quat(run.quaternion.values).as_euler(letters))
    smooth = np.unwrap(angles, axis=0)
    by_differences = (8 * (smooth[3:-1] - smooth[1:-3]) - smooth[4:] + smooth[:-4]) / (12 * h)
    assert np.allclose(rates[2:-2], by_differences, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("letters", "middle"), [("ZXZ", 0.0), ("zyz", np.pi), ("ZYX", np.pi / 2), ("xyz", -np.pi / 2)])
def test_gimbal_lock(letters, middle):
    start = {"rotation": Rotation.from_euler(letters, [0.2, middle, 0.4]), "material_angular_velocity": (1, 2, 3)}
    run = simulate(STANDARD, t_start=0.25, t_end=1, step=0.25, **start)
    with warned("gimbal-lock") as said:
        found = with_euler(run.isel(time=[2, 0, 1]), letters)
    assert said[0].fields == {"letters": letters, "count": 1, "along": "time", "first": "0.25"}
    assert np.argwhere(np.isinf(found.euler_rates.values)).tolist() == [[1, 0], [1, 2]]
    assert not np.isnan(found.euler_rates.values).any()
    turned = Rotation.from_euler(letters, found.euler_angles.values[1])
    assert (turned.inv() * start["rotation"]).magnitude() < 1e-7


def test_the_export_has_them(run, here):
    save_run(run, "run.nc")
    shown = nontwist("export", "run.nc", "--euler", "ZXZ", "--degrees", "--columns", "kinetic_energy", "--to", "json")
    columns = json.loads(shown.stdout)["columns"]
    names = [f"euler_{x}_{k} [degree{per}]" for x, per in (("angles", ""), ("rates", " s-1")) for k in (1, 2, 3)]
    assert list(columns) == ["time [s]", "kinetic_energy [J]", *names]
    assert np.allclose([columns[name][0] for name in names[:3]], np.degrees([0.3, 0.9, -0.4]))
    for wrong in ("ZxZ", "ZZX", "ZX", "ABC", "", "ZXZX"):
        with refused("euler", letters=wrong):
            euler_angles(np.array([[0, 0, 0, 1.0]]), np.zeros((1, 3)), wrong)
    assert "--euler requires 3 axes" in ended(3, "export", "run.nc", "--euler", "ZxZ").stderr
    locked = simulate(STANDARD, t_end=1, step=0.5, material_angular_velocity=(1, 2, 3))
    save_run(locked, "locked.nc")
    shown = nontwist("export", "locked.nc", "--euler", "ZXZ", "--out", "locked.csv")
    assert "third angle are infinite there; another --euler avoids it" in " ".join(shown.stderr.split())
    assert ",inf," in (here / "locked.csv").read_text(encoding="utf-8").splitlines()[1] + ","


FILE = """
body = { kind = "standard", inertia = [3.0, 4.0, 5.0] }
time = { t_end = 1.0, step = 0.1 }
integrator.name = "gauss"
[start]
rotation = { euler = [10, 20, 30], sequence = "ZXZ", unit = "deg" }
angular_velocity = { body = [30.0, 0.0, 60.0], unit = "deg/s" }
"""


@pytest.mark.parametrize(("unit", "factor"), [("deg/s", np.pi / 180), ("rpm", np.pi / 30)])
def test_run_files_take_other_units(write, unit, factor):
    run = simulate(read_run_file(write(FILE.replace("deg/s", unit))).problem)
    assert np.allclose(run.material_angular_velocity.values[0], factor * np.array([30, 0, 60]), rtol=1e-15)
    turned = Rotation.from_euler("ZXZ", [10, 20, 30], degrees=True)
    assert (Rotation.from_quat(run.quaternion.values[0]) * turned.inv()).magnitude() < 1e-15
