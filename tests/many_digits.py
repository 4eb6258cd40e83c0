"""Comparison with mpmath in ulp, for the tests of S² and SO(3)."""

import mpmath as mp
import numpy as np
import pytest

EPS = np.finfo(float).eps


def exact(a):
    """Return an array, or a nested list of floats, as a matrix of mpmath."""
    return mp.matrix(np.asarray(a, dtype=float).tolist())


def mp_dot(a, b):
    return mp.fsum(x * y for x, y in zip(a, b, strict=True))


def mp_cross(a, b):
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length(a):
    """Return the root of the sum of squares of all entries."""
    return mp.sqrt(mp.fsum(x * x for x in a))


def ulps(got, expected, size):
    return float(length(exact(got) - expected) / (mp.mpf(EPS) * size)) if size else float(np.abs(got).max())


def assert_ulps(what, errors, bound=8.0):
    assert len(errors) > 20
    assert max(errors) <= bound, f"{what}: {max(errors):.2f} ulp"


@pytest.fixture(autouse=True)
def many_digits():
    with mp.workdps(80):
        yield
