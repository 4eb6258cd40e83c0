"""How far fits are off, what is said of those that are refused, derivatives, and files."""

import numpy as np
import pytest

from nontwist.fitting.shooting import residuals, stacked
from nontwist.fitting.telling import quantile


def off(fit, inertia):
    """Return the errors of the moments and ratios in standard errors."""
    true = np.linalg.eigvalsh(inertia)
    found = fit.principal
    value = np.concatenate([found.moments, found.ratios])
    half = np.diff(np.concatenate([found.intervals, found.ratio_intervals]))[:, 0] / 2
    return (value - np.concatenate([true, true[:2] / true[2]])) / half * quantile(fit.solution)


def message(call, *arguments, **options):
    with pytest.raises(ValueError, match=r"\w") as caught:
        call(*arguments, **options)
    return str(caught.value)


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
    from nontwist import simulate

    run = simulate(fit.problem(), times=fit.parts[0].time)
    return fit.scale * run.material_angular_velocity.values + fit.bias


def csv(path, header, *columns):
    """Write a recording to a file, and return its path."""
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")
    return str(path)
