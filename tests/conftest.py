"""Bodies, loads and commands that the tests share; the browser; how the processes of the tests are set up."""

import gc
import os
import shutil
import sys
from contextlib import contextmanager
from functools import cache, partial
from itertools import product

import numpy as np
import pytest
import typer.testing
from typer.testing import CliRunner

from nontwist import body_moment, damping, moment, nontwisting, sine, space_moment, standard
from nontwist.cli import app
from nontwist.errors import RunFileError
from nontwist.kernels import machine_code
from nontwist.models.bodies import BODIES as KINDS
from nontwist.runfile import read_run_file

typer.testing._get_command = cache(typer.testing._get_command)  # makes all commands anew, for every one that is called


def pytest_configure(config):
    """Compile for the quick suite in a third of the time: other registers, the same bits (`test_machine_code`).

    No test cuts the power: nothing is forced to the disk.
    """
    os.fsync = os.fstat
    if config.option.markexpr == "not long":
        machine_code.LEVEL = machine_code.ENOUGH = 0


def pytest_collection_finish():
    """Let the garbage collector look at what tests make alone, and seldom: modules are large."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
    if mathtext := sys.modules.get("matplotlib.mathtext"):
        mathtext.MathTextParser.parse = parsed_once(mathtext.MathTextParser.parse)


FONTS = "font.family", "font.sans-serif", "font.serif", "mathtext.default", "text.hinting", "text.antialiased"


def parsed_once(parse):
    """Parse each formula once in these fonts for all figures; matplotlib does so for each file, half of its time."""
    kept = {}

    def parsed(self, text, dpi=72, prop=None, **how):
        fonts = [str(sys.modules["matplotlib"].rcParams[name]) for name in FONTS]
        key = (self._output_type, text, dpi, prop and prop.copy(), *how.items(), *fonts)
        if key not in kept:
            kept[key] = parse(self, text, dpi, prop, **how)
        return kept[key]

    return parsed


@pytest.fixture(autouse=True)
def no_figures_are_left():
    """Close the figures of pyplot, which exist where a test has imported it."""
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.fixture
def undrawn(monkeypatch):
    """Let matplotlib draw nothing: files of figures are empty."""
    for name in ("savefig", "draw_without_rendering"):
        monkeypatch.setattr(f"matplotlib.figure.Figure.{name}", lambda *figure, **how: None)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def write(tmp_path):
    """What writes text or bytes to a file, and returns its path."""

    def to_file(text, name="run.toml"):
        path = tmp_path / os.fsdecode(name.encode())
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return to_file


def thinned(every, *values):
    """Return all combinations: every first of `every` for the quick suite, the others for the long one alone."""
    cases = enumerate(product(*values))
    return [pytest.param(*case, marks=[pytest.mark.long] * (k % every > 0)) for k, case in cases]


def or_long(quick, long):
    """The cases of the quick suite, and more for the long one."""
    return [*quick, *(pytest.param(*case, marks=pytest.mark.long) for case in long)]


@cache
def compiled_load(function):
    """The load of a compiled function, one for all tests of a process."""
    return moment(function, compiled=True)


def turning(t, d, w):
    return d[0, 1], d[1, 2] * w[0], -d[2, 0]


def cross(a, b):
    """The vector product along the last axis, an eighth of the time of `numpy.cross`."""
    i, j = np.array([1, 2, 0]), np.array([2, 0, 1])
    return a.take(i, -1) * b.take(j, -1) - a.take(j, -1) * b.take(i, -1)


PAPER_J = np.array([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]])


def shoelace(corners):
    """Areas of polygons in the plane, positive where they turn to the left."""
    (x, y), (u, v) = np.moveaxis(corners, -1, 0), np.moveaxis(np.roll(corners, -1, axis=-2), -1, 0)
    return np.sum(x * v - u * y, axis=-1) / 2


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


def ended(code, *arguments, **environment):
    """Return the result of the command `nontwist` that ends with this exit status."""
    result = nontwist(*arguments, **environment)
    assert result.exit_code == code, result.output
    return result


def problems_of(path, *overrides):
    """Return what is wrong with a run file, a line for each key."""
    with pytest.raises(RunFileError) as told:
        read_run_file(path, overrides)
    found = [str(problem) for problem in told.value.problems]
    assert str(told.value).splitlines() == [f"{path}: {line}" for line in found]
    return found


@pytest.fixture
def paper_body():
    return nontwisting(PAPER_J)


STANDARD, NONTWISTING = standard([3, 4, 5]), nontwisting([3, 4, 5])

BODIES = {name: partial(kind.make, **kind.sample) for name, kind in KINDS.items()}


LOADS = {
    "body": lambda: body_moment(lambda t: (np.sin(3 * t), 1, 0.3)),
    "space": lambda: space_moment(lambda t: (np.sin(3 * t), 1, 0.3)),
    "state": lambda: moment(lambda t, d, w: np.cross(d[2], [0, 0, 2.0]) + 0.1 * w),
    "sum": lambda: damping([0.1, 0.2, 0.3]) + sine([1, 2, 0], 0.7) + space_moment([0, 2], [[1, 0, 1], [0, 1, 1]]),
}


@pytest.fixture(scope="session")
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


@contextmanager
def visiting(browser, folder):
    """Give what opens a page with the network cut; what pages ask for or complain of fails."""
    contexts, trouble, place = [], [], folder / "page.html"

    def opened(document, fragment="", moves=True, **options):
        contexts.append(browser.new_context(offline=True, **options))
        contexts[-1].set_default_timeout(600_000)  # ms: against waiting for ever, for the slowest machines
        page, own = contexts[-1].new_page(), (place.as_uri(), "data:")
        page.on("console", lambda message: trouble.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.on("request", lambda r: None if r.url.startswith(own) else trouble.append(r.url))
        place.write_text(document, encoding="utf-8")
        page.goto(place.as_uri() + fragment)
        if moves:
            page.wait_for_selector("#clock:not(:empty)")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert trouble == []


@pytest.fixture
def visit(browser, tmp_path):
    with visiting(browser, tmp_path) as opened:
        yield opened


def frames(page, count):
    """Wait until the page has drawn so many frames: its own events, at the speed of the machine."""
    page.evaluate("(n) => new Promise((f) => { (function g() { n-- ? requestAnimationFrame(g) : f(); })(); })", count)


def until(page, happens):
    """Wait for something, without `eval`, which the page forbids."""
    for _ in range(2000):
        if happens():
            return
        frames(page, 1)
    raise AssertionError("it did not happen in 2000 frames")


# Controls and pictures that have no name.
UNNAMED = """[...document.querySelectorAll('button, input, select, textarea, canvas, [role=img]')]
    .filter((e) => !e.getAttribute('aria-label') && !e.labels?.length && !e.textContent.trim())
    .map((e) => e.outerHTML)"""
# Texts on a page whose colour is not 4.5 times as light, or as dark, as what is behind them (WCAG).
LOW_CONTRAST = """() => {
    const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
    const linear = (x) => (x <= 10 ? x / 3294.6 : ((x / 255 + 0.055) / 1.055) ** 2.4);
    const weights = [0.2126, 0.7152, 0.0722, 0];
    const light = (colour) => numbers(colour).reduce((sum, x, k) => sum + weights[k] * linear(x), 0.05);
    const ground = (e) => {
        const own = e ? getComputedStyle(e).backgroundColor : "rgb(255, 255, 255)", [, , , alpha = 1] = numbers(own);
        return alpha > 0 ? own : ground(e.parentElement);
    };
    return [...document.querySelectorAll("body *")]
        .filter((e) => e.getClientRects().length && !e.matches("script, option"))
        .filter((e) => [...e.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim()))
        .map((e) => {
            const [a, b] = [getComputedStyle(e).color, ground(e)].map(light);
            return [Math.max(a, b) / Math.min(a, b), e.textContent.trim().slice(0, 40)];
        }).filter(([contrast]) => contrast < 4.5);
}"""
