"""Gyrostats: rotors of constant and of changing momentum, by every integrator that takes them."""

import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nontwist import heavy_top, open_run, rotation, rotor, save_run, simulate, standard
from nontwist.analysis.invariants import drifts
from nontwist.errors import RunFileError
from nontwist.integrators import EnergyMomentum, LieMidpoint
from nontwist.loads.kinds import load_of
from nontwist.runfile import read_run_file
from refusals import refused_as, says

J = np.array([[3, 0.2, 0.1], [0.2, 4, -0.3], [0.1, -0.3, 5.0]])
W0 = np.array([0.4, -1.1, 0.7])
pytestmark = pytest.mark.filterwarnings("ignore:.*breakpoint", "ignore:.*rad a step")


@pytest.mark.parametrize(
    ("scheme", "order", "bound"), [("gauss", 8, 1e-11), ("gauss", 4, 2e-7), ("lie-midpoint", 2, 1e-3)]
)
def test_symmetric_body_with_accelerating_wheel(scheme, order, bound):
    """Of J = diag(A, A, C) with the rotor along d3, C W3 + h is constant, and d3 precesses at |π|/A about π."""
    A, C, times, h = 3.0, 4.0, [0.5, 1.0], [0.0, 6.0]
    how = {"t_end": 2, "step": 0.025, "material_angular_velocity": (1, 0.5, 2), "load": rotor((0, 0, 1), times, h)}
    run = simulate(standard([A, A, C]), integrator=scheme, order=order, **how)
    W3, d3 = run.material_angular_velocity.values[:, 2], run.directors.values[:, 2]
    assert abs(C * W3 + np.interp(run.time, times, h) - 8).max() < 1e-13
    exact = Rotation.from_rotvec(np.outer(run.time, run.total_momentum.values[0] / A)).apply(d3[0])
    assert abs(d3 - exact).max() < bound


def test_newton_where_fixed_points_fail():
    """A fast wheel: 40 rad of nutation in a step of 0.5 s."""
    load, how = rotor((1, 0, 1), 300.0), {"t_end": 2, "step": 0.5, "material_angular_velocity": (0.1, 0.2, -0.1)}
    run = simulate(standard([3, 4, 5]), load=load, order=16, **how)
    K, total = run.kinetic_energy.values, run.total_momentum.values
    assert run.newton_iterations.values.max() > 3
    assert abs(K - K[0]).max() < 1e-12
    assert abs(total - total[0]).max() < 1e-11


def test_kept_and_recorded(tmp_path):
    top, wheel = heavy_top([2, 2.2, 1], 1.5, (0.1, 0, 0.6)), rotor((0, 0, 1), 4.0)
    load = 2 * rotor((0, 0, 2), [0, 1], [0.0, 1.5])
    cases = (top, wheel, (1, 2, 5), ["K+V−A", "(π+Λh)·g", "d·d"]), (standard(J), load, W0, ["K−A", "π+Λh", "d·d"])
    for body, one, W, symbols in cases:
        run = simulate(body, t_end=2, material_angular_velocity=W, load=one)
        found = drifts(run)
        assert [one.symbol for one in found.values()] == symbols
        assert max(one.relative for one in found.values()) < 1e-13
    assert load_of(json.loads(run.attrs["load"])) == load
    assert run.rotor_momentum.values[[0, -1]].tolist() == [[0, 0, 0], [0, 0, 3]]
    save_run(run, tmp_path / "run.nc")
    assert (open_run(tmp_path / "run.nc").total_momentum.values == run.total_momentum.values).all()
    assert "rotor_momentum" not in simulate(standard(J), t_end=2, material_angular_velocity=W0)
    assert repr(load) == "<Load: rotor about (0, 0, 1), table of 2 momenta from 0 to 3 kg m² s⁻¹>"
    assert repr(rotor((1, 0, 0), 2)) == "<Load: rotor of 2 kg m² s⁻¹ about (1, 0, 0)>"
    assert rotor((1, 0, 0), np.arange(30), np.ones(30)).terms[0].varying == ["rotor", "values"]  # however many


@pytest.mark.parametrize("scheme", [LieMidpoint, EnergyMomentum])
def test_dissipation_keeps_total_momentum(scheme):
    how = {"t_end": 50, "step": 0.1, "material_angular_velocity": W0, "load": rotor((1, 0, 2), 3.0)}
    run = simulate(standard(J), integrator=scheme(1, dissipation=0.7), **how)
    total, K = run.total_momentum.values, run.kinetic_energy.values
    assert np.diff(K).max() < 1e-14
    assert K[-1] < 0.9 * K[0]
    assert abs(total - total[0]).max() < 2e-13


test_refusals = refused_as([lambda: rotor((0, 0, 1), [0, 1]), lambda: rotor((0, 0, 1), [0], [1.0])])


WHEEL = """
body = { kind = "standard", inertia = [3, 4, 5] }
time.t_end = 25
[[load]]
kind = "rotor"
axis = "z"
file = "wheel.csv"
"""


def test_momentum_from_a_file(write):
    """A body at rest turns back by ∫ h dt / J."""
    write("t (s);h (kg m² s⁻¹);speed (rpm)\n0;0,0;0\n5;1,0;9\n10;0,0;0\n", "wheel.csv")
    file = read_run_file(write(WHEEL + 'columns = ["t (s)", "h (kg m² s⁻¹)"]\nscale = 2\n'))
    assert file.load[0].in_words(file._folder) == "rotor (wheel.csv: 3 rows, 0 s to 10 s, up to 2 kg m² s⁻¹)"
    assert rotation(simulate(file.problem))[-1].as_rotvec() == pytest.approx([0, 0, -10 / 5], abs=1e-12)
    assert re.search(r'sha256 = "[0-9a-f]{64}"', file.text())


ACCEPTED = "h (N m s)", "h (kg m² s⁻¹)", "h (kg m2/s)", "h (Nms)", "h (kg·m²/s)", "h (kg m^2 s^-1)", "h", "momentum"
REFUSED = "N mm s", "g cm²/s", "rad/s", "RPM", "Hz", "lb ft s", "mN m s"


def test_units_of_momenta(write):
    path = write(WHEEL)
    for header in (*ACCEPTED, *(f"h ({unit})" for unit in REFUSED)):
        write(f"t (s),{header}\n0,0\n5,2\n", "wheel.csv")
        if header in ACCEPTED:
            assert read_run_file(path).problem.load.rotor_momentum([5])[0, 2] == 2, header
        else:
            with pytest.raises(RunFileError, match=r"states .*; times are in s, momenta in kg m² s⁻¹: convert it"):
                read_run_file(path)


@pytest.mark.parametrize("change", ["load.0.file=", "load.0.momentum=1", 'load.0.file="none.csv"', "load.0.scale=1"])
def test_bad_file_is_named(change, write):
    write("t (s),h,speed (rpm)\n0,0,0\n5,2,9\n", "wheel.csv")
    with says(RunFileError):
        read_run_file(write(WHEEL), [change])
