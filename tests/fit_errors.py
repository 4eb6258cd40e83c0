"""Recordings to fit; how far fits are off; derivatives by differences, and files."""

import numpy as np
from scipy.spatial.transform import Rotation

from nontwist import fit_inertia, sensors, simulate
from nontwist.fitting.shooting import residuals, stacked
from nontwist.fitting.telling import quantile

FREE = np.array([[0.30, 0.02, -0.01], [0.02, 0.25, 0.03], [-0.01, 0.03, 0.45]])  # kg m², of a thrown body
PIVOTED = np.array([[0.020, 0.001, -0.0005], [0.001, 0.022, 0.0008], [-0.0005, 0.0008, 0.004]])  # of one on a pivot
MASS, CENTRE = 0.5, np.array([0.03, -0.02, -0.15])
HEADER = "time (s),gx (rad/s),gy (rad/s),gz (rad/s)"
TURNED = f"{HEADER},qx,qy,qz,qw"


def recorded(body, seconds, start, *, sensor=None, **how):
    """Return what a gyroscope reads of a motion from this W: 200 times a second, with noise."""
    run = simulate(body, t_end=seconds, step=1 / 400, material_angular_velocity=start, **how)
    return sensors.gyroscope(run, **{"noise": 1.2e-4, "rate": 200} | (sensor or {}))


def whole(recording, **how):
    return fit_inertia(recording, interval="all", **how)


def begun(rng, fastest=16):
    """Return how a body is thrown: turned anyhow, with 8 rad/s at least."""
    W = rng.normal(size=3)
    W *= rng.uniform(8, fastest) / np.linalg.norm(W)
    return {"rotation": Rotation.random(rng=rng), "material_angular_velocity": W}


def tilted(attitudes, tilt, rng):
    """Return attitudes with noise."""
    return attitudes * Rotation.from_rotvec(tilt * rng.normal(size=(len(attitudes), 3)))


def off_by(rng):
    """Return a bias and a scale of a gyroscope."""
    return {"bias": 0.02 * rng.normal(size=3), "scale": 1 + 0.01 * rng.normal()}


def off(fit, inertia):
    """Return the errors of the moments and ratios in standard errors."""
    true = np.linalg.eigvalsh(inertia)
    found = fit.principal
    value = np.concatenate([found.moments, found.ratios])
    half = np.diff(np.concatenate([found.intervals, found.ratio_intervals]))[:, 0] / 2
    return (value - np.concatenate([true, true[:2] / true[2]])) / half * quantile(fit.solution)


def farthest(fit, inertia):
    return abs(off(fit, inertia)).max()


def assert_as_wide(deviations):
    """Require errors in standard errors to be about 1, as those of a right model with right intervals are."""
    assert abs(np.array(deviations)).max() < 4
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.5


def share_covered(fits):
    """Return which part of the intervals of fits hold the true inertias; almost all recordings must determine it."""
    found = [abs(off(fit, inertia)) < quantile(fit.solution) for fit, inertia in fits if not fit.untold]
    assert len(found) > 110
    return np.mean(found)


def all_residuals(problem, at):
    """Return the residuals at some unknowns, and their derivatives by all."""
    rates, attitudes, beside = residuals(problem, at)
    return stacked([*rates, *attitudes, *beside], problem.columns)


def differences(problem, at):
    """Return the derivatives of the residuals, and what central differences make of them."""
    x, found = at.flat, []
    for e in 1e-6 * np.diag(np.maximum(1, abs(x))):
        ahead, behind = (all_residuals(problem, problem.unknowns(x + sign * e))[0] for sign in (1, -1))
        found.append((ahead - behind) / 2 / e.sum())
    return all_residuals(problem, at)[1], np.stack(found, axis=1)


def apart(fit, problem=None):
    """Return how far a run of the problem of a fit is from the readings that were fitted, rad/s."""
    run = simulate(problem or fit.problem(), times=fit.parts[0].time)
    return abs(fit.scale * run.material_angular_velocity.values + fit.bias - fit.parts[0].model).max()


def csv(path, header, *columns):
    """Write a recording to a file, and return its path."""
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")
    return str(path)
