"""Power series of solutions, and their derivatives, by the text of the rates."""

import mpmath
import numpy as np

from nontwist.kernels.dual import Dual
from nontwist.kernels.kernel import kernel
from nontwist.kernels.series import Recurrence

ORDER = 12


def exponential(out):
    """Write the coefficients of the solution of ``x' = k (x - x²)``, x(0) = 2, k = 3, and what x(0) and k change."""
    recurrence = Recurrence(ORDER, 2)
    x, k = recurrence.unknown(), Dual(3.0, [0.0, 1.0])
    x.put(0, Dual(out[0], [1.0, 0.0]))
    recurrence.solve([x], [k * (x - x * x)])
    for n in range(ORDER + 1):
        for j, number in enumerate((x[n].value, *x[n].tangents)):
            out[3 * n + j] = number
    at = x.at(0.01)
    for j, number in enumerate((at.value, *at.tangents)):
        out[3 * (ORDER + 1) + j] = number


def test_series_solve_an_equation_that_has_a_closed_form():
    """``x = 1 / (1 - a e^(-kt))`` with a = 1 - 1/x(0)."""
    out = np.full(3 * (ORDER + 2), 2.0)
    kernel("f8[:]")(exponential)(out)
    with mpmath.workdps(40):

        def x(t):
            return 1 / (1 - mpmath.exp(-3 * t) / 2)

        def by_start(t):
            return mpmath.exp(-3 * t) * x(t) ** 2 / 4

        def by_factor(t):
            return -t * mpmath.exp(-3 * t) * x(t) ** 2 / 2

        for column, true in enumerate((x, by_start, by_factor)):
            series = np.array(mpmath.taylor(true, 0, ORDER), dtype=float)
            np.testing.assert_allclose(out[: 3 * (ORDER + 1)].reshape(-1, 3)[:, column], series, rtol=1e-13)
            assert abs(out[column - 3] - float(true(mpmath.mpf("0.01")))) < 1e-15


def test_series_on_floats_are_those_of_the_machine():
    by_machine, by_floats = np.full(3 * (ORDER + 2), 2.0), np.full(3 * (ORDER + 2), 2.0)
    kernel("f8[:]")(exponential)(by_machine)
    exponential(by_floats)
    np.testing.assert_array_equal(by_machine, by_floats)
