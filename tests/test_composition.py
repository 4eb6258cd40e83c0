"""The coefficients of the compositions against the conditions that they must fulfil."""

from math import fsum, prod

import numpy as np
import pytest

from nontwist.integrators.split import HALVES, fractions, nodes

ODD = {2: (1,), 4: (1, 3), 6: (1, 3, 5)}


@pytest.mark.parametrize("order", HALVES)
def test_power_sums(order):
    """Σ γ = 1 and Σ γ³ = Σ γ⁵ = ... = 0: the conditions of a linear problem."""
    gamma = fractions(order)
    for power in ODD[order]:
        assert fsum(g**power for g in gamma) == pytest.approx(float(power == 1), abs=1e-15)
    assert np.array_equal(gamma, gamma[::-1])
    assert len(gamma) == {2: 1, 4: 5, 6: 9}[order]


@pytest.mark.parametrize("order", HALVES)
def test_conditions_of_nested_sums(order):
    """Σ_k γ_k^a Π_b (Σ'_{j≤k} γ_j^b) = 0 with Σ' counting its last term half: the conditions of a nonlinear problem.

    Hairer, Lubich, Wanner, sec. V.3.1, after Murua and Sanz-Serna; those that symmetry does not fulfil have odd weight.
    """
    gamma = fractions(order)

    def partial(power):
        return np.cumsum(gamma**power) - gamma**power / 2

    for a, inner in [(3, (1, 1)), (5, (1, 1)), (3, (1, 1, 1, 1)), (3, (3, 1)), (1, (3, 3))]:
        total = fsum(gamma**a * prod(partial(b) for b in inner))
        if a + sum(inner) <= order:
            assert total == pytest.approx(0, abs=3e-15), (a, inner)
        elif order > 2:
            assert abs(total) > 1e-4, (a, inner)


@pytest.mark.parametrize("order", HALVES)
def test_the_loads_are_sampled_inside_the_step(order):
    c = nodes(order)
    assert c[0] == pytest.approx(fractions(order)[0] / 2)
    assert 0.05 < c.min() <= c.max() < 0.95
    assert c + c[::-1] == pytest.approx(1, abs=1e-15)
