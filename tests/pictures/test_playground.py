"""The playground: its integrator beside the package's, what hands and keys do, and what it says and copies."""

import re
from functools import partial, reduce
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import LOW_CONTRAST, UNNAMED, ended, frames, random_inertia, until, visiting
from nontwist import nontwisting, pulse, simulate, sphere, standard, suslov, with_gravity
from nontwist.paper.tables import CASES, INERTIA
from nontwist.playground import playground
from nontwist.runfile import read_run_file
from refusals import said

MARCH = """(problems) => problems.map((x) => {
    const body = makeBody(x.J, x.held, x.centre, x.gravity);
    let state = startOf(body, x.attitude, x.velocity);
    for (let k = 0; k < 100; k++) state = stepped(body, state, x.step, scaled(triangle((k + 0.5) * x.step), x.pulse));
    return [...state.p, ...times(body.K, state.P), state.twist];
})"""
KINDS = {
    "standard": standard,
    "heavy_top": standard,
    "nontwisting": nontwisting,
    "heavy nontwisting": nontwisting,
    "suslov": partial(suslov, axis=[0, 0, 1]),
}


def drawn_problem(rng):
    """A body of any kind, pushed or not, with a hundred steps of up to a few hundredths of a radian."""
    kind = rng.choice([*KINDS])
    held, heavy = kind not in ("standard", "heavy_top"), "heavy" in kind
    J = random_inertia(rng, block="nontwisting" in kind)
    centre = heavy * rng.normal(size=3) * ([0, 0, 1] if held else [1, 1, 1])
    return {
        "kind": str(kind),
        "J": J.tolist(),
        "held": held,
        "centre": (0.16 * centre / max(np.linalg.norm(centre), 1e-9)).tolist(),
        "gravity": [0, 0, -9.81 * heavy],
        "attitude": Rotation.random(random_state=rng).as_quat().tolist(),
        "velocity": (rng.normal(size=3) * [1, 1, not held]).tolist(),
        "step": 0.5 / int(rng.integers(25, 100)),
        "pulse": (np.trace(J) / 2 * rng.normal(size=3) * rng.integers(2)).tolist(),
    }


def solved(problem):
    """The same problem, solved by the compiled step."""
    body = KINDS[problem["kind"]](problem["J"])
    if "heavy" in problem["kind"]:
        body = with_gravity(body, 1.0, problem["centre"], problem["gravity"])
    return simulate(
        body,
        t_end=100 * problem["step"],
        step=problem["step"],
        rotation=problem["attitude"],
        scalar_first=False,
        material_angular_velocity=problem["velocity"],
        load=pulse(problem["pulse"], start=0, end=1),
        integrator="lie-midpoint",
    )


def gap(run, state):
    """How far a state of the page, q or -q and W, is from the end of a run."""
    expected, found = np.array([*run.quaternion.values[-1], *run.material_angular_velocity.values[-1]]), np.array(state)
    found[:4] *= np.sign(expected[:4] @ found[:4])
    return abs(expected - found).max()


@pytest.fixture(scope="module")
def still(browser, tmp_path_factory):
    """A playground at rest, for what does not ask how others have left it."""
    with visiting(browser, tmp_path_factory.mktemp("page")) as opened:
        yield opened(playground().html, reduced_motion="reduce")


@pytest.mark.parametrize(("count", "seed"), [(8, 1), pytest.param(100, 2, marks=pytest.mark.long)])
def test_browser_integrates_as_the_package(still, count, seed):
    rng = np.random.default_rng(seed)
    problems = [drawn_problem(rng) for _ in range(count)]
    for end, problem in zip(still.evaluate(MARCH, problems), problems, strict=True):
        run = solved(problem)
        assert gap(run, end[:7]) < 1e-12, problem
        if not problem["held"]:
            d = run.directors.values
            carried = reduce(lambda arrow, way: sphere.transport(*way, arrow), pairwise(d[:, 2]), d[0, 0])
            expected = np.arctan2(d[-1, 2] @ np.cross(carried, d[-1, 0]), carried @ d[-1, 0])
            assert np.exp(1j * end[7]) == pytest.approx(np.exp(1j * expected), abs=1e-11), problem


def test_long_runs_keep_invariants(still):
    changes = still.evaluate(
        """() => PRESETS.map((preset) => {
            const world = new World(inputsOf(preset));
            world.advance(4000);
            return world.runs.map((run) => changes(run, world.inputs).map((change) => change[1]));
        })"""
    )
    for free, held in changes:
        assert max(free[:2]) < 4e-15
        assert held[0] < 4e-15
    assert all(held[2] < 4e-15 for _, held in changes[:5])  # no gravity, d3 principal


STATES = "world.runs.map((run) => [...run.state.p, ...times(run.body.K, run.state.P)])"


@pytest.mark.parametrize("number", [3, *(pytest.param(k, marks=pytest.mark.long) for k in (4, 5, 6))])
def test_copied_code_gives_the_state(visit, write, number):
    page = visit(playground().html, reduced_motion="reduce")
    page.click(f"#presets button:nth-child({number + 1})")
    page.evaluate("begin(world.inputs); setPlaying(false); world.advance(100 - world.steps)")
    states, names, texts = page.evaluate(STATES), {}, {}
    for label in page.locator("#copies button").all_inner_texts():
        page.get_by_role("button", name=label, exact=True).click()
        texts[label] = page.input_value("#text")
    exec(texts.pop("Copy as Python"), names)
    link, runs = texts.pop("Copy the link"), [names["free"], names["held"]]
    for text in texts.values():
        runs.append(simulate(read_run_file(write(text)).problem))
    assert [gap(run, state) < 1e-12 for run, state in zip(runs, states * 2, strict=True)] == [True] * 4
    other = visit(playground().html, "#" + link.partition("#")[2], reduced_motion="reduce")
    assert other.evaluate("world.inputs") == page.evaluate("world.inputs")
    assert "The start is that of the link" in other.inner_text("#watch")


def test_presets(still):
    for number, case in CASES.items():
        given = still.evaluate(f"inputsOf(PRESETS.find((preset) => preset.name === 'Case {number}'))")
        assert still.evaluate("(E) => inertiaOf(E)", given["inertia"]) == [list(row) for row in INERTIA]
        assert given["velocity"] == list(case.angular_velocity)
        assert given["pulse"] == [x / 20 for x in case.printed_peak]

    def after(name, steps):
        """The axes, velocities and twists of the free and of the held body, at 50 times."""
        found = still.evaluate(
            """([name, steps]) => {
                const world = new World(inputsOf(PRESETS.find((preset) => preset.name === name)));
                return Array.from({ length: 50 }, () => {
                    world.advance(steps / 50);
                    return world.runs.map(({ body, state: { p, P, twist } }) => [
                        triadOf(p)[2], times(body.K, P), [twist, 0, 0]]);
                });
            }""",
            [name, steps],
        )
        return np.moveaxis(found, 0, 2)  # by body, quantity, time, component

    free, held = after("One kick", 1000)
    assert abs(free[2]).max() > 0.5
    assert not held[2].any()
    free, held = after("Tennis racket", 6000)
    assert free[1, :, 1].min() < -3  # it flips
    assert held[1, :, 1].min() == pytest.approx(4)
    free, held = after("Sleeping top", 2000)
    assert free[0, :, 2].min() > 0.99
    assert held[0, :, 2].min() < 0
    _, held = after("Suslov's settling", 20000)
    assert abs(held[1, -1, 1]) < 1e-3
    assert abs(held[1, -1, 0]) > 2


def test_kick_is_an_impulse(visit):
    page = visit(playground().html, viewport={"width": 1280, "height": 1000}, reduced_motion="reduce")
    page.evaluate("again(); setPlaying(false); render()")
    tip, radius = page.evaluate("[stages[0].scene.project(triadOf(world.runs[0].state.p)[2]), stages[0].scene.radius]")
    box = page.locator(".stage canvas").first.bounding_box()
    x, y = box["x"] + tip[0], box["y"] + tip[1]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 90, y + 40, steps=3)
    assert page.evaluate("world.runs.map((run) => size(run.state.P))") == [0, 0]
    right, up, _ = np.array(page.evaluate("stages[0].scene.view"))
    page.mouse.up()
    assert page.get_attribute("#play", "aria-label") == "Pause"
    page.click("#play")
    W, J = page.evaluate("[world.inputs.velocity, inertiaOf(world.inputs.inertia)]")
    force = (-90 * right - 40 * up) / radius
    impulse = 7 * np.trace(J) / 3 * np.cross([0, 0, 1], force)  # the pose is upright: d3 is z, d1 is x
    assert J @ np.array(W) == pytest.approx(impulse, rel=1e-6)
    assert abs(W[2]) < 1e-15  # a pull at the tip gives no spin
    free, held = page.evaluate("world.runs.map((run) => run.velocity)")
    assert held == pytest.approx(free, abs=1e-15)


def test_keys_alone(visit):
    page = visit(playground().html)
    press = page.keyboard.press
    press("Space")
    assert page.get_attribute("#play", "aria-label") == "Play"
    page.evaluate("begin(world.inputs); setPlaying(false)")
    assert re.match(
        r"After [\d.]+ seconds\. Standard body: twist −?[\d.]+°, axis at .*, energy conserved .*Non-twisting body",
        page.inner_text("#told"),
    )
    page.focus("#presets button:last-child")
    press("Tab")  # reaches a canvas
    label = page.evaluate("document.activeElement.getAttribute('aria-label')")
    assert label.startswith("Standard body. Arrow keys pull")
    for name in ("ArrowRight", "ArrowRight", "ArrowUp"):
        press(name)
    assert page.evaluate("grip.pull") == pytest.approx([0.2, 0.1])
    press("Escape")
    assert page.evaluate("[grip.run, size(world.inputs.velocity)]") == [None, 0]
    press("ArrowLeft")
    press("Enter")
    assert page.get_attribute("#play", "aria-label") == "Pause"
    assert page.evaluate("size(world.inputs.velocity)") > 0.2
    assert "Kicked. The standard body starts at" in page.inner_text("#told")
    until(page, lambda: page.evaluate("world.steps") > 3)
    azimuth = page.evaluate("camera.azimuth")
    press("Shift+ArrowRight")
    assert page.evaluate("camera.azimuth") > azimuth
    press(".")
    steps = page.evaluate("world.steps")
    press(".")
    assert page.evaluate("world.steps") == steps + 20
    press("r")
    until(page, lambda: page.evaluate("world.steps") < steps)
    page.evaluate("setPlaying(false)")
    page.focus("#loop")
    for name in ("ArrowRight", "ArrowUp", "ArrowLeft"):
        for _ in range(3):
            press(name)
    press("Enter")
    said(page.inner_text("#drawn"))
    assert page.inner_text("#gap") == "none"
    assert page.evaluate("loop.area") == pytest.approx(0.09, rel=0.05)


def test_arrow_turns_by_the_area(still):
    page, both = still, "[loop.area, loop.turn]"
    page.set_viewport_size({"width": 1280, "height": 1400})
    for name, expected, error in (("#triangle", np.pi / 2, 1e-12), ("#circle", np.pi / 3, 1e-4)):  # of 360 sides
        page.click(name)
        area, turn = page.evaluate(both)
        assert area == pytest.approx(expected, rel=error)
        assert turn == pytest.approx(area, abs=1e-12)
    box = page.locator("#loop").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x + 60, y)
    page.mouse.down()
    for k in range(1, 20):
        page.mouse.move(x + 60 * np.cos(k / 3.1), y + 60 * np.sin(k / 3.1), steps=2)
        area, turn = page.evaluate(both)
        assert turn == pytest.approx(area, abs=1e-12)
    assert not page.evaluate("loop.isClosed")
    page.mouse.up()
    assert page.evaluate("loop.isClosed")
    sine = 60 / page.evaluate("panel.radius")
    assert area == pytest.approx(-2 * np.pi * (1 - np.sqrt(1 - sine**2)), rel=0.02)  # clockwise


@pytest.mark.long
def test_touch(visit):
    page = visit(playground().html, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    touch = page.context.new_cdp_session(page)

    def swipe(canvas, place, by):
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        x, y = box["x"] + place[0], box["y"] + place[1]
        for kind, part in (("touchStart", 0), ("touchMove", 0.5), ("touchMove", 1)):
            points = [{"x": x + part * by[0], "y": y + part * by[1]}]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    page.tap("#play")
    page.evaluate("begin(world.inputs); render()")
    link = page.evaluate("link")
    tip = page.evaluate("stages[1].scene.project(triadOf(world.runs[1].state.p)[2])")
    swipe(page.locator(".stage canvas:not(.dial)").nth(1), tip, (-40, 30))
    until(page, lambda: page.evaluate("link") != link)
    assert page.evaluate("size(world.inputs.velocity)") > 1
    swipe(page.locator("#loop"), page.evaluate("panel.centre"), (60, 20))
    assert page.evaluate("loop.points.length") > 10


def test_sliders_give_possible_bodies(still):
    page, sliders = still, still.locator("#sliders input")
    for values in ((0.3, 4, 0.3, 0.6, 0.6, 20), (4, 0.3, 0.3, -0.6, 0.6, 0), (0.3, 0.3, 0.3, 0.6, -0.6, 9.81)):
        for k, value in enumerate(values):
            sliders.nth(k).fill(str(value))
        inputs, J = page.evaluate("[world.inputs, inertiaOf(world.inputs.inertia)]")
        assert page.evaluate("isPossible(world.inputs)")
        body = with_gravity(standard(J), 1, [0, 0, 0.3])  # refuses what no mass distribution has
        assert np.linalg.eigvalsh(body.euler_inertia)[0] > 0
        assert [*np.diag(body.euler_inertia), *inputs["gravity"]] == pytest.approx([*values[:3], values[5]])
    assert page.locator(".stage h2").all_inner_texts() == ["Heavy top", "Suslov top"]


def test_links_without_a_body(still, visit):
    good = "inertia=1,1,1,0.5,0,0&attitude=0,0,0,1&velocity=1,0,0&gravity=0&pulse=0,0,0"
    assert still.evaluate("(text) => toLink(fromLink(text))", good) == good
    wrong = ["inertia=1", "<b id=evil>"]
    for part, other in (
        ("0.5", "1"),  # a body without volume
        ("0.5", "0.99"),  # whose centre of mass cannot stand where it does
        ("velocity=1", "velocity=1e9"),
        ("velocity=1", "velocity=NaN"),
        ("0,0,0,1", "0,0,0,2"),
        ("gravity=0", "gravity=-1"),
        ("pulse=0", "pulse=0x1"),
    ):
        wrong.append(good.replace(part, other))
    assert still.evaluate("(texts) => texts.filter((text) => fromLink(text) !== null)", wrong) == []
    page = visit(playground().html, "#<b id=evil>", reduced_motion="reduce")  # and begins at rest
    assert page.evaluate("world.inputs") == page.evaluate("inputsOf(PRESETS[0])")
    frames(page, 10)
    assert page.get_attribute("#play", "aria-label") == "Play"
    assert page.evaluate("world.steps") == 20
    assert page.inner_text("#told").startswith("After 0.10 seconds.")


def test_legible_and_named(still):
    page = still
    page.get_by_role("button", name="Copy as Python").click()
    for width, scheme in ((1400, "light"), (900, "dark"), (390, "light"), (320, "dark")):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 900})
        frames(page, 2)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(LOW_CONTRAST) == []
    assert page.evaluate(UNNAMED) == []
    assert page.locator("[aria-live=polite]").count() == 3
    assert "default-src 'none'" in playground().html


def test_the_command_writes_the_page(here):
    size = len(playground().html.encode())
    assert size < 150_000
    assert ended(0, "play", "--no-open").stderr == f"written: playground.html ({size / 1e3:.0f} kB)\n"
    assert (here / "playground.html").read_text(encoding="utf-8") == playground().html
