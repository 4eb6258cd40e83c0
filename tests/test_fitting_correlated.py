"""Intervals where the residuals are correlated: simulated throws whose noise goes on for a 20th of the recording."""

import warnings

import numpy as np
import pytest
from scipy.special import stdtrit

from fit_errors import recorded, whole
from nontwist import damping, heavy_top, integrate, standard
from nontwist.fitting import reports, telling
from nontwist.fitting.solving import smeared

MOMENTS = np.array([1.0, 1.6, 2.1])


def noise(rng, n, samples):
    """Return noise of three axes, autoregressive of order 1, of this correlation time in samples."""
    phi, found = np.exp(-1 / samples), rng.normal(size=(n, 3))
    for k in range(1, n):
        found[k] = phi * found[k - 1] + np.sqrt(1 - phi**2) * found[k]
    return found


def fits(count, n=200, part=1 / 20):
    rng, t = np.random.default_rng(3), np.linspace(0, 2, n)
    for _ in range(count):
        W = rng.normal(size=3) * 4 + [3, 2, 4]
        run = integrate(standard(MOMENTS), times=t, material_angular_velocity=W, tolerance=1e-9)
        measured = run.material_angular_velocity + 0.03 * noise(rng, n, part * n)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield whole((t, measured))


def covered(count):
    """Return how often intervals of the ratios of the moments hold them, and those of white noise would."""
    true, found = MOMENTS[:2] / MOMENTS[2], []
    for fit in fits(count):
        half = np.diff(fit.principal.ratio_intervals, axis=1).ravel() / 2
        off = abs(fit.principal.ratios - true)
        if np.isfinite(half).all():  # else the throw does not determine them
            found.append([off < half, off < half / np.sqrt(fit.solution.inflation)])
    assert len(found) > 0.9 * count
    return np.mean(found, axis=(0, 2))


def test_intervals_allow_for_correlated_residuals():
    assert smeared(np.eye(5)[1], 0.5).tolist() == [0.5, 1, 0.5, 0.25, 0.125]
    ours, white = covered(6)
    assert ours >= 0.86
    assert white < 0.45


@pytest.mark.long
def test_intervals_of_95_percent_cover_as_often():
    ours, _ = covered(400)
    assert 0.90 <= ours <= 0.98


@pytest.mark.parametrize(("n", "part"), [(400, 1 / 600), (2000, 1 / 20)])
def test_slow_noise_is_called_correlated_and_no_misfit(n, part):
    (fit,) = fits(1, n, part)
    assert fit.is_explained
    assert not fit.is_white
    assert telling.quantile(fit.solution) == stdtrit(fit.solution.effective_samples - 12, 0.975)  # of J, W, bias, scale
    (said,) = fit.warnings
    assert said.startswith("the residuals are not white")


@pytest.mark.parametrize("drag", [0.01, 0.064])
def test_what_a_wrong_model_leaves_is_no_slow_noise(drag):
    """At the larger drag neighbours of what is new are uncorrelated by chance, but not every second sample."""
    sensor = {"noise": 1e-4, "rate": 400}
    recording = recorded(standard(MOMENTS), 2, (3, 8, 1), load=damping([drag] * 3), sensor=sensor)
    with pytest.warns(UserWarning, match="times what noise explains"):
        fit = whole(recording)
    assert fit.misfit > 10


def test_too_few_samples_count_for_intervals(monkeypatch):
    for module in (telling, reports):
        monkeypatch.setattr(module, "FEWEST", 200.0)  # about 60 are effective
    (free,) = fits(1)
    t, begin = free.parts[0].time, {"rotation": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "angular_velocity": (1, 2, 5)}
    pendulum = integrate(heavy_top([0.02, 0.022, 0.004], 0.5, (0, 0, -0.15)), times=t, tolerance=1e-9, **begin)
    measured = pendulum.material_angular_velocity + 0.003 * noise(np.random.default_rng(3), len(t), 20)
    with pytest.warns(UserWarning, match="not white"):
        swung = whole((t, measured), gravity={"mass": 0.5, "centre": (0, 0, -0.15)})
    for fit in (free, swung):
        assert np.isnan(fit.principal.ratio_intervals).all()
        assert "without an interval" in str(fit)
        assert fit.table()["residual"].endswith(" samples count: no intervals")
