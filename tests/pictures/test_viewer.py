"""The page of `view`: its data, and what it does in a real browser."""

import base64
import html
import json
import re
import shlex
import tempfile
import webbrowser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import LOW_CONTRAST, PAPER_J, UNNAMED, ended, frames, until
from nontwist.cli.view_commands import smooth
from nontwist.loads.kinds import load_in_words
from nontwist.paper.tables import CASES
from nontwist.validation.conserved import OF_TERMS
from nontwist.viewer.content import content
from nontwist.viewer.drawing import Motion, camera_of
from refusals import said, says


@pytest.fixture(scope="module")
def case3():
    """The paper's case 3, and a free standard body with the same inertia."""
    case, span = CASES[3], {"t_end": 5, "step": 0.01}
    W = case.angular_velocity
    run = nt.simulate(nt.nontwisting(PAPER_J), material_angular_velocity=W, load=case.load(), **span)
    return run, nt.simulate(nt.standard(PAPER_J), material_angular_velocity=(*W[:2], 1.0), **span)


@pytest.fixture(scope="module")
def free():
    return nt.simulate(nt.standard([3, 4, 5]), t_end=1, step=0.05, material_angular_velocity=(0.1, 2, 0.1))


def numbers(text):
    return np.frombuffer(base64.b64decode(text), "<f4").astype(float)


def panel(page, title):
    (found,) = [each for each in page["panels"] if each["title"] == title]
    return found


def contents_of(page):
    """The data in the text of a page."""
    return json.loads(re.search(r'id="content">(.*?)</script>', page, re.DOTALL)[1])


def test_twist_gives_nontwisting_frame():
    axis = np.array([0.3, -0.4, 1.2]) / 1.3
    J = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]
    for body, W, n in ((nt.standard(J), [1, 2, 1], [0, 0, 1]), (nt.suslov(J, axis), [4, 3, 0], axis)):
        run = nt.simulate(body, t_end=3, step=0.01, material_angular_velocity=W)
        page, expected = content(run), nt.twist(run, axis=n)
        triad = np.swapaxes(Rotation.from_quat(numbers(page["attitude"]).reshape(-1, 4)).as_matrix(), 1, 2)
        psi = numbers(page["twist"])[:, None]
        frame = np.cos(psi) * triad[:, 0] - np.sin(psi) * triad[:, 1]
        assert frame == pytest.approx(expected.frame.values[:, 0], abs=1e-6)
        assert triad[:, 2] == pytest.approx(np.einsum("tix,i->tx", run.directors.values, n), abs=1e-6)
    assert content(run)["labels"][2] == "n"
    assert "Arrows" in content(run)["about"]


def test_box_has_the_inertia():
    sides, turn = np.array([1.0, 2.0, 3.0]), Rotation.from_rotvec([0.3, -0.7, 0.4]).as_matrix()
    J = turn @ nt.inertia.of_cuboid(1.0, sides) @ turn.T
    box = content(nt.simulate(nt.standard(J), t_end=0.1, step=0.05, angular_velocity=[1, 0, 0]))["box"]
    assert np.array(box["half"]) / box["half"][0] == pytest.approx(sides)
    assert abs(np.array(box["edges"]) @ turn) == pytest.approx(np.eye(3), abs=1e-12)


def test_twist_comes_first(case3):
    held, free = map(content, case3)
    titles = [[each["title"] for each in page["panels"]] for page in (held, free)]
    assert titles[0] == ["Twist", "Reaction moment", "Spatial momentum", "Material momentum", "Kinetic energy"]
    assert "Reaction moment" not in titles[1]
    psi = nt.twist(case3[1])
    for key, name in (("twist", "twist_angle"), ("swing", "swing_twist_angle"), ("area", "solid_angle")):
        assert numbers(free[key]) == pytest.approx(psi[name].values, abs=2e-6)
    assert numbers(panel(free, "Twist")["curves"][0]["values"]) == pytest.approx(np.degrees(numbers(free["twist"])))
    for title, index in (("Twist", 0), ("Material momentum", 2)):  # round-off is not shown
        assert not numbers(panel(held, title)["curves"][index]["values"]).any()
    assert abs(case3[0].material_momentum.sel(director=3)).max() < 1e-9


def test_rotors_and_energies():
    """From the start on. A momentum of 2e-10 of the largest one is not taken for round-off."""
    rotors = (nt.rotor((0, 0, 1), 0.3), 2 * nt.rotor((1, 0, 0), [0.5, 1.5], [0, 2]), nt.rotor((0, 1, 0), 1e-9))
    top = nt.heavy_top([2, 2, 1], 1.5, [0, 0, 0.6])
    run = nt.simulate(top, load=sum(rotors, nt.Load()), t_start=0.5, t_end=1.5, step=0.1, angular_velocity=(2, 0, 0))
    t, K, V = run.time.values - 0.5, run.kinetic_energy.values, run.potential_energy.values
    momenta = {"h1": np.full(11, 0.3), "h2": 4 * t, "h3": np.full(11, 1e-9)}
    for title, expected in {"Rotor momentum": momenta, "Energy": {"K": K, "V": V, "K+V": K + V}}.items():
        drawn = panel(content(run), title)["curves"]
        assert [curve["letter"] + curve["index"] for curve in drawn] == [*expected]
        for curve, values in zip(drawn, expected.values(), strict=True):
            assert numbers(curve["time"]) == pytest.approx(t, abs=1e-6)
            assert numbers(curve["values"]) == pytest.approx(values, rel=1e-6, abs=0)


def test_recordings(case3):
    run = case3[1]
    turns, shown = Rotation.from_quat(run.quaternion.values), content(run.drop_vars("mean_twist_rate"))
    for motion in (nt.twist(turns, run.time.values), run.quaternion, run[["quaternion", "directors"]].drop_attrs()):
        page = content(motion)
        assert page["name"] == "recorded motion"
        for key in ("attitude", "twist", "swing", "area", "time"):
            assert numbers(page[key]) == pytest.approx(numbers(shown[key]), abs=1e-6), key
    assert [each["title"] for each in page["panels"]] == ["Twist", "Solid angle of the path"]
    tilted = content(nt.twist(turns, run.time.values, axis=[1, 2, 2]))
    n = Rotation.from_quat(numbers(tilted["attitude"]).reshape(-1, 4)).apply([0, 0, 1])
    assert n == pytest.approx(turns.apply([1 / 3, 2 / 3, 2 / 3]), abs=1e-6)


LOADS_IN_WORDS = [
    "none",
    "dry friction of up to 0.5 N m about (0, 0, 1)",
    "sine (0, 0, 2) N m along fixed axes, 3 Hz, phase 0.5 rad",
    "rectangle pulse (1, 0, 0) N m along the directors, from 1 to 2 s",
    "damping 0.1 N m s",
    "linear potential of the space vector (0, 1, 0)",
    "gravity gradient on an orbit of eccentricity 0.1, mean motion 0.2 rad/s",
    "triangle pulse (0, 2, −4) N m along the directors, from 0 to 0.2 s",
    "sine (2, 4, 0) N m along the directors, 0.7 Hz",
    "table of 2 moments of up to 2.828 N m along fixed axes",
    "2 × function nontwist.validation.conserved.<lambda> along the directors",
    "damping by a matrix",
    "rotor about (0.4472, 0.8944, 0), table of 2 momenta from 2 to 5 kg m² s⁻¹",
    "2 × dry friction of up to 2 N m",
    "wheel of 0.5 kg m² about (0.4472, 0.8944, 0), at first 6 rad/s, with a motor",
    "table of 2 director forces along fixed axes",
    "2 × director forces of nontwist.validation.conserved.<lambda> along the directors",
    "quadratic potential of the space vector (1, 0, 2)",
    "spring 8 N/m from (0.2, 0.5, 1) m in the body to (1, 1, 0.5) m in space, rest length 0.7 m",
    "gravity gradient on a circular orbit, mean motion 0.8 rad/s",
    "2 × potential nontwist.validation.conserved.<lambda>",
    "2 × function nontwist.validation.conserved.reaction with memory nontwist.validation.conserved.friction, "
    "1 internal state",
]


def test_page_text(free):
    how = {"t_end": 1, "step": 0.05, "material_angular_velocity": (1, 0, 1)}
    held = nt.simulate(nt.suslov([3, 4, 5], (0, 1, 0)), **how)
    top = nt.simulate(nt.heavy_top([2.0, 2.2, 1.0], 1.5, [0.1, 0.0, 0.6]), integrator="split", order=2, **how)
    for motion, box, watch in (
        (free, "the inertia of the body", "The body may turn about its own axis: the wedge is its twist"),
        (nt.twist(free, axis="x"), "generic, since a recording has no inertia", "The wedge is the twist"),
        (held, "the inertia of the body", "The body may not turn about n: the wedge remains closed"),
        (top, "the inertia about the pivot; the line points to the centre of mass", "The body may turn about its own"),
    ):
        page = content(motion)
        assert page["about"]["Box"].startswith(box)
        assert page["watch"].startswith(watch)
        assert ("Arrows" in page["about"]) == (motion is not free and motion is not top)
        curves = [[each["title"], *(curve["letter"] for curve in each["curves"])] for each in page["panels"]]
        said(json.dumps([page["name"], page["about"], page["watch"], curves], ensure_ascii=False))
    usual = nt.simulate(nt.nontwisting([3, 4, 5]), t_end=1, step=0.5, angular_velocity=(1, 0, 0))
    assert [re.findall("about (n|d₃)", content(one)["watch"]) for one in (held, usual)] == [["n"], ["d₃"]]
    assert content(held)["about"]["Body"] == "no spin about the body axis (0, 1, 0); principal moments 3, 4, 5 kg m²"
    assert content(top)["about"]["Body"] == "free to turn; principal moments 1, 2, 2.2 kg m²; gravity"
    assert content(top)["about"]["Integrator"] == "split, order 2, step 0.05 s"
    others = nt.sine([0, 0, 2], 3, phase=0.5, frame="space"), nt.pulse([1, 0, 0], 1, 2, shape="rectangle")
    others += nt.damping(0.1), nt.dipole((0, 0, 1), (0, 1, 0)), nt.gravity_gradient(0.2, eccentricity=0.1)
    loads = (0 * CASES[1].load(), nt.dry_friction(0.5, "z"), *others, *(2 * one for one in OF_TERMS.values()))
    assert [load_in_words(json.loads(json.dumps(load.description))) for load in loads] == LOADS_IN_WORDS


def test_decimation_keeps_peaks():
    how = {"t_end": 300, "step": 0.01, "order": 2}
    run = nt.simulate(nt.standard([1, 2, 2.5]), material_angular_velocity=(0.6, 0.2, 0.3), **how)
    run["kinetic_energy"][12345] = 99.0
    page = content(run)
    assert page["thinned"]
    assert page["about"]["States"] == "5000 of 30001 shown, evenly; curves keep every peak"
    (K,) = panel(page, "Kinetic energy")["curves"]
    assert (numbers(K["values"]).max(), numbers(K["values"]).size <= 2002) == (99, True)
    assert numbers(page["time"])[[0, -1]] == pytest.approx([0, 300])
    assert len(json.dumps(page)) < 450_000  # and of two runs less than 1 MB
    how |= {"t_end": 30, "step": 0.005, "angular_velocity": [0, 0, 70]}  # shown 1 or 2 steps apart
    fast = nt.simulate(nt.standard([1, 2, 2.5]), **how)
    assert "Between two of them the body turns by up to 0.7 rad" in content(fast)["about"]["States"]
    assert content(fast.isel(time=slice(0, 400)))["about"]["States"] == "all 400 shown"


def test_refusals(case3, tmp_path, write):
    run, turns = case3[0], Rotation.from_quat(case3[1].quaternion.values)
    about_space = nt.twist(turns, run.time.values, axis_frame="space")
    lacking = run.drop_vars("kinetic_energy")
    for bad in (42, lacking, run.isel(time=[0]), run.expand_dims(member=3), turns, about_space, {"a": run}):
        with says():
            nt.view(bad)
    with says():
        nt.view(run).save(tmp_path / "film.gif")
    nt.save_run(run, tmp_path / "run.nc")
    nt.save_run(lacking, tmp_path / "part.nc")
    write("t,a_qw,a_qx,a_qy,a_qz,b_qw,b_qx,b_qy,b_qz\n" + "0,1,0,0,0,1,0,0,0\n" * 3, "two.csv")
    for code, *arguments in (
        (5, "nothing.nc"),
        (3, "run.nc", "part.nc"),
        (5, "run.nc", "--out", "/nonexistent/page.html"),
        (2,),
        (2, "run.nc", "--inverse"),
        (2, "run.nc", "--scalar-last"),
        (3, "two.csv"),  # two motions, of which columns must be chosen
    ):
        files = [str(tmp_path / one) if one.endswith((".nc", ".csv")) else one for one in arguments]
        result = ended(code, "view", *files, *["--no-open"] * bool(files))
        said(result.stderr.rpartition("Error: ")[2])


def test_shown_saved_opened(case3, tmp_path, monkeypatch):
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": [1, 2, 0]}
    page = nt.view(nt.integrate(nt.nontwisting([1, 2, 2.5]), **how))
    assert "default-src 'none'" in page.html
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', page._repr_html_())[1]) == page.html
    assert page.save(tmp_path / "page.html").read_text(encoding="utf-8") == page.html
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    path = page.open()
    assert opened == [path.as_uri()]
    assert [place.name for place in path.parent.iterdir()] == ["view.html"]
    assert path.is_relative_to(tmp_path)
    evil = "</script><b id=evil>&amp; $style"  # what comes from the run is text
    run = case3[0].assign_attrs(system=case3[0].attrs["system"].replace('"nontwisting"', json.dumps(evil)))
    text = nt.view(run, title=evil).html
    assert "<b id=evil>" not in text
    assert contents_of(text)["title"] == contents_of(text)["runs"][0]["name"] == evil


def test_reading_options(tmp_path):
    """Two files of one motion, of which one needs four options, show the same attitudes."""
    t = np.arange(50) / 25
    attitudes = Rotation.from_euler("ZYX", np.stack([np.sin(2 * t), 0.5 * np.sin(3 * t), 0.3 * t], axis=1))
    options = ["--columns", "ticks,a,b,c,d", "--scalar-first", "--inverse", "--time-unit", "ms"]
    pages = []
    for file, header, values, times, how in (
        ("plain.csv", "t,qx,qy,qz,qw", attitudes.as_quat(), t, []),
        ("the other.csv", "ticks,a,b,c,d", np.roll(attitudes.inv().as_quat(), 1, 1), 40 * np.arange(50), options),
    ):
        path = tmp_path / file
        np.savetxt(path, np.column_stack([times, values]), delimiter=",", header=header, comments="", fmt="%.17g")
        out = path.with_suffix(".html")
        shown = ended(0, "view", path, *how, "--out", out, "--no-open")
        again = shlex.split(re.search(r"to choose the axis: nontwist (.*) --axis AXIS, then", shown.stderr)[1])
        assert (again[:2], sorted(again[2:])) == (["twist", str(path)], sorted(how))
        ended(0, *again, "--axis", "y", "--no-figure", "--out", path.with_suffix(".nc"))
        pages.append(contents_of(out.read_text(encoding="utf-8"))["runs"][0])
    for key in ("attitude", "twist", "time"):
        assert numbers(pages[1][key]) == pytest.approx(numbers(pages[0][key]), abs=1e-6), key
    run = tmp_path / "run.nc"
    nt.save_run(nt.simulate(nt.standard([3, 4, 5]), t_end=1, material_angular_velocity=(1, 1, 0)), run)
    ended(0, "view", run, path, *options, "--out", tmp_path / "both.html", "--no-open")


def test_the_command_writes_the_page(case3, here, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: bool(opened.append(address)))
    for name, run in (("a", case3[0]), ("b", case3[1]), ("twist", nt.twist(case3[1]))):
        nt.save_run(run, f"{name}.nc")
    q = case3[1].quaternion.values
    np.savetxt("recorded.csv", np.column_stack([case3[1].time, q]), delimiter=",", header="t,qx,qy,qz,qw", comments="")
    for page, words, *arguments in (
        ("a-view.html", "<title>Own</title>", "a.nc", "--title", "Own"),
        ("twist-view.html", "recorded motion, recorded", "twist.nc", "recorded.csv"),
    ):
        ended(0, "view", *arguments, "--no-open")
        assert words in Path(page).read_text(encoding="utf-8")
    assert Path("a-view.html").stat().st_size < 400_000
    assert opened == []
    result = ended(0, "view", "a.nc", "b.nc", "--out", "both.html")
    assert (result.stdout, opened) == ("", [(here / "both.html").as_uri()])
    assert "no browser was found; open both.html in one" in result.stderr
    assert "non-twisting body and standard body" in Path("both.html").read_text(encoding="utf-8")
    page = nt.view(case3[0].assign_attrs(run_file='title = "A & B"\n'), case3[1])
    assert page.title == "A & B and standard body"
    assert "<title>A &amp; B and standard body</title>" in page.html


HEADS = "[...document.querySelectorAll('.rowhead')].map((head) => head.clientHeight)"
WIDE = {"viewport": {"width": 1280, "height": 1500}}


def real(text):
    return float(text.replace("−", "-").rstrip("°"))


def clock(page):
    return real(page.inner_text("#clock").split()[0])


def places(page):
    """The axis of each run, as the page says."""
    return [[real(x) for x in text.split("(")[1][:-1].split(",")] for text in page.locator(".place").all_inner_texts()]


def pictures(page):
    return page.evaluate("[...document.querySelectorAll('.globe canvas')].map((canvas) => canvas.toDataURL())")


def lines(page):
    """Where the time lines stand, from 0 at 0 s to 1 at 5 s, by the ticks of the axes."""
    return page.evaluate(
        """[...document.querySelectorAll('.plots')].map((plots) => {
          const line = plots.querySelector('.line').getBoundingClientRect();
          const texts = [...plots.querySelectorAll('.xtick')], last = Number(texts.at(-1).textContent);
          const ticks = texts.map((text) => text.getBoundingClientRect());
          const middle = (box) => (box.left + box.right) / 2;
          return ((middle(line) - middle(ticks[0])) / (middle(ticks.at(-1)) - middle(ticks[0]))) * (last / 5);
        })"""
    )


def plays(page, start, stop):
    """That the clock runs from the one act to the other, and then stands."""
    before = clock(page)
    start()
    until(page, lambda: clock(page) > before + 0.05)
    stop()
    stopped = clock(page)
    frames(page, 10)
    assert clock(page) == stopped


def test_browser_plays_and_scrubs(case3, visit):
    page = visit(nt.view(*case3).html, viewport={"width": 1280, "height": 900})
    assert page.evaluate("runs.map((run) => run.panels.flatMap((panel) => panel.curves).length)") == [9, 8]
    at_start = pictures(page)
    assert (len(at_start), clock(page)) == (2, 0)
    plays(page, lambda: page.click("#play"), lambda: page.click("#play"))
    page.fill("#scrub", "2.5")
    assert clock(page) == 2.5
    between = page.evaluate("runs.map((run) => run.scene.motion.at(2.503).triad)")
    shown = np.reshape([real(text) for text in page.locator(".part b").all_inner_texts()], (2, 3))
    for run, place, triad, angles in zip(case3, places(page), between, shown, strict=True):
        assert place == pytest.approx(run.directors.sel(time=2.5, director=3).values, abs=6e-4)
        assert np.array(triad) == pytest.approx(nt.resample(run, [2.503]).directors.values[0], abs=1e-3)
        at = nt.twist(run).sel(time=2.5)
        expected = [at.swing_twist_angle, at.twist_angle, at.solid_angle]
        assert angles == pytest.approx(np.degrees(expected), abs=0.06)
    assert all(a != b for a, b in zip(at_start, pictures(page), strict=True))
    assert lines(page) == pytest.approx([0.5, 0.5], abs=0.01)
    psi = [text.split()[2] for text in page.locator(".turn").all_inner_texts()]
    assert psi == ["0.0°", f"{np.degrees(float(at.twist_angle)):.1f}°".replace("-", "−")]
    for name in ("#rotor", "#weight"):  # these bodies have none
        assert not page.locator(name).is_visible()
    for centre, expected in (([0.3, 0, 0], [0.4, 0, 0, 0]), ([0, 0, 0], [0.1, 0.1, 0.1, 0.125])):
        assert page.evaluate(LEAVES, centre) == pytest.approx(expected)


# How far from the pivot arrows leave a box, which may be off the pivot.
LEAVES = """(centre) => {
    const half = [.1, .1, .1], edges = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    Object.assign(runs[0].scene.motion, { half, edges, centre });
    return [[1,0,0],[-1,0,0],[0,1,0],[.8,.6,0]].map((d) => runs[0].scene.leaves(d));
}"""


def test_rotors_in_a_browser(visit):
    """The wheels and arrows h: what they are is said, and drawn, in the dark, which is preferred, and in the light."""
    load = nt.rotor((0.6, 0, 0.8), [0, 2], [0, 12])
    how = {"t_end": 3, "step": 0.01, "material_angular_velocity": (0.3, 0.1, 1)}
    body = nt.standard([3, 4, 5])
    runs = [nt.simulate(body, load=each, **how) for each in (load, load + nt.rotor((0, 1, 0), -5))]
    page = visit(nt.view(*runs).html, color_scheme="dark")
    page.fill("#scrub", "1")
    assert page.evaluate("runs.map((run) => run.scene.motion.wheels(1).map(({ size }) => 12 * size))") == [
        pytest.approx([6], rel=1e-6),
        pytest.approx([6, -5], rel=1e-6),
    ]
    assert page.locator("#rotor").inner_text() == "wheel: rotor; arrow h: its momentum"
    for told in page.locator(".watch").all_inner_texts():
        said(told)
    heads = page.locator(".rowhead").all_inner_texts()
    assert ["".join(head.split()) for head in heads if head.startswith("Rotor")] == [
        "Rotormomentum(kgm²/s)h6.00",
        "Rotormomentum(kgm²/s)h16.00h2−5.00",
    ]
    charts, brightness = [], []
    for _ in range(2):
        charts.append(page.evaluate("document.querySelector('.chart').toDataURL()"))
        ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
        brightness.append(int(re.search(r"\d+", ground)[0]))
        assert page.evaluate(LOW_CONTRAST) == []
        rgb = [int(page.evaluate("ink.rotor")[k : k + 2], 16) for k in (1, 3, 5)]
        for picture in pictures(page):
            dots = np.asarray(Image.open(BytesIO(base64.b64decode(picture.partition(",")[2]))).convert("RGB"))
            assert np.count_nonzero((dots == rgb).all(-1)) > 100
        page.keyboard.press("d")
    assert charts[0] != charts[1]
    assert brightness[0] < 50
    assert brightness[1] > 200
    page.set_viewport_size({"width": 390, "height": 844})
    until(page, lambda: page.evaluate("document.documentElement.scrollWidth") <= 390)


def test_a_pendulum_in_a_browser(visit):
    """It is seen as in films; the vertical and the centre of mass are drawn, and said. Its charts have two ticks."""
    rod = nt.heavy_top([0.025, 0.025, 1e-5], mass=0.3, centre_of_mass=(0, 0, 0.25), gravity=(0, -9.81, 0))
    run = nt.simulate(rod, t_end=2, step=0.01, rotation=Rotation.from_euler("x", 30, degrees=True))
    page = visit(nt.view(run).html, viewport={"width": 500, "height": 900})
    expected = camera_of([Motion(content(run))]).view()
    assert np.array(page.evaluate("viewFrom(camera)")) == pytest.approx(expected)
    page.evaluate("turnBy(0.5, 0.5)")
    assert np.array(page.evaluate("viewFrom(camera)")) != pytest.approx(expected)
    page.keyboard.press("r")
    assert np.array(page.evaluate("viewFrom(camera)")) == pytest.approx(expected)
    legend = page.locator("#weight").inner_text()
    assert legend == "vertical; arrow g: gravity; line from the pivot to the centre of mass"
    written = """() => {
        const { scene } = runs[0], told = [], { write } = scene;
        scene.write = (text, place, colour) => { told.push([text, ...place]); write.call(scene, text, place, colour); };
        render();
        const { canvas, centre, radius } = scene;
        return { told, size: [canvas.clientWidth, canvas.clientHeight], centre, radius };
    }"""
    found = page.evaluate(written)
    (place,) = [np.array(place) for text, *place in found["told"] if text == "g"]
    assert np.hypot(*(place - found["centre"])) > 1.2 * found["radius"]
    assert all(10 < x < size - 10 for x, size in zip(place, found["size"], strict=True))
    spans = [[-0.0454, 0.0454], [0.0, 1.08], [-0.3, 6.0], [-30, 30], [-1.9, 1.9], [1e-7 / 3, 2e-7]]
    rng = np.random.default_rng(2)
    spans += [np.sort(rng.normal(size=2) * 10.0 ** rng.integers(-6, 6)).tolist() for _ in range(200)]
    for (low, high), ticks in zip(spans, page.evaluate("(s) => s.map((x) => ticksOf(...x, 4))", spans), strict=True):
        assert 2 <= len({tick["text"] for tick in ticks}) == len(ticks) <= 9, (low, high)
        assert all(low - 1e-9 * abs(low) <= tick["value"] <= high + 1e-9 * abs(high) for tick in ticks)


@pytest.mark.long
def test_keys_and_drags(case3, visit):
    page = visit(nt.view(*case3).html, **WIDE)
    press, speed = page.keyboard.press, "Number(document.getElementById('speed').value)"
    before, box = pictures(page), page.locator("canvas").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 30, steps=4)
    page.mouse.up()
    turned = pictures(page)
    assert all(a != b for a, b in zip(before, turned, strict=True))
    page.mouse.move(x + 160, y)
    assert pictures(page) == turned
    press("r")
    page.focus("canvas")
    assert pictures(page) == before
    press("ArrowUp")
    assert (pictures(page) == before, clock(page)) == (False, 0)
    box = page.locator(".plots").last.bounding_box()
    page.mouse.click(box["x"] + 58 + 0.3 * (box["width"] - 72), box["y"] + 90)
    assert [clock(page) / 5, *lines(page)] == pytest.approx([0.3] * 3, abs=0.005)
    page.evaluate("document.activeElement.blur()")
    for key, time in (("End", 5), ("Home", 0), ("ArrowRight", 0.05), ("Shift+ArrowRight", 0.55), ("ArrowLeft", 0.5)):
        press(key)
        assert clock(page) == pytest.approx(time)
    speeds = [page.evaluate(speed)]
    for key in "+-":
        press(key)
        speeds.append(page.evaluate(speed))
    assert speeds[1] > speeds[0] == speeds[2]
    plays(page, *[lambda: press("Space")] * 2)
    press("End")
    press("Space")  # plays from the start again
    until(page, lambda: clock(page) < 4)
    page.focus("#theme")
    press("Space")
    pressed = page.get_attribute("#theme", "aria-pressed"), page.get_attribute("#play", "aria-label")
    assert pressed == ("true", "Pause")


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2])
def test_legible_and_named(case3, visit, count):
    page = visit(nt.view(*case3[:count]).html)
    for width in (1280, 900, 390, 320, 700):
        page.set_viewport_size({"width": width, "height": 800})
        until(page, lambda width=width: page.evaluate("document.documentElement.scrollWidth") <= width)
        until(page, lambda: max(page.evaluate(HEADS)) <= (50 if page.locator(".narrow").count() else 30))
        page.fill("#scrub", "1")
        until(page, lambda: lines(page) == pytest.approx([0.2] * count, abs=0.02))
    assert page.evaluate(UNNAMED) == []
    assert page.get_attribute("html", "lang") == "en"
    assert page.get_by_role("slider", name="Time").count() == 1
    assert page.locator("[aria-live], output").count() == 0


@pytest.mark.long
def test_touch_and_notebooks(case3, visit):
    page = visit(nt.view(case3[0]).html, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    plays(page, lambda: page.tap("#play"), lambda: page.tap("#play"))
    page.evaluate("scrollTo(0, document.querySelector('.plots').offsetTop - 100)")
    box = page.locator(".plots").bounding_box()
    page.touchscreen.tap(box["x"] + 58 + 0.8 * (box["width"] - 72), box["y"] + 90)
    assert clock(page) == pytest.approx(4, abs=0.05)
    page = visit(f"<!doctype html><p id=clock>.</p>{nt.view(case3[0])._repr_html_()}", **WIDE)
    inside = page.frame_locator("iframe")
    inside.locator("#play").click()
    until(page, lambda: float(inside.locator("#clock").inner_text().split()[0]) > 0)
    inside.locator("#play").click()


@pytest.mark.long
def test_unusual_runs_are_drawn(visit):
    body = nt.standard([1, 2, 2.5])
    for run in (
        nt.simulate(nt.standard([1, 1, 1e-3]), t_end=1e-4, step=1e-6, material_angular_velocity=[1e4, 0, 1e4]),
        nt.simulate(body, t_end=500, step=0.02, material_angular_velocity=[1, 2, 3]),
        nt.simulate(body, t_start=-3, t_end=-1, step=0.1),
    ):
        page = visit(nt.view(run, run.isel(time=slice(0, 5))).html)
        page.keyboard.press("End")
        assert clock(page) == pytest.approx(float(run.time[-1]), rel=1e-3)
        for place, k in zip(places(page), (-1, 4), strict=True):
            assert place == pytest.approx(run.directors.isel(time=k).sel(director=3).values, abs=6e-4)
        assert "NaN" not in page.inner_text("body")


def test_completed_states():
    fast = nt.simulate(nt.standard([2, 3, 4]), t_end=0.4, step=0.005, angular_velocity=[0, 1, 120])
    time = smooth(fast)["time"].values
    assert np.isin(fast["time"], time).all()
    assert np.diff(time).min() == pytest.approx(0.005 / 7, rel=0.2)
    near = nt.simulate(nt.nontwisting([3, 4, 5]), times=[0, 0.5, np.nextafter(0.5, 1), 1], angular_velocity=(0, 2, 0))
    with pytest.warns(UserWarning, match="duplicate"):  # times that differ by round-off are shown once
        assert content(near)["end"] == 1.0
