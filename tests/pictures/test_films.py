"""Films and pictures of runs: the same scene as the page, without a browser."""

import itertools
import json
import re
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import PathPatch, Wedge
from PIL import Image, ImageSequence
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import NONTWISTING, STANDARD, ended, shoelace
from nontwist import moment, view
from nontwist.geometry.arrays import arcs
from nontwist.plot.looks import contrast
from nontwist.runfile import read_run_file
from nontwist.viewer import drawing
from nontwist.viewer.content import content, contents
from nontwist.viewer.drawing import Look, Motion, camera_of, colours, still
from nontwist.viewer.films import PAUSE, RATES, SECONDS, WIDTHS, Pictures, save_film, save_still
from refusals import said, says


@pytest.fixture(scope="module")
def runs():
    how = {"t_end": 3, "step": 0.02, "material_angular_velocity": (1.2, 1.0, 0)}
    return [nt.simulate(body([3.2, 2.2, 1.3]), **how) for body in (nt.standard, nt.nontwisting)]


@pytest.fixture
def folder(runs, here):
    """A folder with the files free.nc and held.nc, to work in."""
    for run, name in zip(runs, ("free", "held"), strict=True):
        nt.save_run(run, f"{name}.nc")
    return here


def words(figure):
    return [text.get_text() for ax in figure.axes for text in ax.texts]


def read(path):
    with Image.open(path) as picture:
        picture.load()
        return picture


def durations(path):
    """How long a film shows each picture, in ms."""
    with Image.open(path) as film:
        return [picture.info["duration"] for picture in ImageSequence.Iterator(film)]


def test_path_of_few_states():
    run = nt.simulate(NONTWISTING, t_end=2, step=0.5, material_angular_velocity=(1.0, 2.0, 0.0))
    path = Motion(content(run)).at(1.7)[2]
    rate = np.sqrt(5.0)  # free: a great circle at constant speed, whose states are exact
    assert arcs(path).max() < 0.051
    assert arcs(path).sum() == pytest.approx(1.7 * rate, abs=1e-5)  # attitudes have single precision in a page
    assert path @ np.cross(path[0], path[1]) == pytest.approx(np.zeros(len(path)), abs=1e-6)


@pytest.mark.parametrize("lean", [0.3, 2.6])
def test_scene_from_above(lean):
    """Between two states, of a body that leans to the reader or away. Flat shapes are lifted into their planes."""
    axis = np.array([0.6, 0, 0.8])
    start = {"rotation": Rotation.from_euler("y", lean), "load": nt.rotor(axis, [0, 2], [0, -2.0])}
    run = nt.simulate(STANDARD, t_end=2, step=0.01, angular_velocity=(0.3, 0.2, -1.3), **start)
    (ax,) = still([Motion(shown := content(run))], 1.003, 50, Look(camera=(-np.pi / 2, np.pi / 2))).axes
    path = nt.resample(run, np.append(run.time[run.time < 1.003], 1.003)).directors.values
    d, path, psi = path[-1], path[:, 2], float(nt.twist(run).twist_angle.interp(time=1.003))
    names, shapes = {colour: name for name, colour in colours().items()}, defaultdict(list)
    for one in ax.patches:
        if type(one) is PathPatch:
            quads = one.get_path().vertices.reshape(-1, 5, 2)[:, :4]
            kind = names[to_hex(one.get_facecolor())], len(quads) > 99
            shapes[kind] += [(quad, one.zorder > 5) for quad in quads]
    shapes = {kind: [*map(np.array, zip(*pairs, strict=True))] for kind, pairs in shapes.items()}
    for name, turn, normal, r, R in (
        ("rotor", 2 * np.pi, axis @ d, 0.3, 0.4),
        ("frame", 2 * np.pi, d[2], 0.7, 0.86),
        ("twist", abs(psi), d[2], 0.7, 0.86),
    ):
        quads, near = shapes[name, False]
        points = np.dstack([quads, -quads @ normal[:2] / normal[2]])
        assert np.linalg.norm(points, axis=2) == pytest.approx(np.tile([r, R, R, r], (len(quads), 1)), abs=1e-4)
        assert ((points.mean(1)[:, 2] >= 0) == near).all()
        assert abs(shoelace(quads)).sum() == pytest.approx(turn * (R**2 - r**2) / 2 * abs(normal[2]), rel=2e-3)
    turned = np.arctan2(points @ d[1], points @ d[0]) / -psi  # of the wedge
    assert (turned.min(), turned.max()) == pytest.approx((0, 1), abs=1e-4)
    fan, near = shapes["twist", True]
    across = np.cross(path[0], path[-1])
    turns = np.outer(np.linspace(np.arccos(path[0] @ path[-1]), 0, 99), across / np.linalg.norm(across))
    around = np.vstack([path, Rotation.from_rotvec(turns).apply(path[0])])[:, :2]
    assert shoelace(fan).sum() == pytest.approx(shoelace(around), rel=1e-2)
    assert (near == (lean < 1)).all()
    signs, box = np.array([*itertools.product((-1, 1), repeat=3)]), shown["box"]
    corners = sorted(signs * box["half"] @ box["edges"] @ d, key=lambda corner: corner[2])[1:]  # the first is hidden
    gaps = np.linalg.norm(np.array(corners)[:, None, :2] - np.vstack(shapes["box", False][0]), axis=2)
    assert max(gaps.min(0).max(), gaps.min(1).max()) < 1e-4
    tips = sorted([0.98 * d[0], 0.98 * d[1], d[2], -0.66 * 1.003 / 2 * axis @ d], key=lambda tip: tip[2] >= 0)
    arrows = [(*one.xy, one.zorder > 5) for one in ax.texts if not one.get_text()]
    assert arrows == [pytest.approx((*tip[:2], tip[2] >= 0), abs=1e-4) for tip in tips]
    grid = np.vstack([line.get_xydata() for line in ax.lines if names[line.get_color()] == "grid"])
    assert np.nanmin(grid, axis=0) == pytest.approx([-1, -1], abs=2e-3)
    assert np.nanmax(np.hypot(*grid.T)) == pytest.approx(1)
    c, s = np.cos(psi), np.sin(psi)
    arms = sorted(0.86 * np.array([[c, -s], [s, c]]) @ d[:2], key=lambda arm: arm[2] >= 0)
    two = [line.get_xydata()[1] for line in ax.lines if len(line.get_xydata()) == 2]
    assert two[:2] == [pytest.approx(arm[:2], abs=1e-4) for arm in arms]
    hands = 0.42 * np.array([[0, 0.97], [-0.6 * c, -0.6 * s], [-0.86 * s, 0.86 * c]]) + [1.62, 0]
    assert two[2:] == [pytest.approx(hand, abs=1e-4) for hand in hands]
    (dial,) = [one for one in ax.patches if type(one) is Wedge]
    assert (dial.theta1, dial.theta2) == pytest.approx(sorted((90, 90 + np.degrees(psi))), abs=1e-2)


def test_names_of_runs_apart(runs):
    figure = still([Motion(data) for data in contents(runs, ["free", "held"])], 0.8, 200 / 8.6)
    assert {"d₁", "d₂", "d₃"} <= {*words(figure)}
    time, name = (next(t for t in ax.texts if t.get_text() in ("t = 0.80 s", "held")) for ax in figure.axes)
    figure.draw_without_rendering()
    for ax, own in zip(figure.axes, ("free", "held"), strict=True):
        (at,) = (t.get_window_extent().x0 for t in ax.texts if t.get_text() == own)
        assert 0 < at - ax.bbox.x0 < 0.1 * ax.bbox.width
    (line,) = figure.artists
    border, left, right = (artist.get_window_extent() for artist in (line, time, name))
    assert border.x0 == border.x1 == pytest.approx(figure.bbox.width / 2)
    assert border.height > 0.95 * figure.bbox.height
    letter = left.width / len("t = 0.80 s")
    assert left.x1 + letter < border.x0 < right.x0 - letter
    assert contrast(line.get_color()) > 4.5 * contrast(figure.get_facecolor())


def test_colours_can_be_seen():
    """By WCAG, in the light and in the dark: texts 4.5 times as light or as dark as their ground, lines 3 times."""
    least = dict.fromkeys(("twist", "d1", "d2", "d3", "frame", "rotor"), 3) | dict.fromkeys(("ink", "muted"), 4.5)
    pairs = [(name, ground, enough) for name, enough in least.items() for ground in ("ground", "card", "glass")]
    for dark in (False, True):
        ink = {name: contrast(colour) for name, colour in colours(dark).items()}
        for name, ground, enough in [*pairs, ("twist", "card", 4.5), ("accent", "card", 4.5)]:
            assert max(ink[name] / ink[ground], ink[ground] / ink[name]) >= enough, (name, ground, dark)


def test_length_rate_and_size(runs, folder):
    short = [run.sel(time=slice(0, 0.4)) for run in runs]
    save_film(short, "film.gif", seconds=0.16)
    assert durations("film.gif") == [80, 80, 1500]  # 0.16 s, and the last picture
    film = read("film.gif")
    assert (film.info["loop"], film.size, film.convert("RGB").getpixel((0, 0))) == (0, (960, 368), (255, 255, 255))
    options = ["--seconds", 0.1, "--fps", 20, "--width", 100, "--to", 0.4]
    ended(0, "view", "free.nc", "held.nc", "--gif", "film.gif", "--force", *options)
    assert (durations("film.gif")[:-1], read("film.gif").size[0]) == ([50, 50], 100)
    for rate, shown in ((30, [30, 30, 30]), (1, [1000])):  # a GIF counts hundredths: 3, not 3.33
        save_film(short[:1], "odd.gif", seconds=0.09, rate=rate, width=100, force=True)
        assert durations("odd.gif")[:-1] == shown
    text = " ".join(ended(0, "view", "--help").stdout.split())
    rates = ", ".join(f"{rate:g} ({kind[1:].upper()})" for kind, rate in RATES.items())
    widths = ", ".join(f"{width} ({kind[1:].upper()})" for kind, width in WIDTHS.items())
    for part in (
        f"a GIF shows each for whole hundredths of a second: 15 becomes {100 / round(100 / 15):.1f}.",
        *(f"Default: {told}." for told in (f"{SECONDS:g}", rates, f"for each run {widths}")),
    ):
        assert part in text
    for wrong in ({"width": 99}, {"rate": 51}, {"seconds": 0}):
        with says():
            save_film(runs, "other.gif", **wrong)


def test_refusals(folder, monkeypatch):
    monkeypatch.setenv("PATH", str(folder))  # without ffmpeg
    for code, *arguments in (
        (2, "--fps", "9"),
        (2, "--seconds", "9", "--png", "x.png"),
        (2, "--width", "500"),
        (2, "--png", "x.png", "--width", "4097"),
        (2, "--dark"),
        (2, "--gif", "film.mp4"),
        (2, "--at", "1"),
        (3, "--png", "x.png", "--at", "9"),
        (2, "--png", "x.png", "--camera", "90"),
        (3, "--png", "x.png", "--camera", "0,91"),
        (3, "--from", "5"),
        (2, "--from", "2", "--to", "1"),
        (2, "held.nc", "--labels", "one"),
        (2, "--mp4", "film.mp4"),
    ):
        said(ended(code, "view", "free.nc", *arguments).stderr.rpartition("Error: ")[2])


def test_names_of_two_runs(runs, folder):
    one, two = (run.assign_attrs(run_file=f'title = "{title}"') for run, title in zip(runs, "ab", strict=True))
    nt.save_run(runs[0], "fast.nc")
    files = [nt.open_run(f"{name}.nc") for name in ("free", "fast")]
    numbered = ["standard body, first run", "standard body, second run"]
    for given, labels, names in (
        (files, None, ["standard body, free", "standard body, fast"]),
        ([files[0]] * 2, None, numbered),
        (runs, None, ["standard body", "non-twisting body"]),
        (files, ("a", "b"), ["a", "b"]),
        ([one, two], None, ["a", "b"]),
        ([one, one], None, numbered),
        ([one], None, ["standard body"]),  # below the title of the page
    ):
        assert [each["name"] for each in contents(given, labels)] == names
    for given, name in (({}, "a"), ({"labels": "c"}, "c"), ({"title": "d"}, "d")):
        assert [motion.data["name"] for motion in Pictures([one], ".png", **given).motions] == [name]
    for several, labels in (
        (files, ["a"]),
        (files, "ab"),
        (files, ["a", 1]),
        (files[:1], ["a", "b"]),
        (files[:1], np.array("a")),
    ):
        with says():
            view(*several, labels=labels)
    for arguments, title in ((["fast.nc", "--labels", "slow, fast"], "slow and fast"), (["--labels", "a, 1"], "a, 1")):
        ended(0, "view", "free.nc", *arguments, "--no-open", "--force")
        assert f"<title>{title}</title>" in Path("free-view.html").read_text(encoding="utf-8")


TITLES = (
    "A thrown phone turns over about its middle axis",
    "Short",
    "The same kick for two bodies, of which one may not turn about its own axis while the other one may do so",
)


def test_titles(runs, folder):
    motions = [Motion(each) for each in contents(runs)]
    for title, count in itertools.product(TITLES, (1, 2)):
        figure = still(motions[:count], 1.0, 130.5, Look(title=title))
        (text,) = figure.texts
        box = text.get_window_extent()
        assert figure.bbox.x0 < box.x0 < box.x1 < figure.bbox.x1
        assert figure.axes[0].bbox.y1 < box.y0 < box.y1 < figure.bbox.y1
        first, *others = text.get_text().split("\n")
        assert title.startswith(" ".join([first, *others]).removesuffix(" …"))
        assert len(others) <= 1
        for second in others:
            assert box.width > 0.45 * figure.bbox.width
            assert abs(len(first) - len(second)) < 12
    for name, title in (("plain.png", None), ("titled.png", "a title above both, in a band of its own")):
        save_still(runs, name, width=400, title=title)
    plain, titled = read("plain.png"), read("titled.png")
    band = titled.size[1] - plain.size[1]
    assert (titled.size[0], band > 8) == (400, True)
    below = titled.crop((0, band, *titled.size))
    assert abs(np.asarray(below, dtype=float) - np.asarray(plain, dtype=float)).mean() < 3


def test_leaping_film_warns(tmp_path):
    """30 turns in 3 pictures: 90 pictures show them, at a third of a turn, and so 50 a second in 3 s."""
    run = nt.simulate(STANDARD, t_end=1, material_angular_velocity=(0, 0, 60 * np.pi))
    with says(UserWarning) as told:
        save_film([run], tmp_path / "film.gif", seconds=0.2, width=100)
    assert re.search(r"--seconds (\S+) --fps (\S+),", str(told[0].message)).groups() == ("3", "50")


def pages_of(*arguments):
    """Return the data of the page that `nontwist view` writes, and what it says."""
    result = ended(0, "view", *arguments, "--out", "page.html", "--no-open", "--force")
    text = re.search(r'"application/json"[^>]*>(.*?)</script>', Path("page.html").read_text(encoding="utf-8"))
    return json.loads(text[1])["runs"], result.stderr


def test_part_of_a_run(runs, folder):
    run = runs[1].assign(t_events=("event", [0.5, 1.5]))
    nt.save_run(run, "run.nc")
    (shown,), _ = pages_of("run.nc", "--from", 1, "--to", 2)
    assert (shown["start"], shown["end"], shown["events"]) == (1.0, 2.0, [1.5])
    assert Motion(shown).quaternion == pytest.approx(run.quaternion.sel(time=slice(1, 2)).values, abs=1e-6)
    (panel,) = [one for one in shown["panels"] if one["title"] == "Reaction moment"]
    moment = drawing._unpacked(panel["curves"][0]["time"])
    assert (moment.min(), moment.max(), moment.size) == (pytest.approx(0.01), pytest.approx(0.99), 50)
    ended(0, "view", "run.nc", "--png", "a.png", "--width", 200, "--from", 1, "--to", 2)
    save_still([run.sel(time=slice(1, 2))], "b.png", width=200)
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes()
    rows = np.column_stack([run.time, run.quaternion])
    np.savetxt("q.csv", rows, delimiter=",", header="time_s,qx,qy,qz,qw", comments="")
    (shown,), _ = pages_of("q.csv", "--from", 2)
    assert (shown["start"], shown["end"]) == (2.0, 3.0)


@pytest.mark.usefixtures("here")
def test_states_far_apart_are_completed():
    """Of a free body that turns at 5 rad/s about its axis of symmetry, with a precession, in 12 states."""
    start = {"t_end": 6, "material_angular_velocity": (1, 0, 5)}
    nt.save_run(nt.simulate(nt.standard([3, 3, 2]), step=0.5, integrator="gauss", order=16, **start), "run.nc")
    (shown,), told = pages_of("run.nc")
    assert "warning" not in told
    motion = Motion(shown)
    exact = nt.simulate(nt.standard([3, 3, 2]), integrator="exact", times=motion.time, **start)
    turns = Rotation.from_quat(motion.quaternion)
    assert (turns[:-1].inv() * turns[1:]).magnitude().max() < 0.11
    assert (turns * Rotation.from_quat(exact.quaternion.values).inv()).magnitude().max() < 1e-5
    (shown,), _ = pages_of("run.nc", "--from", 1.1, "--to", 1.3)  # between two states
    assert (shown["start"], shown["end"]) == (1.1, 1.3)
    pushed = nt.simulate(nt.standard([3, 3, 2]), step=0.2, load=moment(lambda t, R, W: -0.1 * W), **start)
    nt.save_run(pushed, "pushed.nc")
    (shown,), told = pages_of("pushed.nc")
    said(told.partition("\nwritten")[0])
    said(shown["about"]["States"])


@pytest.mark.parametrize(("lean", "down"), [(175, (0, 0, -9.81)), (60, (-3, -4, -5)), (10, (0, -9.81, 0))])
def test_pendulum_hangs_downwards(lean, down):
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
    (arrow,) = [one for one in ax.texts if not one.get_text() and one.zorder == word.zorder]
    along = np.subtract(arrow.xy, arrow.xyann)
    assert along / np.linalg.norm(along) == pytest.approx([unit @ right / abs(unit @ up), -1], abs=1e-9)
    assert np.hypot(x, y) > 1.2  # beside the sphere
    (dashed,) = [line for line in ax.lines if line.get_color() == colours()["muted"]]
    assert np.stack(dashed.get_data(), axis=1) == pytest.approx(np.outer([-1, 1], [unit @ right, unit @ up]))


def test_no_vertical_without_gravity(runs):
    motions = [Motion(content(run)) for run in runs[:1]]
    assert motions[0].data["weight"] is None
    assert camera_of(motions).upright == pytest.approx(np.eye(3))
    lean = Rotation.from_euler("yz", (1.2, 2.0))  # a path on one side is seen there, and not from straight above
    aside = nt.simulate(NONTWISTING, t_end=0.5, step=0.1, rotation=lean, material_angular_velocity=(1, 0, 0))
    motion = Motion(content(aside))
    assert 0.85 < motion.path.mean(0) @ camera_of([motion]).view()[2] < 0.92
    assert "g" not in words(still(motions, 1.0, 50))
    pulled = nt.DirectorSystem(np.eye(3), dead_force=[[0, 0, -1], [0, -1, 0], [0, 0, 0]])  # in two directions
    assert content(nt.simulate(pulled, t_end=1, step=0.1))["weight"] is None


TETRAHEDRON = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3]])
BODY = 'time.t_end = {}\nstart.rotation = {{ vector = [120, 0, 0], unit = "degrees" }}\nbody = {}\n'


def centre_on_page(shown, rho):
    """The centre of the box, at which the weight acts, in the direction of the centre of mass."""
    centre = np.array(shown["box"]["centre"])
    assert centre / np.linalg.norm(centre) == pytest.approx(rho / np.linalg.norm(rho))
    assert shown["weight"]["centre_of_mass"] == pytest.approx(centre)
    return centre


@pytest.mark.parametrize("gravity", [-9.81, 9.81])
def test_box_at_stated_centre(gravity, write):
    """A cuboid of 0.2 × 0.3 × 0.6 m whose centre of mass is 0.5 m from the pivot along d3 and 0.1 m along d1."""
    mass, sides, rho = 2.0, np.array([0.2, 0.3, 0.6]), np.array([0.1, 0.0, 0.5])
    J = nt.inertia.shift(nt.inertia.of_cuboid(mass, sides), mass=mass, offset=rho)
    own = f"mass = {mass}, centre_of_mass = {rho.tolist()}, gravity = [0, 0, {gravity}]"
    text = BODY.format(1, f'{{ kind = "heavy_top", inertia = {J.tolist()}, {own} }}')
    run = nt.simulate(read_run_file(write(text)).problem)
    shown = content(run)
    half, edges, centre = np.array(shown["box"]["half"]), np.array(shown["box"]["edges"]), centre_on_page(shown, rho)
    assert shown["weight"]["down"] == pytest.approx([0, 0, np.sign(gravity)])
    assert centre[2] / rho[2] * sides / 2 == pytest.approx(abs(half @ edges))
    assert np.linalg.norm(abs(centre) + abs(half @ edges)) == pytest.approx(0.66)
    said(shown["about"]["Box"])
    made = nt.simulate(nt.heavy_top(J, mass, rho, [0, 0, gravity]), t_end=1)
    told = content(made.assign_attrs(mass=mass, centre_of_mass=rho, gravity=[0, 0, gravity]))
    assert (told["box"], told["weight"]) == (shown["box"], shown["weight"])
    alone = content(nt.simulate(nt.heavy_top(J, mass, rho), t_end=1))  # of this run no file states the mass
    assert alone["box"]["centre"] == [0, 0, 0]
    assert alone["weight"]["down"] == pytest.approx([0, 0, -1])
    assert alone["weight"]["centre_of_mass"] == pytest.approx(0.62 * rho / np.linalg.norm(rho))
    (ax,) = still([Motion(shown)], 0.5, 50).axes
    view = camera_of([Motion(shown)]).view()
    assert view[1, 2] * gravity < -8  # downwards on the picture
    seen = view[:2] @ (centre @ run.directors.sel(time=0.5, method="nearest").values)
    assert any(patch.center == pytest.approx(seen, abs=2e-2) for patch in ax.patches if hasattr(patch, "center"))


SHAPES = {
    "cylinder = { mass = 0.3, radius = 0.05, length = 0.01 }, offset = [0, 0, 0.04]": (0.3, [0, 0, 0.04]),
    'mesh = { file = "t.stl", density = 1000, about = "origin" }': (4.5, [0.075, 0.075, 0.075]),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.usefixtures("here")
def test_box_of_a_shape(shape, write):
    mass, rho = SHAPES[shape]
    if "mesh" in shape:
        trimesh = pytest.importorskip("trimesh")
        trimesh.Trimesh(TETRAHEDRON, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).export("t.stl")
    write(BODY.format(0.2, f'{{ kind = "heavy_top", inertia = {{ {shape} }} }}'), "shape.toml")
    ended(0, "run", "shape.toml", "--quiet")
    run = nt.open_run("shape.nc")
    assert (run.attrs["mass"], [*run.attrs["centre_of_mass"]]) == (pytest.approx(mass), pytest.approx(rho))
    centre = f"{mass:.6g} kg, with its centre at ({', '.join(f'{x:.6g}' for x in rho)}) m"
    assert centre in ended(0, "info", "shape.nc").stdout
    shown = content(run)
    centre = centre_on_page(shown, rho)
    if "cylinder" in shape:  # flat: a box of the inertia m r²/4 + m h²/12 has the sides √3 r and h
        expected = np.array([0.005, 0.05 * np.sqrt(0.75), 0.05 * np.sqrt(0.75)]) / 0.04
        assert sorted(np.array(shown["box"]["half"]) / centre[2]) == pytest.approx(expected)
    wrong = content(run.assign_attrs(mass=2 * mass))  # does not give the dead forces of the run
    assert wrong["box"]["centre"] == [0, 0, 0]


def test_labels_do_not_overlap():
    rng = np.random.default_rng(4)
    for _ in range(100):
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


def test_command_writes_pictures(runs, folder):
    """And from where it is told."""
    above = ("above.png", "--at", "1.5", "--camera", "0,90", "--width", 1111)
    for name, *options in (("moment.png", "--at", "1.5"), ("dark.png", "--dark"), above):
        told = ended(0, "view", "free.nc", "--png", name, *options).stderr
        assert told.startswith(f"written: {name} ({Path(name).stat().st_size / 1000:.0f} kB)")
    assert not Path("free-view.html").exists()
    save_still(runs[:1], "same.png", 1.5, camera=(0, 90), width=1111)
    save_still(runs[:1], "other.png", 1.5, width=1111)
    assert Path("other.png").read_bytes() != Path("above.png").read_bytes() == Path("same.png").read_bytes()
    assert [read(name).size for name in ("moment.png", "above.png")] == [(960, 737), (1111, 853)]
    save_film([runs[0].sel(time=slice(0, 0.4))], "dark.gif", seconds=0.1, dark=True)
    grounds = [bytes(read(name).convert("RGB").getpixel((0, 0))).hex() for name in ("dark.png", "dark.gif")]
    assert grounds == [colours(dark=True)["card"][1:]] * 2


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg on the path")
def test_an_mp4_has_all_pictures(runs, tmp_path):
    save_film(runs, tmp_path / "film.mp4", seconds=0.4)
    probe = ["ffprobe", "-v", "error", "-count_packets", "-show_entries", "stream=nb_read_packets", "-of", "csv=p=0"]
    count = subprocess.run([*probe, tmp_path / "film.mp4"], capture_output=True, text=True, check=True).stdout
    assert int(count) == 11 + round(PAUSE * RATES[".mp4"])


def test_ffmpeg_complains(runs, tmp_path, monkeypatch):
    fake = tmp_path / "bin" / "ffmpeg"
    fake.parent.mkdir()
    fake.touch(0o755)
    monkeypatch.setenv("PATH", f"{fake.parent}:/usr/bin:/bin")
    short = [runs[0].sel(time=slice(0, 0.4))]
    fake.write_text('#!/bin/sh\nfor last; do :; done\nwc -c > "$last"\n', encoding="utf-8")
    save_film(short, tmp_path / "film.mp4", seconds=0.1)
    assert int((tmp_path / "film.mp4").read_text(encoding="utf-8")) == (3 + 38) * 3 * 720 * 552
    for start in ("cat > /dev/null", ":"):  # the other one reads nothing
        fake.write_text(f"#!/bin/sh\n{start}\necho no such codec >&2\nexit 1\n", encoding="utf-8")
        with pytest.raises(OSError, match="ffmpeg could not write the film: no such codec"):
            save_film(short, tmp_path / "other.mp4", seconds=0.1, width=100)
    assert not (tmp_path / "other.mp4").exists()
