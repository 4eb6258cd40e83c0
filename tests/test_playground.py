"""The playground: its integrator beside the package's, what hands and keys do, and what it says and copies."""

import re
import warnings
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from conftest import LOW_CONTRAST, frames, until
from conftest import nontwist as command
from nontwist import nontwisting, pulse, simulate, sphere, standard, suslov, with_gravity
from nontwist.paper.tables import CASES, INERTIA
from nontwist.playground import playground
from nontwist.runfile import read_run_file
from refusals import said

MARCH = """(problems) => problems.map((x) => {
    const body = makeBody(x.J, x.held, x.centre, x.gravity);
    let state = startOf(body, x.attitude, x.velocity);
    for (let k = 0; k < 1000; k++) state = stepped(body, state, x.step, scaled(triangle((k + 0.5) * x.step), x.pulse));
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
    """A body of any kind, pushed or not, with a thousand steps of up to a few hundredths of a radian."""
    kind = rng.choice([*KINDS])
    held, heavy = kind not in ("standard", "heavy_top"), "heavy" in kind
    root = rng.normal(size=(3, 3))
    if "nontwisting" in kind:
        root[2, :2] = root[:2, 2] = 0
    E = root @ root.T + 0.3 * np.eye(3)
    centre = heavy * rng.normal(size=3) * ([0, 0, 1] if held else [1, 1, 1])
    centre *= 0.16 / max(np.linalg.norm(centre), 1e-9)
    attitude = rng.normal(size=4)
    return {
        "kind": str(kind),
        "J": (np.trace(E) * np.eye(3) - (E + E.T) / 2).tolist(),
        "held": held,
        "centre": centre.tolist(),
        "gravity": [0, 0, -9.81 * heavy],
        "attitude": (attitude / np.linalg.norm(attitude)).tolist(),
        "velocity": (rng.normal(size=3) * [1, 1, not held]).tolist(),
        "step": rng.uniform(0.002, 0.02),
        "pulse": (np.trace(E) * rng.normal(size=3) * rng.integers(2)).tolist(),
    }


def solved(problem, change=0.0):
    """The same problem, solved by the compiled step; `change` of the start velocity in parts of itself."""
    body = KINDS[problem["kind"]](problem["J"])
    if "heavy" in problem["kind"]:
        body = with_gravity(body, 1.0, problem["centre"], problem["gravity"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pulses may end between two steps
        return simulate(
            body,
            t_end=1000 * problem["step"],
            step=problem["step"],
            rotation=problem["attitude"],
            scalar_first=False,
            material_angular_velocity=np.array(problem["velocity"]) * (1 + change),
            load=pulse(problem["pulse"], start=0, end=1),
            integrator="lie-midpoint",
        )


def end_of(run):
    return np.array([*run.quaternion.values[-1], *run.material_angular_velocity.values[-1]])


def of_bounded_divergence(count, seed):
    """Problems in which a change of the start grows no more than a hundred times, with their runs."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        problem = drawn_problem(rng)
        run, near = solved(problem), solved(problem, 1e-7)
        if abs(end_of(near) - end_of(run)).max() < 100 * 1e-7:
            found.append((problem, run))
    return found


def transported(d3, arrow):
    """The arrow, carried along the geodesics between directions."""
    for a, b in pairwise(d3):
        arrow = sphere.transport(a, b, arrow)
    return arrow


@pytest.mark.parametrize(("count", "seed"), [(8, 1), pytest.param(100, 2, marks=pytest.mark.long)])
def test_the_browser_integrates_as_the_package_does(visit, count, seed):
    page, problems = visit(playground().html), of_bounded_divergence(count, seed)
    ends = np.array(page.evaluate(MARCH, [problem for problem, _ in problems]))
    for end, (problem, run) in zip(ends, problems, strict=True):
        expected = end_of(run)
        expected[:4] *= np.sign(expected[:4] @ end[:4])  # q and -q are one attitude
        assert abs(end[:7] - expected).max() < 1e-12, problem
    free = [(end, *pair) for end, pair in zip(ends, problems, strict=True) if not pair[0]["held"]]
    for end, problem, run in free[:4]:
        d = run.directors.values
        carried = transported(d[:, 2], d[0, 0])
        psi = np.arctan2(d[-1, 2] @ np.cross(carried, d[-1, 0]), carried @ d[-1, 0])
        assert np.exp(1j * end[7]) == pytest.approx(np.exp(1j * psi), abs=1e-11), problem


def test_long_runs_keep_energy_and_momentum(visit):
    page = visit(playground().html)
    changes = page.evaluate(
        """() => PRESETS.map((preset) => {
            const world = new World(inputsOf(preset));
            world.advance(20000);
            return world.runs.map((run) => changes(run, world.inputs).map((change) => change[1]));
        })"""
    )
    for free, held in changes:
        assert max(free[:2]) < 4e-15
        assert held[0] < 4e-15
    assert all(held[2] < 4e-15 for _, held in changes[:5])  # no gravity, d3 principal


STATES = "() => world.runs.map((run) => [...run.state.p, ...times(run.body.K, run.state.P)])"


def same(run, state):
    expected = end_of(run)
    return abs(expected - np.array(state) * np.sign([*[expected[:4] @ state[:4]] * 4, 1, 1, 1])).max() < 1e-12


@pytest.mark.parametrize("number", [3, *(pytest.param(k, marks=pytest.mark.long) for k in (4, 5, 6))])
def test_what_is_copied_gives_the_state_of_the_page(visit, tmp_path, number):
    page = visit(playground().html)
    page.click("#play")
    page.click(f"#presets button:nth-child({number + 1})")
    page.click("#play")
    page.evaluate("begin(world.inputs)")
    for _ in range(3):
        page.keyboard.press(".")
    page.evaluate("world.advance(40)")
    states, names = page.evaluate(STATES), {}
    assert page.evaluate("world.steps") == 100
    texts = {}
    for label in page.locator("#copies button").all_inner_texts():
        page.get_by_role("button", name=label, exact=True).click()
        texts[label] = page.input_value("#text")
    python = texts.pop("Copy as Python")
    exec(python, names)
    assert same(names["free"], states[0])
    assert same(names["held"], states[1])
    link = texts.pop("Copy the link")
    for text, state in zip(texts.values(), states, strict=True):
        (tmp_path / "copied.toml").write_text(text, encoding="utf-8")
        run = simulate(read_run_file(tmp_path / "copied.toml").problem)
        assert same(run, state)
    other = visit(playground().html, "#" + link.partition("#")[2], reduced_motion="reduce")
    assert other.evaluate("world.inputs") == page.evaluate("world.inputs")
    assert "The start is that of the link" in other.inner_text("#watch")


def test_presets_are_the_cases_of_the_paper(visit):
    page = visit(playground().html)
    for number, case in CASES.items():
        given = page.evaluate(f"inputsOf(PRESETS.find((preset) => preset.name === 'Case {number}'))")
        assert page.evaluate("(E) => inertiaOf(E)", given["inertia"]) == [list(row) for row in INERTIA]
        assert given["velocity"] == list(case.angular_velocity)
        assert given["pulse"] == [x / 20 for x in case.printed_peak]


def test_presets_show_what_they_say(visit):
    page = visit(playground().html)

    def after(name, steps):
        return page.evaluate(
            """([name, steps]) => {
                const world = new World(inputsOf(PRESETS.find((preset) => preset.name === name)));
                return Array.from({ length: 50 }, () => {
                    world.advance(steps / 50);
                    return world.runs.map(({ body, state: { p, P, twist } }) => (
                        { d3: triadOf(p)[2], W: times(body.K, P), twist }));
                });
            }""",
            [name, steps],
        )

    kick = after("One kick", 1000)
    assert max(abs(free["twist"]) for free, _ in kick) > 0.5
    assert all(held["twist"] == 0 for _, held in kick)
    racket = after("Tennis racket", 6000)
    assert min(free["W"][1] for free, _ in racket) < -3  # it flips
    assert min(held["W"][1] for _, held in racket) == pytest.approx(4)
    top = after("Sleeping top", 2000)
    assert min(free["d3"][2] for free, _ in top) > 0.99
    assert min(held["d3"][2] for _, held in top) < 0
    settling = after("Suslov's settling", 20000)
    assert abs(settling[-1][1]["W"][1]) < 1e-3
    assert abs(settling[-1][1]["W"][0]) > 2


def test_a_kick_by_mouse_is_the_impulse_of_the_pull(visit):
    page = visit(playground().html, viewport={"width": 1280, "height": 1000})
    page.evaluate("setPlaying(false); again(); setPlaying(false); render()")
    tip, radius = page.evaluate("[stages[0].scene.project(triadOf(world.runs[0].state.p)[2]), stages[0].scene.radius]")
    box = page.locator(".stage canvas").first.bounding_box()
    x, y = box["x"] + tip[0], box["y"] + tip[1]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 90, y + 40, steps=3)
    assert page.evaluate("world.runs.map((run) => size(run.state.P))") == [0, 0]
    view = np.array(page.evaluate("stages[0].scene.view"))
    page.mouse.up()
    assert page.get_attribute("#play", "aria-label") == "Pause"
    page.click("#play")
    inputs = page.evaluate("world.inputs")
    J = np.array(page.evaluate("inertiaOf(world.inputs.inertia)"))
    force = (-90 * view[0] - 40 * view[1]) / radius
    impulse = 7 * np.trace(J) / 3 * np.cross([0, 0, 1], force)  # the pose is upright: d3 is z, d1 is x
    assert J @ inputs["velocity"] == pytest.approx(impulse, rel=1e-6)
    assert abs(inputs["velocity"][2]) < 1e-15  # a pull at the tip gives no spin
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
    for _ in range(60):  # a canvas is reached by tabbing
        press("Tab")
        if page.evaluate("document.activeElement.getAttribute('role')") == "application":
            break
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
    page.focus("#loop")
    for name in ("ArrowRight", "ArrowUp", "ArrowLeft"):
        for _ in range(3):
            press(name)
    press("Enter")
    said(page.inner_text("#drawn"))
    assert page.inner_text("#gap") == "none"
    assert page.evaluate("loop.area") == pytest.approx(0.09, rel=0.05)


def test_the_arrow_comes_back_turned_by_the_area(visit):
    page = visit(playground().html, viewport={"width": 1280, "height": 1400})
    page.click("#triangle")
    assert page.evaluate("[loop.area, loop.turn]") == pytest.approx([np.pi / 2] * 2, abs=1e-12)
    page.click("#circle")
    assert page.evaluate("loop.area") == pytest.approx(np.pi / 3, rel=1e-4)  # a polygon of 360 sides
    assert page.evaluate("loop.turn - loop.area") == pytest.approx(0, abs=1e-12)
    box = page.locator("#loop").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x + 60, y)
    page.mouse.down()
    for k in range(1, 20):
        page.mouse.move(x + 60 * np.cos(k / 3.1), y + 60 * np.sin(k / 3.1), steps=4)
        area, turn = page.evaluate("[loop.area, loop.turn]")
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


def test_sliders_give_possible_bodies(visit):
    page = visit(playground().html)
    page.click("#play")
    sliders = page.locator("#sliders input")
    for values in ((0.3, 4, 0.3, 0.6, 0.6, 20), (4, 0.3, 0.3, -0.6, 0.6, 0), (0.3, 0.3, 0.3, 0.6, -0.6, 9.81)):
        for k, value in enumerate(values):
            sliders.nth(k).fill(str(value))
        inputs, J = page.evaluate("[world.inputs, inertiaOf(world.inputs.inertia)]")
        assert page.evaluate("isPossible(world.inputs)")
        body = with_gravity(standard(J), 1, [0, 0, 0.3])  # refuses what no mass distribution has
        assert np.linalg.eigvalsh(body.euler_inertia)[0] > 0
        assert [*np.diag(body.euler_inertia), *inputs["gravity"]] == pytest.approx([*values[:3], values[5]])
    assert page.locator(".stage h2").all_inner_texts() == ["Heavy top", "Suslov top"]


def test_links_of_no_body_are_passed_over(visit):
    page = visit(playground().html, reduced_motion="reduce")
    good = "inertia=1,1,1,0.5,0,0&attitude=0,0,0,1&velocity=1,0,0&gravity=0&pulse=0,0,0"
    assert page.evaluate("(text) => toLink(fromLink(text))", good) == good
    for wrong in (
        "inertia=1",
        "<b id=evil>",
        good.replace("0.5", "1"),  # a body without volume
        good.replace("0.5", "0.99"),  # whose centre of mass cannot stand where it does
        good.replace("velocity=1", "velocity=1e9"),
        good.replace("velocity=1", "velocity=NaN"),
        good.replace("0,0,0,1", "0,0,0,2"),
        good.replace("gravity=0", "gravity=-1"),
        good.replace("pulse=0", "pulse=0x1"),
    ):
        assert page.evaluate("(text) => fromLink(text)", wrong) is None, wrong
    again = visit(playground().html, "#<b id=evil>", reduced_motion="reduce")
    assert again.evaluate("world.inputs") == again.evaluate("inputsOf(PRESETS[0])")


def test_reduced_motion_begins_at_rest(visit):
    page = visit(playground().html, reduced_motion="reduce")
    frames(page, 10)
    assert page.get_attribute("#play", "aria-label") == "Play"
    assert page.evaluate("world.steps") == 20
    assert page.inner_text("#told").startswith("After 0.10 seconds.")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_overflows_and_text_is_legible(visit, scheme):
    page = visit(playground().html, color_scheme=scheme)
    page.get_by_role("button", name="Copy as Python").click()
    for width in (1400, 900, 390, 320):
        page.set_viewport_size({"width": width, "height": 900})
        frames(page, 2)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(LOW_CONTRAST) == []


def test_names_of_controls_and_size(visit):
    page = visit(playground().html)
    unnamed = page.evaluate(
        """[...document.querySelectorAll('button, input, select, textarea, canvas, [role=img]')]
          .filter((e) => !(e.getAttribute('aria-label') || e.labels?.length || e.textContent.trim()))
          .map((e) => e.outerHTML)"""
    )
    assert unnamed == []
    assert page.locator("[aria-live=polite]").count() == 3
    assert len(playground().html.encode()) < 150_000
    assert "default-src 'none'" in playground().html


def test_the_command_writes_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = command("play", "--no-open")
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "playground.html").read_text(encoding="utf-8") == playground().html
    assert result.stderr == f"written: playground.html ({len(playground().html.encode()) / 1e3:.0f} kB)\n"
    again = command("play", "--no-open")
    assert again.exit_code == 5
    assert "playground.html exists" in again.stderr
    assert command("play", "--no-open", "--force", "--out", "playground.html").exit_code == 0
