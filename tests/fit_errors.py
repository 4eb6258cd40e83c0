"""How far fits are off, and what is said of those that are refused."""

import numpy as np
import pytest

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
