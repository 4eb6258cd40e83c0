"""Recordings to fit; how far fits are off; derivatives by differences, and files."""

import numpy as np

from nontwist import sensors, simulate
from nontwist.fitting.shooting import residuals, stacked
from nontwist.fitting.telling import quantile


def recorded(body, seconds, start, *, sensor=None, **how):
    """Return what a gyroscope reads of a motion from this W: 200 times a second, with noise."""
    run = simulate(body, t_end=seconds, step=1 / 400, material_angular_velocity=start, **how)
    return sensors.gyroscope(run, **{"noise": 1.2e-4, "rate": 200} | (sensor or {}))


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


def model_of(fit):
    """Return what the gyroscope reads of the motion that was fitted, as a run of its problem."""
    run = simulate(fit.problem(), times=fit.parts[0].time)
    return fit.scale * run.material_angular_velocity.values + fit.bias


def csv(path, header, *columns):
    """Write a recording to a file, and return its path."""
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")
    return str(path)
