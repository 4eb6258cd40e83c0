"""Bodies on elliptic orbits: Kepler's equation in 50 digits, motion by SciPy."""

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from nontwist import gravity_gradient, sensitivities, simulate, simulate_ensemble, standard
from nontwist.errors import RunFileError
from nontwist.loads.potentials import on_orbit
from nontwist.runfile import read_run_file

ECCENTRICITIES = [1e-9, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999999, 1 - 1e-12, 1 - 2**-53]
n = 1.0
HYPERION = standard([1.0, 1.0 + 0.264 * 1.4, 1.4])  # Wisdom, Peale & Mignard 1984: (B - A)/C = 0.264
TUMBLING = {"rotation": Rotation.from_euler("zx", [0.3, 0.2]), "material_angular_velocity": (0.1, 0.2, 1.2)}


def kepler(M, e):
    """Return the place on the orbit in 50 digits, and |r|/a and E."""
    with mp.workdps(50):
        e, m = mp.mpf(e), mp.mpf(M)
        m -= 2 * mp.pi * mp.nint(m / (2 * mp.pi))
        E = min(abs(m) + e, abs(m) / (1 - e), mp.pi)
        for _ in range(200):
            E -= (E - e * mp.sin(E) - abs(m)) / (1 - e * mp.cos(E))
        r = 1 - e * mp.cos(E)
        y = mp.sign(m) * mp.sqrt(1 - e * e) * mp.sin(E)
        return r ** mp.mpf(-2.5) * (mp.cos(E) - e), r ** mp.mpf(-2.5) * y, float(r), float(E)


@pytest.mark.parametrize("e", ECCENTRICITIES)
def test_keplers_equation_to_round_off(e):
    """To what one last bit of the anomaly changes, wherever perigee is; of arrays as of numbers."""
    for M in (0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 2.0, 3.0, np.pi, -1.0, -3.0):
        (x, y), (X, Y, r, E) = on_orbit(M, e), kepler(M, e)
        turn = (np.sqrt((1 - e) * (1 + e)) + 1.5 * e * np.sin(E)) / r**2
        assert float(mp.hypot(x - X, y - Y)) * r**1.5 < 3 * 2.3e-16 * max(1.0, turn * max(abs(M), E))
    M = np.linspace(-20, 20, 41)
    assert np.allclose(on_orbit(M, 0.5), np.transpose([on_orbit(float(m), 0.5) for m in M]), rtol=0, atol=1e-14)


def test_planar_motion_of_hyperion():
    """θ'' = -3/2 n² (B - A)/C (a/r)³ sin 2(θ - f) (Wisdom, Peale & Mignard 1984), by SciPy."""
    e, t = 0.1, np.linspace(0, 4 * np.pi, 50)

    def rates(_, y):
        near = (1 + e * np.cos(y[2])) / (1 - e**2)  # a/r
        return y[1], -1.5 * 0.264 * near**3 * np.sin(2 * (y[0] - y[2])), np.sqrt(1 - e**2) * near**2

    truth = solve_ivp(rates, (0, t[-1]), (0.3, 1.2, 0.0), "DOP853", t, rtol=1e-13, atol=1e-13).y
    how = {"rotation": Rotation.from_euler("z", 0.3), "material_angular_velocity": (0, 0, 1.2), "times": t}
    run = simulate(HYPERION, load=gravity_gradient(n, eccentricity=e), tolerance=1e-11, **how)
    d1 = run.directors.values[:, 0]
    assert abs(np.unwrap(np.arctan2(d1[:, 1], d1[:, 0])) - truth[0]).max() < 1e-9
    assert abs(run.material_angular_velocity.values - np.outer(truth[1], [0, 0, 1])).max() < 1e-9


def test_libration_of_mercury():
    """35.8" with the period of the orbit, for (B - A)/C = 2.03e-4 (Margot et al., Science 316, 2007).

    That is 3/2 (B - A)/C (1 - 11e² + 959/48 e⁴), to 4e-4 here, what is left of powers of e and of the free libration.
    """
    e, ratio, t = 0.20563, 2.03e-4, np.linspace(0, 20 * np.pi, 2001)
    how = {"material_angular_velocity": (0, 0, 1.5), "times": t, "tolerance": 1e-12}
    run = simulate(standard([0.999, 0.999 + ratio, 1]), load=gravity_gradient(n, eccentricity=e), **how)
    d1 = run.directors.values[:, 0]
    beside = np.unwrap(np.arctan2(d1[:, 1], d1[:, 0])) - 1.5 * t
    slow = [(t / t[-1]) ** k for k in (1, 3, 5, 7)]  # the free libration, which takes 50 orbits
    found = np.linalg.lstsq(np.column_stack([*(np.sin(k * t) for k in range(1, 8)), *slow]), beside)[0]
    assert np.degrees(found[0]) * 3600 == pytest.approx(35.8, abs=0.05)
    assert found[0] == pytest.approx(1.5 * ratio * (1 - 11 * e**2 + 959 / 48 * e**4), rel=1e-3)


def test_perigee(write):
    later = gravity_gradient(0.7, (0, 1, 0), (1, 0, 0), 0.3, eccentricity=0.4)
    named = gravity_gradient(0.7, (0, 1, 0), (1, 0, 0), eccentricity=0.4, perigee_time=0.3)
    (term,), (same,) = later.terms, named.terms
    assert (term.start, term.eccentricity) == (same.start, same.eccentricity) == (0.3, 0.4)
    assert np.allclose(term.vectors_at(np.array([0.3]))[0, 0], [0, 0.6**-1.5, 0], rtol=0, atol=1e-14)
    apogee = term.vectors_at(np.array([0.3 + np.pi / 0.7]))[0, 0]
    assert np.allclose(apogee, [0, -(1.4**-1.5), 0], rtol=0, atol=1e-14)
    assert term.vectors_at(np.array([0.31]))[0, 0, 2] > 0
    assert term.resolution == pytest.approx(0.3 / 0.7 * 0.6**1.5 / 1.4**0.5)
    assert gravity_gradient(0.7).terms[0].resolution == 0.3 / 0.7
    text = (
        'body = { kind = "standard", inertia = [3, 4, 5] }\ntime = { t_end = 1 }\n[[load]]\nkind = "gravity_gradient"\n'
    )
    with pytest.raises(RunFileError) as told:
        read_run_file(write(text + "mean_motion = 0.7\neccentricity = 0.4\nperigee_time = 0.3\n"))
    (fault,) = told.value.problems
    assert (fault.key, fault.accepted.split("?")[0]) == ("load.0.perigee_time", "did you mean start")
    with pytest.raises(ValueError, match="perigee_time = inf is not finite"):
        gravity_gradient(0.7, eccentricity=0.4, perigee_time=np.inf)


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
def test_derivatives_on_an_ellipse(scheme):
    how = {"t_end": 2, "step": 0.05, "integrator": scheme, **TUMBLING}
    wrt = ["mean_motion", "eccentricity", "inertia", "duration"]
    found = sensitivities(HYPERION, load=gravity_gradient(n, eccentricity=0.9), wrt=wrt, **how)
    columns = found.d_material_angular_velocity.values[-1]
    for k, (dn, de) in enumerate([(1, 0), (0, 1)]):
        loads = [gravity_gradient(n + x * dn, eccentricity=0.9 + x * de) for x in (1e-5, -1e-5)]
        ahead, behind = (simulate(HYPERION, load=load, **how).material_angular_velocity.values[-1] for load in loads)
        assert np.allclose(columns[:, k], (ahead - behind) / 2e-5, rtol=1e-5, atol=1e-7)
    with pytest.raises(ValueError, match="unknown parameter 'eccentricity'"):
        sensitivities(HYPERION, load=gravity_gradient(n), wrt=["eccentricity"], **how)


FILE = """
body = { kind = "standard", inertia = [1.0, 2.0, 6.0], physical = false }
start.angular_velocity = { body = [0.1, 0.0, 1.2] }
time = { t_end = 2.0, step = 0.05 }
load = [{ kind = "gravity_gradient", mean_motion = 1.0, eccentricity = 0.4 }]
"""


def test_ensembles_and_run_files(write):
    W, how = (0.1, 0, 1.2), {"t_end": 2, "step": 0.05, "load": gravity_gradient(1.0, eccentricity=0.4)}
    body = standard([1, 2, 6], physical=False)
    run = simulate(body, material_angular_velocity=W, **how)
    many = simulate_ensemble(body, material_angular_velocity=[W, W], **how)
    assert abs(many.quaternion.values[1, -1] @ run.quaternion.values[-1]) == pytest.approx(1, abs=1e-13)
    assert np.array_equal(simulate(read_run_file(write(FILE)).problem).directors.values, run.directors.values)
