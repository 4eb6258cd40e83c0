"""The page of `view`: its data, and what it does in a real browser."""

import base64
import html
import json
import re
import shlex
import tempfile
import webbrowser
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import LOW_CONTRAST, PAPER_J, frames, until
from conftest import nontwist as command
from nontwist.cli.outcomes import smooth
from nontwist.loads.kinds import load_in_words
from nontwist.paper.tables import CASES
from nontwist.viewer.content import POINTS, STATES, content
from nontwist.viewer.drawing import Motion, camera_of
from refusals import said, says


@pytest.fixture(scope="module")
def case3():
    """The paper's case 3, and a free standard body with the same inertia."""
    case, span = CASES[3], {"t_end": 5, "step": 0.01}
    W = case.angular_velocity
    run = nt.simulate(nt.nontwisting(PAPER_J), material_angular_velocity=W, load=case.load(), **span)
    return run, nt.simulate(nt.standard(PAPER_J), material_angular_velocity=(*W[:2], 1.0), **span)


def numbers(text):
    return np.frombuffer(base64.b64decode(text), "<f4").astype(float)


def test_triad_and_twist_give_the_non_twisting_frame():
    axis = np.array([0.3, -0.4, 1.2]) / 1.3
    J = [[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]
    for run, n in (
        (nt.simulate(nt.standard(J), t_end=3, step=0.01, material_angular_velocity=[1, 2, 1]), [0, 0, 1]),
        (nt.simulate(nt.suslov(J, axis), t_end=3, step=0.01, material_angular_velocity=[4, 3, 0]), axis),
    ):
        page, expected = content(run), nt.twist(run, axis=n)
        triad = np.swapaxes(Rotation.from_quat(numbers(page["attitude"]).reshape(-1, 4)).as_matrix(), 1, 2)
        psi = numbers(page["twist"])[:, None]
        frame = np.cos(psi) * triad[:, 0] - np.sin(psi) * triad[:, 1]
        assert frame == pytest.approx(expected.frame.values[:, 0], abs=1e-6)
        assert triad[:, 2] == pytest.approx(np.einsum("tix,i->tx", run.directors.values, n), abs=1e-6)
    assert content(run)["labels"][2] == "n"


def test_the_box_has_the_inertia_of_the_body():
    sides, turn = np.array([1.0, 2.0, 3.0]), Rotation.from_rotvec([0.3, -0.7, 0.4]).as_matrix()
    J = np.diag([sides[1] ** 2 + sides[2] ** 2, sides[0] ** 2 + sides[2] ** 2, sides[0] ** 2 + sides[1] ** 2]) / 12
    run = nt.simulate(nt.standard(turn @ J @ turn.T), t_end=0.1, step=0.05, angular_velocity=[1, 0, 0])
    box = content(run)["box"]
    assert np.array(box["half"]) / box["half"][0] == pytest.approx(sides)
    assert abs(np.array(box["edges"]) @ turn) == pytest.approx(np.eye(3), abs=1e-12)


def panel(page, title):
    (found,) = [each for each in page["panels"] if each["title"] == title]
    return found


def test_the_twist_of_coarse_steps_is_drawn_from_the_start():
    """Samples as coarse as these tell the twist to 0.4 rad only; the integrator has counted it."""
    how = {"t_end": 20, "material_angular_velocity": (0.1, 2, 0.1)}
    coarse, fine = (nt.simulate(nt.standard([3, 4, 5]), step=step, **how) for step in (0.5, 0.01))
    assert nt.twist(coarse).error_estimate[-1] > 0.3
    (curve,) = panel(content(coarse), "Twist")["curves"]
    expected = np.degrees(nt.twist(fine).twist_angle.values[::50])
    assert abs(numbers(curve["values"]) - expected).max() < 1e-4 * expected[-1]


def test_what_tells_of_the_twist_comes_first(case3):
    held, free = map(content, case3)
    titles = [each["title"] for each in held["panels"]]
    assert titles == ["Twist", "Reaction moment", "Spatial momentum", "Material momentum", "Kinetic energy"]
    assert "Reaction moment" not in [each["title"] for each in free["panels"]]
    psi = nt.twist(case3[1])
    (curve,) = panel(free, "Twist")["curves"]
    assert numbers(curve["values"]) == pytest.approx(np.degrees(psi.twist_angle.values), rel=1e-6, abs=1e-5)
    for key, name in (("swing", "swing_twist_angle"), ("area", "solid_angle")):
        assert numbers(free[key]) == pytest.approx(psi[name].values, abs=2e-6)
    for title, index in (("Twist", 0), ("Material momentum", 2)):  # round-off is not shown
        assert not numbers(panel(held, title)["curves"][index]["values"]).any()
    assert abs(case3[0].material_momentum.sel(director=3)).max() < 1e-9


def test_recordings_are_shown_as_runs_are(case3):
    free = case3[1]
    turns = Rotation.from_quat(free.quaternion.values)
    for motion in (nt.twist(turns, free.time.values), free.quaternion, free[["quaternion", "directors"]].drop_attrs()):
        page, run = content(motion), content(free)
        assert page["name"] == "recorded motion"
        for key in ("attitude", "twist", "swing", "area", "time"):
            assert numbers(page[key]) == pytest.approx(numbers(run[key]), abs=1e-6), key
        assert [each["title"] for each in page["panels"]] == ["Twist", "Solid angle of the path"]
    tilted = nt.twist(turns, free.time.values, axis=[1, 2, 2])
    q = numbers(content(tilted)["attitude"]).reshape(-1, 4)
    assert Rotation.from_quat(q).as_matrix()[:, :, 2] == pytest.approx(turns.apply([1 / 3, 2 / 3, 2 / 3]), abs=1e-6)
    with pytest.raises(ValueError, match=r"the recording has no times; use view\(twist\(motion, time\)\)"):
        nt.view(turns)
    with says():
        nt.view(nt.twist(turns, free.time.values, axis_frame="space"))


def test_the_page_says_what_the_box_and_the_arrows_are():
    run = nt.simulate(nt.standard([3, 4, 5]), t_end=1, step=0.05, material_angular_velocity=(0.1, 2, 0.1))
    about = content(run)["about"]
    assert about["Box"] == "the inertia of the body"
    assert "Arrows" not in about
    seen = content(nt.twist(run, axis="x"))
    said(seen["about"]["Box"])
    assert seen["about"]["Arrows"] == "n: the body axis (1, 0, 0); t₁, t₂: fixed in the body, perpendicular to n"
    said(seen["watch"])
    held = content(
        nt.simulate(nt.suslov([3, 4, 5], (0, 1, 0)), t_end=1, step=0.05, material_angular_velocity=(1, 0, 1))
    )
    assert held["about"]["Arrows"] == "n: the body axis (0, 1, 0); t₁, t₂: fixed in the body, perpendicular to n"
    assert held["watch"].startswith("The body may not turn about n: ")


def test_long_runs_are_decimated_and_keep_their_peaks():
    W = (0.6, 0.2, 0.3)
    run = nt.simulate(nt.standard([1, 2, 2.5]), t_end=300, step=0.01, material_angular_velocity=W)
    run["kinetic_energy"][12345] = 99.0
    page = content(run)
    assert page["thinned"]
    assert page["about"]["States"] == f"{STATES} of 30001 shown, evenly; curves keep every peak"
    (K,) = panel(page, "Kinetic energy")["curves"]
    assert numbers(K["values"]).max() == 99
    assert numbers(K["values"]).size <= POINTS + 2
    assert numbers(page["time"])[[0, -1]] == pytest.approx([0, 300])
    assert len(nt.view(run, run).html.encode()) < 1e6
    fast = nt.simulate(
        nt.standard([1, 2, 2.5]), t_end=300, step=0.01, angular_velocity=[0, 0, 20]
    )  # 6 or 7 steps apart
    assert "Between two of them the body turns by up to 1.4 rad" in content(fast)["about"]["States"]
    assert content(fast.isel(time=slice(0, 400)))["about"]["States"] == "all 400 shown"


def test_what_comes_from_the_run_is_text(case3):
    evil = "</script><b id=evil>&amp; $style"
    run = case3[0].assign_attrs(system=case3[0].attrs["system"].replace('"nontwisting"', json.dumps(evil)))
    page = nt.view(run, title=evil).html
    assert "<b id=evil>" not in page
    page = json.loads(re.search(r'id="content">(.*?)</script>', page, re.DOTALL)[1])
    assert page["title"] == page["runs"][0]["name"] == evil


LOADS = (
    CASES[3].load(),
    nt.sine([0, 0, 2], 3, phase=0.5, frame="space"),
    2 * nt.damping(0.1),
    nt.body_moment([0, 1], [[0, 0, 1], [0, 0, 0]]),
    2 * nt.space_moment(abs),
    nt.moment(abs),
    nt.pulse([1, 0, 0], 1, 2, shape="rectangle") + nt.damping(np.diag([1, 2, 3])),
    nt.director_forces([0, 1], np.zeros((2, 3, 3))),
    2 * nt.director_forces(abs, frame="body"),
    2 * nt.spring(3, (0, 0, 1), (1, 0, 0), 0.5),
    nt.dipole((0, 0, 1), (0, 1, 0)),
    nt.potential((0, 0, 2), quadratic=np.eye(3)),
    2 * nt.dry_friction(0.5, "z"),
    nt.dry_friction(0.5),
    nt.gravity_gradient(1e-3),
    nt.gravity_gradient(0.2, eccentricity=0.1),
    2 * nt.memory_load(abs, abs, 0),
    0 * CASES[1].load(),
)


def test_loads_in_words():
    for load in LOADS:
        said(load_in_words(json.loads(json.dumps(load.description))))


def test_a_run_in_words():
    top = nt.heavy_top([2.0, 2.2, 1.0], 1.5, [0.1, 0.0, 0.6])
    page = content(nt.simulate(top, t_end=1, step=0.1, angular_velocity=[0, 0, 3], integrator="split", order=2))
    assert page["name"] == "heavy top"
    assert page["about"]["Body"] == "free to turn; principal moments 1, 2, 2.2 kg m²; gravity"
    assert page["about"]["Integrator"].startswith("split, order 2")
    assert page["about"]["Integrator"].endswith("step 0.1 s")
    assert [curve["letter"] for curve in panel(page, "Energy")["curves"]] == ["K", "V", "K+V"]


def test_what_is_no_run_is_refused(case3, tmp_path):
    run = case3[0]
    for bad in (42, run.drop_vars("kinetic_energy"), run.isel(time=[0]), run.expand_dims(member=3)):
        with says():
            nt.view(bad)
    with pytest.raises(ValueError, match=re.escape("view accepts one run or two, view(a, b), not a dictionary")):
        nt.view({"a": run})
    with pytest.raises(ValueError, match=re.escape("a page is written to a file that ends in .html, got 'film.gif'")):
        nt.view(run).save(tmp_path / "film.gif")


def test_a_view_is_shown_saved_opened(tmp_path, monkeypatch):
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": [1, 2, 0]}
    page = nt.view(nt.integrate(nt.nontwisting([1, 2, 2.5]), **how))
    assert "default-src 'none'" in page.html
    frame = page._repr_html_()
    assert html.unescape(re.search(r'srcdoc="([^"]*)"', frame)[1]) == page.html
    assert page.save(tmp_path / "page.html").read_text(encoding="utf-8") == page.html
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    path = page.open()
    assert opened == [path.as_uri()]
    assert [place.name for place in path.parent.iterdir()] == ["view.html"]
    assert path.is_relative_to(tmp_path)


def nontwist(*arguments):
    return command("view", *arguments)


def test_a_recording_is_read_by_the_options_of_twist(tmp_path):
    """Two files of one motion, of which one needs four options, show the same attitudes."""
    t = np.arange(50) / 25
    attitudes = Rotation.from_euler("ZYX", np.stack([np.sin(2 * t), 0.5 * np.sin(3 * t), 0.3 * t], axis=1))
    plain, other = tmp_path / "plain.csv", tmp_path / "the other.csv"
    for path, names, values, times in (
        (plain, "t,qx,qy,qz,qw", attitudes.as_quat(), t),
        (other, "ticks,a,b,c,d", np.roll(attitudes.inv().as_quat(), 1, axis=1), 40 * np.arange(50)),
    ):
        np.savetxt(path, np.column_stack([times, values]), delimiter=",", header=names, comments="", fmt="%.17g")
    options = ["--columns", "ticks,a,b,c,d", "--scalar-first", "--inverse", "--time-unit", "ms"]
    pages = []
    for path, how in ((plain, []), (other, options)):
        out = path.with_suffix(".html")
        shown = nontwist(str(path), *how, "--out", str(out), "--no-open")
        assert shown.exit_code == 0, shown.stderr
        again = shlex.split(re.search(r"to choose the axis: nontwist (.*) --axis AXIS, then", shown.stderr)[1])
        assert (again[:2], sorted(again[2:])) == (["twist", str(path)], sorted(how))
        chosen = command(*again, "--axis", "y", "--no-figure", "--out", str(path.with_suffix(".nc")))
        assert chosen.exit_code == 0, chosen.stderr
        text = re.search(r'id="content">(.*?)</script>', out.read_text(encoding="utf-8"), re.DOTALL)[1]
        pages.append(json.loads(text)["runs"][0])
    for key in ("attitude", "twist", "time"):
        assert numbers(pages[1][key]) == pytest.approx(numbers(pages[0][key]), abs=1e-6), key
    run = tmp_path / "run.nc"
    nt.save_run(nt.simulate(nt.standard([3, 4, 5]), t_end=1, material_angular_velocity=(1, 1, 0)), run)
    for option in ("--inverse", "--scalar-last"):
        refused = nontwist(str(run), option)
        assert (refused.exit_code, refused.stderr.splitlines()[-1]) == (
            2,
            f"Error: Invalid value for {option}: applies to recordings only; {run} is a result",
        )
    both = nontwist(str(run), str(other), *options, "--out", str(tmp_path / "both.html"), "--no-open")
    assert both.exit_code == 0, both.stderr


def test_a_recording_that_needs_options_names_them(tmp_path):
    path = tmp_path / "both.csv"
    path.write_text(
        "t,a_qw,a_qx,a_qy,a_qz,b_qw,b_qx,b_qy,b_qz\n" + "".join(f"{t},1,0,0,0,1,0,0,0\n" for t in (0, 1, 2)),
        encoding="utf-8",
    )
    shown = nontwist(str(path), "--out", str(tmp_path / "both.html"), "--no-open")
    assert shown.exit_code == 3
    said(shown.stderr)


def test_the_title_of_a_run_file_is_that_of_the_page(case3, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    named = case3[0].assign_attrs(run_file='title = "A & B"\n')
    assert nt.view(named).title == "A & B"
    assert "<title>A &amp; B</title>" in nt.view(named).html
    assert nt.view(named, case3[1]).title == "A & B and standard body"
    nt.save_run(named, "a.nc")
    assert nontwist("a.nc", "--no-open", "--title", "Own").exit_code == 0
    assert "<title>Own</title>" in Path("a-view.html").read_text(encoding="utf-8")
    missing = nontwist("b.nc", "--out", "a-view.html")
    assert missing.stderr == "no such file: b.nc\n"


def test_the_command_writes_the_page(case3, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: bool(opened.append(address)))
    for name, run in zip(("a", "b"), case3, strict=True):
        nt.save_run(run, f"{name}.nc")
    assert nontwist("a.nc", "--no-open").exit_code == 0
    assert opened == []
    result = nontwist("a.nc", "b.nc", "--out", "both.html")
    assert result.exit_code == 0
    assert result.stdout == ""
    assert opened == [(tmp_path / "both.html").as_uri()]
    assert "no browser was found; open both.html in one" in result.stderr
    assert "non-twisting body and standard body" in Path("both.html").read_text(encoding="utf-8")
    assert Path("a-view.html").stat().st_size < 400_000
    nt.save_run(nt.twist(case3[1]), "twist.nc")
    q = case3[1].quaternion.values
    np.savetxt("recorded.csv", np.column_stack([case3[1].time, q]), delimiter=",", header="t,qx,qy,qz,qw", comments="")
    assert nontwist("twist.nc", "recorded.csv", "--no-open").exit_code == 0
    assert "recorded motion, second run" in Path("twist-view.html").read_text(encoding="utf-8")


def test_errors_are_reported(case3, tmp_path):
    nt.save_run(case3[0], tmp_path / "run.nc")
    nt.save_run(case3[0].drop_vars("kinetic_energy"), tmp_path / "part.nc")
    for arguments, code in (
        (["nothing.nc"], 5),
        ([tmp_path / "run.nc", tmp_path / "part.nc"], 3),
        ([tmp_path / "run.nc", "--out", "/nonexistent/page.html"], 5),
        ([], 2),
    ):
        result = nontwist(*arguments, *["--no-open"] * bool(arguments))
        assert result.exit_code == code
        said(result.stderr.rpartition("Error: ")[2])


CHART = "document.querySelector('.chart').toDataURL()"
HEADS = "[...document.querySelectorAll('.rowhead')].map((head) => head.clientHeight)"


def clock(page):
    return float(page.inner_text("#clock").split()[0].replace("−", "-"))


def places(page):
    """The axis of each run, as the page says."""
    texts = page.locator(".place").all_inner_texts()
    return [[float(x) for x in text.replace("−", "-").split("(")[1][:-1].split(",")] for text in texts]


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


def test_the_page_plays_and_scrubs_in_a_browser(case3, visit):
    page = visit(nt.view(*case3).html, viewport={"width": 1280, "height": 900})
    assert page.locator(".globe canvas").count() == 2
    assert page.evaluate("runs.map((run) => run.panels.flatMap((panel) => panel.curves).length)") == [9, 8]
    at_start = pictures(page)
    assert clock(page) == 0

    page.click("#play")
    until(page, lambda: clock(page) > 0.05)
    page.click("#play")
    stopped = clock(page)
    frames(page, 10)
    assert clock(page) == stopped > 0

    page.fill("#scrub", "2.5")
    assert clock(page) == 2.5
    for run, place in zip(case3, places(page), strict=True):
        assert place == pytest.approx(run.directors.sel(time=2.5, director=3).values, abs=6e-4)
    between = page.evaluate("runs.map((run) => run.scene.motion.at(2.503).triad)")
    for run, triad in zip(case3, between, strict=True):
        assert np.array(triad) == pytest.approx(nt.resample(run, [2.503]).directors.values[0], abs=1e-3)
    assert all(a != b for a, b in zip(at_start, pictures(page), strict=True))
    assert lines(page) == pytest.approx([0.5, 0.5], abs=0.01)
    shown = [float(text[:-1].replace("−", "-")) for text in page.locator(".part b").all_inner_texts()]
    for run, (tau, psi, area) in zip(case3, [shown[k : k + 3] for k in (0, 3)], strict=True):
        at = nt.twist(run).sel(time=2.5)
        assert [tau, psi, area] == pytest.approx(
            np.degrees([at.swing_twist_angle, at.twist_angle, at.solid_angle]), abs=0.06
        )
    psi = [text.split()[2] for text in page.locator(".turn").all_inner_texts()]
    assert psi[0] == "0.0°"
    expected = float(nt.twist(case3[1]).twist_angle.sel(time=2.5))
    assert psi[1] == f"{np.degrees(expected):.1f}°".replace("-", "−")


def test_rotors_in_a_browser(visit):
    """The wheels and arrows h: what they are is said, and drawn, in the light and in the dark."""
    load = nt.rotor((0.6, 0, 0.8), [0, 2], [0, 12])
    how = {"t_end": 3, "step": 0.01, "material_angular_velocity": (0.3, 0.1, 1)}
    body = nt.standard([3, 4, 5])
    page = visit(
        nt.view(nt.simulate(body, load=load, **how), nt.simulate(body, load=load + nt.rotor((0, 1, 0), -5), **how)).html
    )
    page.fill("#scrub", "1")
    assert page.evaluate("runs.map((run) => run.scene.motion.wheels(1).map(({ size }) => 12 * size))") == [
        pytest.approx([6], rel=1e-6),
        pytest.approx([6, -5], rel=1e-6),
    ]
    assert page.locator("#rotor").inner_text() == "wheel: rotor; arrow h: its momentum"
    told = page.locator(".watch").all_inner_texts()
    assert told[0].endswith("The wheel is its rotor, the arrow h its momentum relative to the body.")
    assert told[1].endswith("The 2 wheels are its rotors, the arrows h their momenta relative to the body.")
    heads = page.locator(".rowhead").all_inner_texts()
    assert ["".join(head.split()) for head in heads if head.startswith("Rotor")] == [
        "Rotormomentum(kgm²/s)h6.00",
        "Rotormomentum(kgm²/s)h16.00h2−5.00",
    ]
    tint = """(name) => {
        const [r, g, b] = [1, 3, 5].map((k) => parseInt(ink.rotor.slice(k, k + 2), 16));
        const canvas = document.querySelector('.globe canvas');
        const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
        let count = 0;
        for (let k = 0; k < data.length; k += 4) count += data[k] === r && data[k + 1] === g && data[k + 2] === b;
        return count;
    }"""
    assert page.evaluate(tint) > 100  # the arrow
    page.keyboard.press("d")
    assert page.evaluate(tint) > 100
    assert page.evaluate(LOW_CONTRAST) == []
    page.set_viewport_size({"width": 390, "height": 844})
    until(page, lambda: page.evaluate("document.documentElement.scrollWidth") <= 390)
    free = visit(nt.view(nt.simulate(body, **how)).html)
    assert not free.locator("#rotor").is_visible()


def test_a_pendulum_in_a_browser(visit):
    """It is seen as in films; the vertical and the centre of mass are drawn, and what they are is said."""
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
    places = {text: np.array(place) for text, *place in found["told"]}
    assert np.hypot(*(places["g"] - found["centre"])) > 1.2 * found["radius"]
    assert all(10 < x < size - 10 for x, size in zip(places["g"], found["size"], strict=True))
    assert not visit(nt.view(nt.simulate(nt.standard([3, 4, 5]), t_end=1)).html).locator("#weight").is_visible()


def test_the_box_that_is_off_the_pivot_is_left_where_arrows_leave_it(visit):
    """From the pivot along the axes: out of a cube of half side 0.1 at (0.3, 0, 0) at 0.4, past it at 0."""
    page = visit(nt.view(nt.simulate(nt.standard([3, 4, 5]), t_end=1)).html)
    page.evaluate("""Object.assign(runs[0].scene.motion,
        {half: [.1, .1, .1], edges: [[1,0,0],[0,1,0],[0,0,1]], centre: [.3,0,0]})""")
    leaves = page.evaluate("[[1,0,0],[-1,0,0],[0,1,0],[.8,.6,0]].map((d) => runs[0].scene.leaves(d))")
    assert leaves == pytest.approx([0.4, 0, 0, 0])
    page.evaluate("runs[0].scene.motion.centre = [0, 0, 0]")
    leaves = page.evaluate("[[1,0,0],[-1,0,0],[.8,.6,0]].map((d) => runs[0].scene.leaves(d))")
    assert leaves == pytest.approx([0.1, 0.1, 0.125])


def test_every_chart_has_two_ticks(visit):
    page = visit(nt.view(nt.simulate(nt.standard([3, 4, 5]), t_end=1)).html)
    spans = [(-0.0454, 0.0454), (0.0, 1.08), (-0.3, 6.0), (-30, 30), (-1.9, 1.9), (1e-7 / 3, 2e-7)]
    rng = np.random.default_rng(2)
    spans += [tuple(np.sort(rng.normal(size=2) * 10.0 ** rng.integers(-6, 6))) for _ in range(200)]
    for low, high in spans:
        ticks = page.evaluate("([low, high]) => ticksOf(low, high, 4)", [float(low), float(high)])
        assert 2 <= len({tick["text"] for tick in ticks}) == len(ticks) <= 9, (low, high)
        assert all(low - 1e-9 * abs(low) <= tick["value"] <= high + 1e-9 * abs(high) for tick in ticks)


@pytest.mark.long
def test_keys(case3, visit):
    page = visit(nt.view(case3[1]).html)
    press, speed = page.keyboard.press, "Number(document.getElementById('speed').value)"
    for key, time in (("End", 5), ("Home", 0), ("ArrowRight", 0.05), ("Shift+ArrowRight", 0.55), ("ArrowLeft", 0.5)):
        press(key)
        assert clock(page) == pytest.approx(time)
    before = page.evaluate(speed)
    press("+")
    assert page.evaluate(speed) > before
    press("-")
    assert page.evaluate(speed) == before
    press("Space")
    assert page.get_attribute("#play", "aria-label") == "Pause"
    until(page, lambda: clock(page) > 0.6)
    press("Space")
    stopped = clock(page)
    frames(page, 10)
    assert clock(page) == stopped
    press("End")
    press("Space")  # plays from the start again
    until(page, lambda: clock(page) < 4)
    page.focus("#theme")
    press("Space")
    assert page.get_attribute("#theme", "aria-pressed") == "true"
    assert page.get_attribute("#play", "aria-label") == "Pause"


@pytest.mark.long
def test_drags_turn_both_spheres_and_scrub(case3, visit):
    page = visit(nt.view(*case3).html, viewport={"width": 1280, "height": 1500})
    before = pictures(page)
    box = page.locator("canvas").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 30, steps=4)
    page.mouse.up()
    turned = pictures(page)
    assert all(a != b for a, b in zip(before, turned, strict=True))
    page.mouse.move(x + 160, y)
    assert pictures(page) == turned
    page.keyboard.press("r")
    assert pictures(page) == before
    page.focus("canvas")
    page.keyboard.press("ArrowUp")
    assert pictures(page) != before
    assert clock(page) == 0

    box = page.locator(".plots").last.bounding_box()
    page.mouse.click(box["x"] + 58 + 0.3 * (box["width"] - 72), box["y"] + 90)
    assert clock(page) == pytest.approx(1.5, abs=0.02)
    assert lines(page) == pytest.approx([0.3, 0.3], abs=0.01)


@pytest.mark.long
def test_light_and_dark(case3, visit):
    ground = "getComputedStyle(document.body).backgroundColor"
    brightness = []
    for scheme in ("light", "dark"):
        page = visit(nt.view(case3[0]).html, color_scheme=scheme)
        brightness.append(int(re.search(r"\d+", page.evaluate(ground))[0]))
        drawn = pictures(page)
        curves = page.evaluate(CHART)
        page.click("#theme")
        brightness.append(int(re.search(r"\d+", page.evaluate(ground))[0]))
        assert pictures(page) != drawn
        assert page.evaluate(CHART) != curves
        assert page.evaluate(LOW_CONTRAST) == []
    light, toggled_dark, dark, toggled_light = brightness
    assert light == toggled_light > 200
    assert dark == toggled_dark < 50


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2])
def test_nothing_overflows(case3, visit, count):
    page = visit(nt.view(*case3[:count]).html)
    for width in (1280, 900, 390, 320, 700):
        page.set_viewport_size({"width": width, "height": 800})
        until(page, lambda width=width: page.evaluate("document.documentElement.scrollWidth") <= width)
        until(page, lambda: max(page.evaluate(HEADS)) <= (50 if page.locator(".narrow").count() else 30))
        page.fill("#scrub", "1")
        assert lines(page) == pytest.approx([0.2] * count, abs=0.02), width


@pytest.mark.long
def test_touch(case3, visit):
    page = visit(nt.view(case3[0]).html, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page.tap("#play")
    until(page, lambda: clock(page) > 0.05)
    page.tap("#play")
    page.evaluate("scrollTo(0, document.querySelector('.plots').offsetTop - 100)")
    box = page.locator(".plots").bounding_box()
    page.touchscreen.tap(box["x"] + 58 + 0.8 * (box["width"] - 72), box["y"] + 90)
    assert clock(page) == pytest.approx(4, abs=0.05)


@pytest.mark.long
def test_a_run_shows_in_a_notebook(case3, visit):
    notebook = f"<!doctype html><p id=clock>.</p>{nt.view(case3[0])._repr_html_()}"
    page = visit(notebook, viewport={"width": 1000, "height": 900})
    inside = page.frame_locator("iframe")
    inside.locator("#play").click()
    until(page, lambda: float(inside.locator("#clock").inner_text().split()[0]) > 0)
    inside.locator("#play").click()


@pytest.mark.long
def test_names_of_controls(case3, visit):
    page = visit(nt.view(*case3).html)
    unnamed = page.evaluate(
        """[...document.querySelectorAll('button, input, select, canvas, [role=img]')]
          .filter((e) => !(e.getAttribute('aria-label') || e.textContent.trim())).map((e) => e.outerHTML)"""
    )
    assert unnamed == []
    assert page.get_attribute("html", "lang") == "en"
    assert page.get_by_role("slider", name="Time").count() == 1
    assert page.locator("[aria-live], output").count() == 0


@pytest.mark.long
def test_unusual_runs_are_drawn(visit):
    body = nt.standard([1, 2, 2.5])
    for run in (
        nt.simulate(body, t_end=1, step=0.1),
        nt.simulate(nt.standard([1, 1, 1e-3]), t_end=1e-4, step=1e-6, material_angular_velocity=[1e4, 0, 1e4]),
        nt.simulate(body, t_end=500, step=0.02, material_angular_velocity=[1, 2, 3]),
        nt.simulate(body, t_start=-3, t_end=-1, step=0.1, material_angular_velocity=[0, 0, 1]),
    ):
        page = visit(nt.view(run, run.isel(time=slice(0, 5))).html)
        page.keyboard.press("End")
        assert clock(page) == pytest.approx(float(run.time[-1]), rel=1e-3)
        assert places(page)[0] == pytest.approx(run.directors.isel(time=-1).sel(director=3).values, abs=6e-4)
        assert places(page)[1] == pytest.approx(run.directors.isel(time=4).sel(director=3).values, abs=6e-4)
        assert "NaN" not in page.inner_text("body")


def test_states_are_added_between_stored_ones_at_times_that_are_apart():
    fast = nt.simulate(nt.standard([2, 3, 4]), t_end=4, step=0.005, angular_velocity=[0, 1, 120])
    time = smooth(fast)["time"].values
    assert np.isin(fast["time"], time).all()
    assert np.diff(time).min() == pytest.approx(0.005 / 7, rel=0.2)


def test_states_whose_times_differ_by_round_off_are_shown_once():
    near = nt.simulate(nt.nontwisting([3, 4, 5]), times=[0, 0.5, np.nextafter(0.5, 1), 1], angular_velocity=(0, 2, 0))
    with pytest.warns(UserWarning, match="duplicate"):
        assert content(near)["end"] == 1.0
