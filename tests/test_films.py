"""Films and pictures of runs: the same scene as the page, without a browser."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import nontwist
from nontwist import moment, view
from nontwist.geometry.stacks import arcs
from nontwist.geometry.values import short_repr
from nontwist.runfile import read_run_file
from nontwist.viewer import drawing
from nontwist.viewer.content import content, contents
from nontwist.viewer.drawing import Camera, Look, Motion, camera_of, colours, still
from nontwist.viewer.films import PAUSE, RATES, SECONDS, WIDTHS, _motions, save_film, save_still

HOW = {"t_end": 3, "step": 0.02, "material_angular_velocity": (1.2, 1.0, 0)}


@pytest.fixture(scope="module")
def runs():
    return [nt.simulate(body([3.2, 2.2, 1.3]), **HOW) for body in (nt.standard, nt.nontwisting)]


def test_a_path_of_few_states_is_drawn_along_the_rotations_between_them():
    run = nt.simulate(nt.nontwisting([3, 4, 5]), t_end=2, step=0.5, material_angular_velocity=(1.0, 2.0, 0.0))
    path = Motion(content(run)).at(1.7)[2]
    rate = np.sqrt(5.0)  # free: a great circle at constant speed, whose states are exact
    assert arcs(path).max() < 0.051
    assert arcs(path).sum() == pytest.approx(1.7 * rate, abs=1e-5)  # attitudes have single precision in a page
    assert path @ np.cross(path[0], path[1]) == pytest.approx(np.zeros(len(path)), abs=1e-6)


def test_the_scene_is_the_state_between_two_of_the_run(runs):
    for run in runs:
        triad, psi, path = Motion(content(run)).at(1.503)
        assert triad == pytest.approx(nt.resample(run, [1.503]).directors.values[0], abs=2e-4)
        assert psi == pytest.approx(float(nt.twist(run).twist_angle.interp(time=1.503)), abs=1e-4)
        assert len(path) > np.count_nonzero(run.time <= 1.503)
        assert path[-1] == pytest.approx(triad[2])
        motion = Motion(content(run))
        assert motion.path_time[-1] == motion.time[-1] > motion.path_time[-2]


def test_what_is_written_on_the_picture_is_what_the_run_says(runs):
    words = [text.get_text() for ax in still([Motion(content(run)) for run in runs], 2.6, 50).axes for text in ax.texts]
    psi = float(np.degrees(nt.twist(runs[0]).twist_angle.sel(time=2.6, method="nearest")))
    assert f"ψ = {psi:.1f}°" in words
    assert "ψ = 0.0°" in words
    assert words.count("t = 2.60 s") == 2
    assert {"standard body", "non-twisting body", "d₁", "d₂", "d₃"} <= {*words}


@pytest.mark.parametrize("width", [200, 480, 960, 1920])
def test_a_line_separates_the_time_of_one_run_from_the_name_of_the_next(width, runs):
    figure = still([Motion(data) for data in contents(runs, ["free", "held"])], 0.8, width / 8.6)
    time, name = (next(t for t in ax.texts if t.get_text() in ("t = 0.80 s", "held")) for ax in figure.axes)
    figure.draw_without_rendering()
    (line,) = figure.artists
    border, left, right = (artist.get_window_extent() for artist in (line, time, name))
    assert border.x0 == border.x1 == pytest.approx(figure.bbox.width / 2)
    assert border.height > 0.95 * figure.bbox.height
    letter = left.width / len("t = 0.80 s")
    assert left.x1 + letter < border.x0 < right.x0 - letter
    assert contrast(to_rgb(line.get_color()), to_rgb(figure.get_facecolor())) > 4.5


def test_the_wedge_is_on_the_picture_face_on(runs, tmp_path):
    wedges = []
    for run in runs:
        save_still([run], tmp_path / "picture.png", 2.6, force=True)
        dots = np.asarray(Image.open(tmp_path / "picture.png").convert("RGB")).astype(int)
        dial = dots[:, dots.shape[1] * 3 // 4 :]  # the sphere ends before
        twisted = np.array(to_rgb(colours()["twist"]))
        tinted = abs(dial - 255 * (1 - 0.62 * (1 - twisted))).max(axis=-1) < 12  # three fifths of the colour on white
        wedges.append(np.count_nonzero(tinted) / (np.pi * (0.9 * 0.42 * 960 / 3.35) ** 2))
    psi = float(abs(nt.twist(runs[0]).twist_angle.sel(time=2.6, method="nearest")))
    assert wedges[0] == pytest.approx(psi / (2 * np.pi), abs=0.03)
    assert wedges[1] < 0.002


def contrast(one, other):
    """By the formula of WCAG."""
    rgb = np.array([to_rgb(one), to_rgb(other)])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    low, high = sorted(linear @ [0.2126, 0.7152, 0.0722])
    return (high + 0.05) / (low + 0.05)


def test_colours_are_those_of_the_pages():
    least = dict.fromkeys(("ink", "muted"), 4.5) | dict.fromkeys(("twist", "d1", "d2", "d3", "frame", "rotor"), 3)
    for dark in (False, True):
        ink = colours(dark)
        for name, enough in least.items():
            gaps = [contrast(ink[name], ink[ground]) for ground in ("ground", "card", "glass")]
            assert min(gaps) >= enough, (name, dark)
        assert min(contrast(ink[name], ink["card"]) for name in ("twist", "accent")) >= 4.5  # they colour texts


def test_a_gif_pauses_at_its_end(runs, tmp_path):
    save_film(runs, tmp_path / "film.gif", seconds=0.4)
    with Image.open(tmp_path / "film.gif") as film:
        durations = []
        for k in range(film.n_frames):
            film.seek(k)
            durations.append(film.info["duration"])
        assert durations == [80, 80, 80, 80, 80, 1500]  # 0.4 s, and the last picture
        assert film.info["loop"] == 0
        assert film.size == (960, 368)
        assert film.convert("RGB").getpixel((0, 0)) == (255, 255, 255)


def read(path):
    with Image.open(path) as picture:
        return picture.copy()


def test_films_have_the_length_the_rate_and_the_size_that_are_asked_for(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for run, name in zip(runs, ("free", "held"), strict=True):
        nt.save_run(run, f"{name}.nc")
    options = ["--seconds", "0.5", "--fps", "20", "--width", "333"]
    assert nontwist("view", "free.nc", "held.nc", "--gif", "film.gif", *options).exit_code == 0
    with Image.open("film.gif") as film:
        assert (film.n_frames, film.info["duration"], film.size[0]) == (11, 50, 333)
    for rate, frames, duration in ((30, 1 + 17, 30), (1, 2, 1000)):  # a GIF counts hundredths: 3, not 3.33
        save_film([runs[0].sel(time=slice(0, 1))], "odd.gif", seconds=0.5, rate=rate, width=100, force=True)
        with Image.open("odd.gif") as film:
            assert (film.n_frames, film.info["duration"]) == (frames, duration)
    assert nontwist("view", "free.nc", "--png", "wide.png", "--width", "1111").exit_code == 0
    assert read("wide.png").size == (1111, 853)
    for arguments, message in (
        (["--fps", "9"], "applies to --gif and --mp4 only; add one of them"),
        (["--seconds", "9", "--png", "x.png"], "applies to --gif and --mp4 only; add one of them"),
        (["--width", "500"], "applies to --gif, --mp4 and --png only; add one of them"),
    ):
        refused = nontwist("view", "free.nc", *arguments)
        assert (refused.exit_code, message in refused.stderr) == (2, True), refused.stderr
    text = " ".join(nontwist("view", "--help").stdout.split())
    rates = ", ".join(f"{rate:g} ({kind[1:].upper()})" for kind, rate in RATES.items())
    widths = ", ".join(f"{width} ({kind[1:].upper()})" for kind, width in WIDTHS.items())
    assert f"a GIF shows each for whole hundredths of a second: 15 becomes {100 / round(100 / 15):.1f}." in text
    for words in (f"Default: {SECONDS:g}.", f"Default: {rates}.", f"Default: for each run {widths}."):
        assert words in text
    for wrong, message in (
        ({"width": 99}, "the width must be 100 to 4096 pixels, got 99"),
        ({"rate": 51}, "the rate of a film must be positive and at most 50 pictures per second, got 51"),
        ({"seconds": 0}, "the length of a film must be positive, got 0 s"),
    ):
        with pytest.raises(ValueError, match=f"^{message}$"):
            save_film(runs, "other.gif", **wrong)


def test_two_runs_have_names_that_differ_or_those_that_are_given(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("slow", "fast"):
        nt.save_run(runs[0], f"{name}.nc")
    files = [nt.open_run("slow.nc"), nt.open_run("fast.nc")]
    for given, labels, names in (
        (files, None, ["standard body, slow", "standard body, fast"]),
        ([files[0]] * 2, None, ["standard body, first run", "standard body, second run"]),
        (runs, None, ["standard body", "non-twisting body"]),
        (files, ("a", "b"), ["a", "b"]),
    ):
        assert [each["name"] for each in contents(given, labels)] == names
    assert view(*files, labels=["a", "b"]).title == "a and b"
    assert view(files[0], labels="a").title == "a"
    for labels in (["a"], "ab", ["a", 1]):
        message = f"labels must be two strings, one for each run, got {short_repr(labels)}"
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            view(*files, labels=labels)
    with pytest.raises(ValueError, match=r"^labels must be one string, got \['a', 'b'\]$"):
        view(files[0], labels=["a", "b"])
    for arguments, title in ((["fast.nc", "--labels", "slow, fast"], "slow and fast"), (["--labels", "a, 1"], "a, 1")):
        assert nontwist("view", "slow.nc", *arguments, "--no-open", "--force").exit_code == 0
        assert f"<title>{title}</title>" in (tmp_path / "slow-view.html").read_text(encoding="utf-8")
    refused = nontwist("view", "slow.nc", "fast.nc", "--labels", "one")
    assert (refused.exit_code, "'one' is not two labels, A,B" in refused.stderr) == (2, True)


def test_titles_are_the_labels_of_pictures(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, two = (run.assign_attrs(run_file=f'title = "{title}"') for run, title in zip(runs, "ab", strict=True))
    assert [each["name"] for each in contents([one, two])] == ["a", "b"]
    assert [each["name"] for each in contents([one, one])] == [f"standard body, {k} run" for k in ("first", "second")]
    assert contents([one])[0]["name"] == "standard body"  # below the title of the page
    for given, name in (((None,), "a"), (("c",), "c"), ((None, "d"), "d")):
        assert [motion.data["name"] for motion in _motions([one], *given)] == [name]
    save_still([one, two], "two.png", width=400)
    save_still([one, two], "titled.png", width=400, title="a title above both, in a band of its own")
    plain, titled = read("two.png"), read("titled.png")
    band = titled.size[1] - plain.size[1]
    assert (titled.size[0], band > 8) == (400, True)
    ink = np.asarray(titled.convert("L"), dtype=float)[:band]
    assert ink.min() < 100  # letters
    below = titled.crop((0, band, *titled.size))
    assert abs(np.asarray(below, dtype=float) - np.asarray(plain, dtype=float)).mean() < 3


TITLES = (
    "A thrown phone turns over about its middle axis",
    "Short",
    "One title that is as wide as a picture",
    "The same kick for two bodies, of which one may not turn about its own axis while the other one may do so",
)


@pytest.mark.parametrize("title", TITLES)
@pytest.mark.parametrize("count", [1, 2])
def test_titles_are_broken_into_lines_of_like_length(title, count, runs):
    figure = still([Motion(each) for each in contents(runs)][:count], 1.0, 130.5, Look(title=title))
    (text,) = figure.texts
    figure.draw_without_rendering()
    box = text.get_window_extent()
    assert figure.bbox.x0 < box.x0 < box.x1 < figure.bbox.x1
    lines = text.get_text().split("\n")
    assert title.startswith(" ".join(lines).removesuffix(" …"))
    assert len(lines) <= 2
    if len(lines) == 2:
        assert box.width > 0.45 * figure.bbox.width
        assert abs(len(lines[0]) - len(lines[1])) < 12


def test_a_film_that_leaps_is_told_what_shows_the_motion(tmp_path, monkeypatch):
    """Ten turns in a film of 12 pictures: 300° from one to the next; 30 pictures do, which 50 a second show in 1 s."""
    monkeypatch.chdir(tmp_path)
    run = nt.simulate(nt.standard([3, 4, 5]), t_end=1, material_angular_velocity=(0, 0, 20 * np.pi))
    nt.save_run(run, "run.nc")
    film = ["view", "run.nc", "--gif", "film.gif", "--seconds", "1", "--width", "100"]
    result = nontwist(*film)
    assert result.stderr.startswith(
        "warning: the body turns by 300° from picture to picture, on average, so it may seem to turn backwards or to "
        "stand; use --seconds 1 --fps 50, or a part of the run: --from T0 --to T1, in Python "
        "run.sel(time=slice(t0, t1))\nwritten: film.gif ("
    )
    result = nontwist(
        "view", "run.nc", "--gif", "film.gif", "--seconds", "1", "--fps", "50", "--force", "--width", "100"
    )
    assert result.stderr.startswith("written: film.gif (")


def pages_of(*arguments):
    """Return the data of the page that `nontwist view` writes."""
    result = nontwist("view", *arguments, "--out", "page.html", "--no-open", "--force")
    assert result.exit_code == 0, result.stderr
    text = re.search(
        r'<script[^>]*type="application/json"[^>]*>(.*?)</script>', Path("page.html").read_text(encoding="utf-8")
    )
    return json.loads(text[1])["runs"], result.stderr


def test_a_part_of_a_run_is_shown(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = runs[1].assign(t_events=("event", [0.5, 1.5]))
    nt.save_run(run, "run.nc")
    (shown,), _ = pages_of("run.nc", "--from", 1, "--to", 2)
    assert (shown["start"], shown["end"], shown["events"]) == (1.0, 2.0, [1.5])
    assert Motion(shown).quaternion == pytest.approx(run.quaternion.sel(time=slice(1, 2)).values, abs=1e-6)
    (panel,) = [one for one in shown["panels"] if one["title"] == "Reaction moment"]
    moment = drawing._unpacked(panel["curves"][0]["time"])
    assert (moment.min(), moment.max(), moment.size) == (pytest.approx(0.01), pytest.approx(0.99), 50)
    assert nontwist("view", "run.nc", "--png", "a.png", "--from", 1, "--to", 2).exit_code == 0
    save_still([run.sel(time=slice(1, 2))], "b.png")
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes()
    rows = np.column_stack([run.time, run.quaternion])
    np.savetxt("q.csv", rows, delimiter=",", header="time_s,qx,qy,qz,qw", comments="")
    (shown,), _ = pages_of("q.csv", "--from", 2)
    assert (shown["start"], shown["end"]) == (2.0, 3.0)
    for arguments, code, message in (
        (
            ["--from", "5"],
            3,
            "run.nc: --from and --to choose 0 of 151 states, which are from 0 s to 3 s; at least 2 are needed\n",
        ),
        (["--from", "2", "--to", "1"], 2, "Invalid value for --to: must be after --from, 2, got 1\n"),
    ):
        refused = nontwist("view", "run.nc", *arguments)
        assert (refused.exit_code, message in refused.stderr) == (code, True), refused.stderr


def test_states_far_apart_are_completed(tmp_path, monkeypatch):
    """Of a free body that turns at 5 rad/s about its axis of symmetry, with a precession, in 12 states."""
    monkeypatch.chdir(tmp_path)
    start = {"t_end": 6, "material_angular_velocity": (1, 0, 5)}
    run = nt.simulate(nt.standard([3, 3, 2]), step=0.5, integrator="gauss", order=16, **start)
    nt.save_run(run, "run.nc")
    (shown,), said = pages_of("run.nc")
    assert "warning" not in said
    motion = Motion(shown)
    exact = nt.simulate(nt.standard([3, 3, 2]), integrator="exact", times=motion.time, **start)
    turns = Rotation.from_quat(motion.quaternion)
    assert (turns[:-1].inv() * turns[1:]).magnitude().max() < 0.11
    assert (turns * Rotation.from_quat(exact.quaternion.values).inv()).magnitude().max() < 1e-5
    (shown,), _ = pages_of("run.nc", "--from", 1.1, "--to", 1.3)  # between two states
    assert (shown["start"], shown["end"]) == (1.1, 1.3)
    pushed = nt.simulate(nt.standard([3, 3, 2]), step=0.2, load=moment(lambda t, R, W: -0.1 * W), **start)
    nt.save_run(pushed, "pushed.nc")
    (shown,), said = pages_of("pushed.nc")
    assert said.startswith(
        "warning: pushed.nc: the body turns by up to 1 rad between stored states, and these cannot be completed (the "
        "load of the run holds the function test_films.test_states_far_apart_are_completed.<locals>.<lambda>, which is "
        "not stored in the dataset): what is drawn in between is interpolated; run it with more states, times= or "
        "store= of simulate, time.times or time.store of a run file\nwritten: page.html ("
    )
    assert shown["about"]["States"] == (
        "all 31 shown. Between two of them the body turns by up to 1 rad: the motion drawn in between is interpolated. "
        "More states: resample(run, times), or times= of simulate"
    )


def test_the_camera_looks_from_where_it_is_told(runs, tmp_path, monkeypatch):
    right, up, towards = Camera(np.radians(90), 0.0).view()
    assert [right, up, towards] == [pytest.approx(one, abs=1e-15) for one in ([-1, 0, 0], [0, 0, 1], [0, 1, 0])]
    monkeypatch.chdir(tmp_path)
    nt.save_run(runs[0], "run.nc")
    for name, camera in (("a.png", "90,0"), ("b.png", "0,90")):
        assert nontwist("view", "run.nc", "--png", name, "--camera", camera).exit_code == 0
    assert Path("a.png").read_bytes() != Path("b.png").read_bytes()
    for wrong, code, message in (
        ("90", 2, "'90' is not two angles like 35,20"),
        ("0,91", 3, "the elevation of the camera must be from -90 to 90 degrees, got 91\n"),
    ):
        refused = nontwist("view", "run.nc", "--png", "c.png", "--camera", wrong)
        assert (refused.exit_code, message in refused.stderr) == (code, True), refused.stderr


@pytest.mark.parametrize("down", [(0, 0, -9.81), (0, -9.81, 0), (-3, -4, -5)])
@pytest.mark.parametrize("lean", [175, 60, 10])
def test_a_pendulum_hangs_downwards_on_the_picture(down, lean):
    """From the upright position by `lean` degrees: gravity points down on the picture, seen from above the horizon."""
    unit = np.array(down) / np.linalg.norm(down)
    upright = Rotation.align_vectors([-unit], [[0, 0, 1]])[0]
    body = nt.with_gravity(nt.nontwisting([2, 2, 1]), mass=1.5, centre_of_mass=(0, 0, 0.6), gravity=down)
    run = nt.simulate(body, t_end=2, step=0.01, rotation=upright * Rotation.from_euler("x", lean, degrees=True))
    motion = Motion(content(run))
    right, up, towards = camera_of([motion]).view()
    assert [unit @ right, unit @ up < -0.3, unit @ towards < -0.19] == [pytest.approx(0, abs=1e-12), True, True]
    swing = np.linalg.svd(motion.path - motion.path.mean(0))[2][2]
    assert abs(swing @ towards) > 0.6  # the plane of the swing is not seen from its edge
    (ax,) = still([motion], 1.0, 50).axes
    (word,) = [text for text in ax.texts if text.get_text() == "g"]
    x, y = np.array([*word.get_position()])
    assert y < x - 0.05
    assert np.hypot(x, y) > 1.2  # beside the sphere
    (dashed,) = [line for line in ax.lines if line.get_color() == colours()["muted"]]
    assert np.stack(dashed.get_data(), axis=1) == pytest.approx(np.outer([-1, 1], [unit @ right, unit @ up]))


def test_there_is_no_vertical_without_gravity(runs):
    assert [each["weight"] for each in contents(runs)] == [None, None]
    assert camera_of([Motion(content(run)) for run in runs]).upright == pytest.approx(np.eye(3))
    assert "g" not in [text.get_text() for text in still([Motion(content(runs[0]))], 1.0, 50).axes[0].texts]
    pulled = nt.DirectorSystem(np.eye(3), dead_force=[[0, 0, -1], [0, -1, 0], [0, 0, 0]])  # in two directions
    assert content(nt.simulate(pulled, t_end=1, step=0.1))["weight"] is None


ROD = """
start.rotation = {{ vector = [120, 0, 0], unit = "degrees" }}
time.t_end = 1
[body]
kind = "heavy_top"
inertia = {inertia}
mass = {mass}
centre_of_mass = {centre}
gravity = [0, 0, {gravity}]
"""


@pytest.mark.parametrize("gravity", [-9.81, 9.81])
def test_a_box_hangs_at_the_centre_of_mass_that_the_run_file_states(gravity, tmp_path):
    """A cuboid of 0.2 × 0.3 × 0.6 m whose centre of mass is 0.5 m from the pivot along d3 and 0.1 m along d1."""
    mass, sides, rho = 2.0, np.array([0.2, 0.3, 0.6]), np.array([0.1, 0.0, 0.5])
    J = nt.inertia.shift(nt.inertia.of_cuboid(mass, sides), mass=mass, offset=rho)
    text = ROD.format(inertia=J.tolist(), mass=mass, centre=rho.tolist(), gravity=gravity)
    (tmp_path / "rod.toml").write_text(text, encoding="utf-8")
    run = nt.simulate(read_run_file(tmp_path / "rod.toml").problem)
    shown = content(run)
    half, edges, centre = (np.array(shown["box"][key]) for key in ("half", "edges", "centre"))
    assert shown["weight"]["down"] == pytest.approx([0, 0, np.sign(gravity)])
    assert shown["weight"]["centre_of_mass"] == pytest.approx(centre)
    scale = centre[2] / rho[2]
    assert centre == pytest.approx(scale * rho)
    assert scale * sides / 2 == pytest.approx(abs(half @ edges))
    assert np.linalg.norm(abs(centre) + abs(half @ edges)) == pytest.approx(0.66)
    assert shown["about"]["Box"] == "the inertia about the centre of mass, to which the line leads from the pivot"
    made = nt.simulate(nt.heavy_top(J, mass, rho, [0, 0, gravity]), t_end=1)
    told = content(made.assign_attrs(mass=mass, centre_of_mass=rho, gravity=[0, 0, gravity]))
    assert (told["box"], told["weight"]) == (shown["box"], shown["weight"])
    alone = content(nt.simulate(nt.heavy_top(J, mass, rho), t_end=1))  # of this run no file states the mass
    assert alone["box"]["centre"] == [0, 0, 0]
    assert alone["weight"]["down"] == pytest.approx([0, 0, -1])
    assert alone["weight"]["centre_of_mass"] == pytest.approx(0.62 * rho / np.linalg.norm(rho))
    assert alone["about"]["Box"] == (
        "the inertia about the pivot; the line points to the centre of mass, at a distance that is not recorded"
    )
    (ax,) = still([Motion(shown)], 0.5, 50).axes
    seen = camera_of([Motion(shown)]).view()[:2] @ (centre @ run.directors.sel(time=0.5, method="nearest").values)
    assert any(patch.center == pytest.approx(seen, abs=2e-2) for patch in ax.patches if hasattr(patch, "center"))


TETRAHEDRON = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3]])
SHAPES = {
    "cylinder = { mass = 0.3, radius = 0.05, length = 0.01 }, offset = [0, 0, 0.04]": (0.3, [0, 0, 0.04]),
    "points = { masses = [1, 3], positions = [[0.1, 0, 0], [0, 0, 0.2]] }": (4.0, [0.025, 0, 0.15]),
    'mesh = { file = "t.stl", density = 1000, about = "origin" }': (4.5, [0.075, 0.075, 0.075]),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_the_box_of_a_shape_hangs_at_its_centre_of_mass(shape, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mass, rho = SHAPES[shape]
    if "mesh" in shape:
        trimesh = pytest.importorskip("trimesh")
        trimesh.Trimesh(TETRAHEDRON, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).export("t.stl")
    text = f'time.t_end = 0.2\nbody = {{ kind = "heavy_top", inertia = {{ {shape} }} }}\n'
    Path("shape.toml").write_text(
        text + 'start.rotation = { vector = [30, 0, 0], unit = "degrees" }\n', encoding="utf-8"
    )
    assert nontwist("run", "shape.toml", "--quiet").exit_code == 0
    run = nt.open_run("shape.nc")
    assert (run.attrs["mass"], [*run.attrs["centre_of_mass"]]) == (pytest.approx(mass), pytest.approx(rho))
    said = nontwist("info", "shape.nc").stdout
    assert f"{mass:.6g} kg, with its centre at ({', '.join(f'{x:.6g}' for x in rho)}) m" in said
    shown = content(run)
    half, centre = (np.array(shown["box"][key]) for key in ("half", "centre"))
    assert centre / np.linalg.norm(centre) == pytest.approx(rho / np.linalg.norm(rho))
    assert shown["weight"]["centre_of_mass"] == pytest.approx(centre)
    if "cylinder" in shape:  # flat: a box of the inertia m r²/4 + m h²/12 has the sides √3 r and h
        assert sorted(half / centre[2]) == pytest.approx(
            np.array([0.005, 0.05 * np.sqrt(0.75), 0.05 * np.sqrt(0.75)]) / 0.04
        )
    wrong = content(run.assign_attrs(mass=2 * mass))  # does not give the dead forces of the run
    assert wrong["box"]["centre"] == [0, 0, 0]


def test_labels_are_clear_of_arrows_and_of_each_other():
    rng = np.random.default_rng(4)
    for _ in range(300):
        d = Rotation.random(random_state=rng).as_matrix()[:, :2]  # three directors on the picture, and h along one
        tips = [*d, 0.66 * d[rng.integers(3)]]
        places = drawing.label_places(tips)
        for k, place in enumerate(places):
            assert np.hypot(*(place - tips[k])) == pytest.approx(drawing.LABEL)
            for j, tip in enumerate(tips):
                along = np.clip(place @ tip / (tip @ tip), 0, 1)
                assert j == k or np.hypot(*(place - along * tip)) > 0.6 * drawing.CLEAR[0]
                assert j >= k or np.hypot(*(place - places[j])) > 0.6 * drawing.CLEAR[1]
    (first, along) = drawing.label_places([np.array([1.0, 0.0]), np.array([0.66, 0.0])])
    assert first == pytest.approx([1 + drawing.LABEL, 0])
    assert abs(along[1]) >= drawing.CLEAR[0]  # beside the longer arrow


def test_rotors_are_wheels_with_their_momentum():
    """About (0.6, 0, 0.8), 0 to 12 N m s in 2 s, and about D2, 5 N m s backwards: axes and momenta at 1 s."""
    load = nt.rotor((0.6, 0, 0.8), [0, 2], [0, 12]) + nt.rotor((0, 1, 0), -5)
    run = nt.simulate(nt.standard([3, 4, 5]), load=load, t_end=3, step=0.01, material_angular_velocity=(0.3, 0.1, 1))
    motion = Motion(content(run))
    (first, h), (second, back) = motion.wheels(1.0)
    assert first == pytest.approx([0.6, 0, 0.8])
    assert second == pytest.approx([0, 1, 0])
    assert [12 * h, 12 * back] == pytest.approx([6, -5], rel=1e-6)
    (ax,) = still([motion], 1.0, 50).axes
    rims = [patch for patch in ax.patches if to_rgb(patch.get_facecolor()) == to_rgb(colours()["rotor"])]
    assert len(rims) >= 4  # two halves of each
    axis = run.directors.sel(time=1).values.T @ first
    edge = np.concatenate([patch.get_path().vertices for patch in rims[::2]])
    assert np.linalg.norm(edge, axis=1).max() <= 0.4 + 1e-9
    shown = {text.get_text(): np.array(text.get_position()) for text in ax.texts}
    view = camera_of([motion]).view()
    places = [np.array(text.get_position()) for text in ax.texts if text.get_text() == "h"]
    tip = view[:2] @ axis
    expected = 0.66 / 2 * tip + 0.13 * tip / np.linalg.norm(tip)
    assert any(place == pytest.approx(expected, abs=2e-4) for place in places)
    assert len(places) == 2
    assert "d₃" in shown
    assert Motion(content(nt.simulate(nt.standard([3, 4, 5]), t_end=1, step=0.1))).wheels(0.5) == []


def test_films_and_pictures_in_the_dark(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nt.save_run(runs[0], "run.nc")
    assert nontwist("view", "run.nc", "--png", "dark.png", "--dark").exit_code == 0
    save_film([run.sel(time=slice(0, 0.4)) for run in runs], "dark.gif", seconds=0.2, dark=True)
    for name in ("dark.png", "dark.gif"):
        with Image.open(name) as picture:
            assert bytes(picture.convert("RGB").getpixel((0, 0))).hex() == colours(dark=True)["card"][1:]
    refused = nontwist("view", "run.nc", "--dark")
    assert refused.exit_code == 2
    assert "applies to --gif, --mp4 and --png only; add one of them" in refused.stderr


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg on the path")
def test_an_mp4_has_all_pictures(runs, tmp_path):
    save_film(runs, tmp_path / "film.mp4", seconds=0.4)
    probe = ["ffprobe", "-v", "error", "-count_packets", "-show_entries", "stream=nb_read_packets", "-of", "csv=p=0"]
    count = subprocess.run([*probe, tmp_path / "film.mp4"], capture_output=True, text=True, check=True).stdout
    assert int(count) == 11 + round(PAUSE * RATES[".mp4"])


def test_ffmpeg_is_fed_the_pictures_and_its_complaint_is_told(runs, tmp_path, monkeypatch):
    fake = tmp_path / "bin" / "ffmpeg"
    fake.parent.mkdir()
    fake.write_text('#!/bin/sh\nfor last; do :; done\nwc -c > "$last"\n', encoding="utf-8")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{fake.parent}:/usr/bin:/bin")
    short = [runs[0].sel(time=slice(0, 0.4))]
    save_film(short, tmp_path / "film.mp4", seconds=0.1)
    assert int((tmp_path / "film.mp4").read_text(encoding="utf-8")) == (3 + 38) * 3 * 720 * 552
    fake.write_text("#!/bin/sh\ncat > /dev/null\necho no such codec >&2\nexit 1\n", encoding="utf-8")
    with pytest.raises(OSError, match="ffmpeg could not write the film: no such codec"):
        save_film(short, tmp_path / "other.mp4", seconds=0.1)
    fake.write_text("#!/bin/sh\necho cannot begin >&2\nexit 1\n", encoding="utf-8")  # it reads nothing
    with pytest.raises(OSError, match="ffmpeg could not write the film: cannot begin"):
        save_film(short, tmp_path / "other.mp4", seconds=0.1)
    assert not (tmp_path / "other.mp4").exists()


def test_the_command_writes_films_and_pictures(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nt.save_run(runs[0], "run.nc")
    result = nontwist("view", "run.nc", "--png", "moment.png", "--at", "1.5")
    assert result.exit_code == 0, result.stderr
    assert result.stderr.startswith("written: moment.png (")
    assert not (tmp_path / "run-view.html").exists()
    for arguments, code, message in (
        (["--png", "moment.png"], 5, "moment.png exists"),
        (["--png", "other.png", "--at", "9"], 3, "the picture is asked for at 9 s; the run is from 0 to 3 s"),
        (["--gif", "film.mp4"], 2, "film.mp4 does not end in .gif"),
        (["--at", "1"], 2, "applies to --png only; add --png PATH"),
    ):
        result = nontwist("view", "run.nc", *arguments)
        assert (result.exit_code, message in result.stderr) == (code, True), result.stderr
    monkeypatch.setenv("PATH", str(tmp_path))
    result = nontwist("view", "run.nc", "--mp4", "film.mp4")
    assert result.exit_code == 2
    assert "an MP4 film needs ffmpeg, which is not on the path; install it, or write a GIF" in result.stderr
