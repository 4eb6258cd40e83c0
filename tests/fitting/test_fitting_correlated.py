"""Intervals where the residuals are correlated: simulated throws whose noise goes on for a part of the recording."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from fit_errors import recorded, whole
from nontwist import damping, heavy_top, integrate, rotation, standard
from nontwist.fitting import telling
from nontwist.fitting.shooting import correlation
from nontwist.fitting.slow_noise import noise_of_residuals

MOMENTS = np.array([1.0, 1.6, 2.1])


def noise(rng, n, samples):
    """Return noise of three axes, autoregressive of order 1, of this correlation time in samples."""
    phi, found = np.exp(-1 / samples), rng.normal(size=(n, 3))
    for k in range(1, n):
        found[k] = phi * found[k - 1] + np.sqrt(1 - phi**2) * found[k]
    return found


def mixed(rng, n, samples, slow):
    """Return noise of which a part is slow."""
    return np.sqrt(slow) * noise(rng, n, samples) + np.sqrt(1 - slow) * rng.normal(size=(n, 3))


def fits(count, n=200, part=1 / 20, slow=1.0, by="rates"):
    """Yield fits of throws with noise, rad/s or rad, of which this part of the variance is slow."""
    rng, t = np.random.default_rng(3), np.linspace(0, 2, n)
    for _ in range(count):
        W = rng.normal(size=3) * 4 + [3, 2, 4]
        run = integrate(standard(MOMENTS), times=t, material_angular_velocity=W, tolerance=1e-9)
        rates, attitudes = run.material_angular_velocity, rotation(run)
        if by != "attitudes":
            rates = rates + 0.02 * mixed(rng, n, part * n, slow)
        if by != "rates":
            attitudes *= Rotation.from_rotvec((0.01 if by == "both" else 0.02) * mixed(rng, n, part * n, slow))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield whole({"rates": (t, rates), "attitudes": (t, attitudes), "both": (t, rates, attitudes)}[by])


def covered(throws):
    """Return the share of throws with intervals, how often those of the ratios hold them, and of white noise would."""
    true, found, count = MOMENTS[:2] / MOMENTS[2], [], 0
    for fit in throws:
        half, count = np.diff(fit.principal.ratio_intervals, axis=1).ravel() / 2, count + 1
        off = abs(fit.principal.ratios - true)
        if np.isfinite(half).all():
            found.append([off < half, off < half / np.sqrt(fit.solution.inflation)])
    return len(found) / count, *np.mean(found or [[[np.nan]] * 2], axis=(0, 2))


EACH = pytest.mark.parametrize("by", ["rates", "attitudes", "both"])


@EACH
def test_intervals_allow_for_correlated_residuals(by):
    given, ours, white = covered(fits(8, part=1 / 40, by=by))
    assert given == 1
    assert ours >= 0.85
    assert white < (0.7 if by == "both" else 0.6)


@pytest.mark.long
@EACH
def test_coverage_of_correlated_intervals(by):
    """Where noise goes on for 1/20 of the throw: many have just too few effective samples."""
    given, ours, white = covered(fits(240, by=by))
    assert given > 0.3
    assert 0.9 < ours < 0.98
    assert white < 0.6


@EACH
def test_slow_noise_has_no_intervals(by):
    throws = list(fits(6, part=1 / 2, by=by))
    given, *_ = covered(throws)
    assert given == 0
    if by == "attitudes":  # two of three would look told at the solution alone
        assert [len(fit.untold) for fit in throws] == [0, 0, 0, 3, 0, 0]


@pytest.mark.parametrize("slow", [1.0, 0.4])
def test_noise_from_fitted_residuals(slow):
    """Without bias, though columns that change slowly leave residuals that are less correlated than noise is."""
    rng, n, samples, count = np.random.default_rng(5), 600, 20, 20
    waves = np.cos(np.outer(np.arange(n) + 0.5, np.arange(8)) * np.pi / n)
    A = np.linalg.qr(np.kron(waves, np.eye(3)))[0]
    distance = abs(np.subtract.outer(np.arange(n), np.arange(n)))
    S = slow * np.exp(-distance / samples) + (1 - slow) * np.eye(n)
    true, found = 3 * np.trace(A[::3, ::3].T @ S @ A[::3, ::3]), []
    for _ in range(count):
        e = mixed(rng, n, samples, slow)
        left = e.ravel() - A @ (A.T @ e.ravel())
        one = noise_of_residuals([[np.column_stack([A, left]).reshape(n, 3, -1)]], np.zeros((0, 24)))
        variance = np.trace(one.covariance) * (left @ left) / (3 * n - 24)
        by_neighbours = correlation(left.reshape(n, 3))
        times = -1 / np.log([one.phi[0], by_neighbours]) / samples
        found.append(np.log([*times, variance / true]))
    off = np.mean(found, axis=0) / np.std(found, axis=0) * np.sqrt(count)
    assert abs(off[[0, 2]]).max() < 3
    assert off[1] < -10


@pytest.mark.parametrize(("every", "shared"), [(1, 0.6), (1, -0.9), (3, 1.0)])
def test_slow_noise_of_one_origin(every, shared):
    """Of two kinds, of which the second has fewer samples: its correlation, and the covariance of what is fitted."""
    rng, n, samples, count = np.random.default_rng(6), 600, 30, 20
    waves, has = np.cos(np.outer(np.arange(n) + 0.5, np.arange(6)) * np.pi / n), np.arange(every // 2, n, every)
    rows, times = np.concatenate([waves, 1.5 * waves[has]]), np.append(np.arange(n), has)
    rows = np.linalg.qr(rows)[0]
    A, kind = np.kron(rows, np.eye(3)), (np.arange(len(times)) >= n).astype(int)
    S = np.exp(-abs(np.subtract.outer(times, times)) / samples) * np.array([[1, shared], [shared, 1]])[kind][:, kind]
    true, found = 3 * np.trace(rows.T @ S @ rows), []
    for _ in range(count):
        first, second = noise(rng, n, samples), noise(rng, n, samples)
        e = np.concatenate([first, (shared * first + np.sqrt(1 - shared**2) * second)[has]]).ravel()
        both = np.column_stack([A, e - A @ (A.T @ e)]).reshape(len(times), 3, -1)
        kinds = np.split(both, [n])
        one = noise_of_residuals([[rest] for rest in kinds], np.zeros((0, 18)))
        size = [(k[..., -1] ** 2).sum() / (k[..., -1].size - (k[..., :-1] ** 2).sum()) for k in kinds]  # as white noise
        found.append([np.log(np.trace(one.covariance) * np.mean(size) / true), one.shared - shared])
    mean, deviation = np.mean(found, axis=0), np.std(found, axis=0)
    assert abs(mean[0]) < 3 * deviation[0] / np.sqrt(count)
    assert abs(mean[1]) < 0.05


@pytest.mark.parametrize("by", ["rates", "both"])
def test_white_residuals(by):
    (fit,) = fits(1, slow=0.0, by=by)
    solution, count = fit.solution, 600 if by == "rates" else 1200
    assert solution.slow_noise is None
    assert fit.is_white
    assert fit.effective_samples == count
    assert solution.trusted is solution.information
    assert telling.quantile(solution) == stdtrit(count - 12 - 3 * (by == "both"), 0.975)  # of J, W, bias, scale, start


def test_effective_samples():
    """Of slow noise alone by Bayley and Hammersley; by Welch and Satterthwaite beside white noise."""
    (fit,) = fits(1)
    solution = fit.solution
    (phi,) = solution.slow_noise.phi
    slow = replace(solution)
    slow.__dict__["slow_noise"] = solution.slow_noise._replace(parts=solution.slow_noise.covariance[None])
    assert slow.effective_samples == pytest.approx(600 * (1 - phi**2) / (1 + phi**2))
    assert solution.samples_each == pytest.approx((solution.effective_samples - 7) / 5)  # of W, bias, scale
    assert telling.quantile(solution, always=True) == stdtrit((solution.effective_samples - 12) / 4, 0.975)


@pytest.mark.parametrize(
    ("n", "part", "by"), [(400, 1 / 600, "rates"), (2000, 1 / 20, "rates"), (400, 1 / 20, "attitudes")]
)
def test_slow_noise_is_no_misfit(n, part, by):
    (fit,) = fits(1, n, part, by=by)
    assert fit.is_explained
    assert not fit.is_white
    (said,) = fit.warnings
    assert said.startswith("the residuals are not white")


@pytest.mark.parametrize("drag", [0.01, 0.064])
def test_wrong_model_is_no_noise(drag):
    """At the larger drag neighbours of what is new are uncorrelated by chance, but not every second sample."""
    sensor = {"noise": 1e-4, "rate": 400}
    recording = recorded(standard(MOMENTS), 2, (3, 8, 1), load=damping([drag] * 3), sensor=sensor)
    with pytest.warns(UserWarning, match="times what noise explains"):
        fit = whole(recording)
    assert fit.misfit > 10


def test_too_few_samples_for_intervals():
    (free,) = fits(1, part=1 / 2)
    t, begin = free.parts[0].time, {"rotation": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "angular_velocity": (1, 2, 5)}
    pendulum = integrate(heavy_top([0.02, 0.022, 0.004], 0.5, (0, 0, -0.15)), times=t, tolerance=1e-9, **begin)
    measured = pendulum.material_angular_velocity + 0.003 * noise(np.random.default_rng(3), len(t), 100)
    with pytest.warns(UserWarning, match="samples count: no intervals; its noise is slow"):
        swung = whole((t, measured), gravity={"mass": 0.5, "distance": 0.15})
    for fit in (free, swung):
        assert np.isnan(fit.principal.ratio_intervals).all()
        assert "without an interval" in str(fit)
        assert f"{fit.effective_samples:.2g} of 600 samples count: no intervals" in fit.table()["residual"]
        assert fit.numbers()["effective_samples"] == fit.effective_samples < 50
        assert "nan" not in str(fit)


def test_known_values_are_white():
    rng, known = np.random.default_rng(4), np.diag([1e4, 2e4, 3e4])
    recording = np.dstack([rng.normal(size=(400, 3, 3)), noise(rng, 400, 20)])
    found = noise_of_residuals([[recording]], known)
    np.testing.assert_allclose(found.covariance, known @ known, atol=1e5)
    assert abs(found.parts).max() < 1e5  # of slow noise
