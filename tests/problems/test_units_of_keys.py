"""Units of the keys of run files, which axes of figures and headers of tables show."""

import pytest

from nontwist.runfile import read_run_file
from nontwist.runfile.document import unit_of
from nontwist.units import MOMENT

FILE = """
body = { kind = "heavy_top", inertia = [2, 2, 1], mass = 2.0, centre_of_mass = [0, 0, 0.3], gravity = [0, 0, -9.81] }
start = { angular_velocity = { body = [0, 1, 2] } }
time = { t_end = 2 }
load = [
    { kind = "damping", coefficient = 0.1 },
    { kind = "sine", frame = "body", amplitude = [0, 0, 1], frequency = 2, scale = 3 },
    { kind = "rotor", axis = "z", momentum = 2 },
    { kind = "spring", stiffness = 2, point = [0, 0, 1], anchor = [0, 0, 2] },
]
"""
SHAPE = """
body = { kind = "standard", inertia = { cuboid = { mass = 2.0, lengths = [0.1, 0.2, 0.3] } } }
time = { t_end = 1 }
"""
EXPECTED = {
    "body.mass": "kg",
    "body.centre_of_mass.2": "m",
    "body.gravity": "m s-2",
    "body.inertia.1": "kg m2",
    "start.angular_velocity.body.2": "rad s-1",
    "time.t_end": "s",
    "load.0.coefficient": "N m s",
    "load.1.amplitude.0": "N m",
    "load.1.frequency": "Hz",
    "load.1.phase": "rad",
    "load.1.scale": None,
    "load.2.momentum": "kg m2 s-1",
    "load.2.axis": None,
    "load.3.stiffness": "N m-1",
    "nothing.of.this": None,
}


def test_the_units_of_keys(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(FILE, encoding="utf-8")
    assert {key: unit_of(read_run_file(path), key) for key in EXPECTED} == EXPECTED
    units = ["start.angular_velocity.unit='rpm'", "start.rotation={ vector = [0, 0, 1], unit = 'deg' }"]
    turned = read_run_file(path, units)
    assert unit_of(turned, "start.angular_velocity.body.2") == "rpm"
    assert unit_of(turned, "start.rotation.vector.2") == "degree"
    path.write_text(SHAPE, encoding="utf-8")
    assert unit_of(read_run_file(path), "body.inertia.cuboid.lengths.0") == "m"


def test_moments_of_force_and_arm():
    g, lb = 9.80665, 0.45359237
    forces = {"N": 1, "mN": 1e-3, "µN": 1e-6, "kN": 1e3, "MN": 1e6, "lbf": lb * g, "ozf": lb * g / 16}
    forces |= {"kgf": g, "gf": g / 1000}
    arms = {"m": 1, "cm": 0.01, "mm": 1e-3, "ft": 0.3048, "in": 0.0254}
    both = {force + arm: size * length for force, size in forces.items() for arm, length in arms.items()}
    assert pytest.approx({unit: both[unit] for unit in MOMENT}, rel=1e-7) == MOMENT
