"""Bodies, and the seeds, that the tests share; the browser."""

import os
import shutil
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from nontwist import body_moment, damping, moment, nontwisting, sine, space_moment
from nontwist.cli import app
from nontwist.models.bodies import BODIES as KINDS

PAPER_J = np.array([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]])


def random_euler(rng, block=False):
    """A random positive definite Euler inertia; with `block`, D3 principal."""
    a = rng.normal(size=(3, 3))
    E = a @ a.T + 0.3 * np.eye(3)
    if block:
        E[:2, 2] = E[2, :2] = 0
    return E


def random_inertia(rng, block=False):
    E = random_euler(rng, block)
    return np.trace(E) * np.eye(3) - E


def nontwist(*arguments, **environment):
    """Return the result of the command `nontwist` with these arguments, on lines of 200 letters."""
    return CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "200", **environment})


@pytest.fixture
def paper_body():
    return nontwisting(PAPER_J)


BODIES = {name: partial(kind.make, **kind.sample) for name, kind in KINDS.items()}


LOADS = {
    "body": lambda: body_moment(lambda t: (np.sin(3 * t), 1, 0.3)),
    "space": lambda: space_moment(lambda t: (np.sin(3 * t), 1, 0.3)),
    "state": lambda: moment(lambda t, d, w: np.cross(d[2], [0, 0, 2.0]) + 0.1 * w),
    "sum": lambda: damping([0.1, 0.2, 0.3]) + sine([1, 2, 0], 0.7) + space_moment([0, 2], [[1, 0, 1], [0, 1, 1]]),
}


@pytest.fixture(scope="module")
def browser():
    """Chromium of the system; where CI asks for one, its absence is a failure."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None and "NONTWIST_NEEDS_BROWSER" not in os.environ:
        pytest.skip("no Chromium on the path: the page is not tried in a browser")
    sync_api = pytest.importorskip("playwright.sync_api") if path else __import__("playwright.sync_api").sync_api
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"]
        )
        yield chromium
        chromium.close()
