"""Examples run, and the pages that quote them quote them as they are."""

import re
import runpy
import shutil
import subprocess
import sys
from functools import cache, partial, wraps
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from conftest import STANDARD
from nontwist import plot, sine, twist
from nontwist.analysis import OBSERVABLES
from nontwist.curves import solid_angle
from nontwist.integrators import INTEGRATORS
from nontwist.loads import LOADS
from nontwist.models.bodies import BODIES
from nontwist.viewer.content import content
from nontwist.viewer.drawing import Look, Motion, still

ROOT = Path(__file__).parents[2]
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


@pytest.fixture
def printed(capsys):
    """What a script prints; what it registers is taken out again."""

    def run(script):
        with patch.dict(INTEGRATORS), patch.dict(BODIES), patch.dict(LOADS), patch.dict(OBSERVABLES):
            runpy.run_path(str(ROOT / "examples" / script), run_name="__main__")
        return capsys.readouterr().out

    return run


def text_of(*path):
    return ROOT.joinpath(*path).read_text(encoding="utf-8")


def test_recording_has_licence_and_source():
    assert "Copyright (C) 2016 Thomas Haslwanter" in text_of("examples", "imu", "LICENSE.txt")
    assert "scikit-kinematics" in text_of("examples", "imu", "SOURCE.md")


def difference(one, other):
    """How much two pictures differ, in the mean of all dots, of 255."""
    first, second = (np.asarray(picture.convert("RGB")).astype(float) for picture in (one, other))
    return abs(first - second).mean() if first.shape == second.shape else np.inf


def stored(name):
    """A picture of the documentation."""
    with Image.open(ROOT / "docs" / name) as picture:
        picture.load()
        return picture


def test_map_of_chaos(tmp_path):
    """Of few dots; the page shows it with many. A throw about the third axis is regular, one along a ray is not."""
    script = runpy.run_path(str(ROOT / "examples" / "chaos_map.py"))
    script["draw"].__globals__["exponents"] = script["exponents"] = cache(script["exponents"])
    script["draw"](6, tmp_path / "map.png")
    assert stored("images/chaos.png").size == stored(tmp_path / "map.png").size
    speeds, largest = script["exponents"](6)
    assert speeds.tolist() == [-5, -3, -1, 1, 3, 5]
    assert max(largest[5, 2], largest[0, 3]) < 0.06 < 0.12 < min(largest[5, 0], largest[2, 1])


LIKE_OTHERS = "directors dna_circle energy energy_drift momenta multipliers orthonormality polhode reaction_moment"
COPIED = [*LIKE_OTHERS.split(), "second_quotient", "twist_angle", "work_precision"]


@pytest.mark.parametrize("copied", [COPIED, pytest.param((), marks=pytest.mark.long)])
def test_gallery(copied, tmp_path):
    """Of some figures the stored picture is taken in the quick suite."""
    main = runpy.run_path(str(ROOT / "examples" / "gallery.py"))["main"]
    for name in copied:
        copy = partial(shutil.copy, ROOT / "docs" / "gallery" / f"{name}.png")
        shown = SimpleNamespace(figure=SimpleNamespace(savefig=lambda to, dpi, copy=copy: copy(to)))
        main.__globals__[f"show_{name}"] = wraps(main.__globals__[f"show_{name}"])(lambda shown=shown: shown)
    main(tmp_path)
    page = text_of("docs", "gallery.md")
    assert (tmp_path / "gallery.md").read_text(encoding="utf-8") == page
    figures = set(plot.__all__) - {"new_axes", "save", "style"}
    assert all(f"plot.{name}(" in page and f"(gallery/{name}.png)" in page for name in figures)
    for folder in (tmp_path, ROOT / "docs"):
        pictures = {path.stem: path.stat().st_size for path in (folder / "gallery").iterdir()}
        assert pictures.keys() == figures | {"dna_circle"}
        assert all(3000 < size <= 150_000 for size in pictures.values())
    for name in pictures.keys() - {"work_precision", "energy_drift", "orthonormality"}:  # of times and round-off
        assert difference(stored(tmp_path / "gallery" / f"{name}.png"), stored(f"gallery/{name}.png")) < 1, name


def test_first_page_picture():
    script = runpy.run_path(str(ROOT / "examples" / "pictures.py"))
    t, d3, carried, looking = script["circle_and_frames"]()
    assert solid_angle(d3, pole=(0, 0, 1)) == pytest.approx(np.pi / 3, abs=2e-5)  # of a polygon
    for frame, turned in ((carried, 0), (looking, 300)):
        assert np.degrees(twist(frame.transpose(0, 2, 1), t).twist_angle[-1].item()) == pytest.approx(turned, abs=1e-3)
    figure = script["frame_picture"]()
    words = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert [word for word in words if "°" in word or "twist" in word] == [
        "back, turned by\nthe area inside:\n60°",
        "carried without twist: twist 0°",
        "back as it left:\nit has twisted",
        "looking ahead: twist 300°",
    ]
    assert difference(script["picture"](figure, 200), stored("images/frame.png")) < 1


def test_readme_film():
    """Its last picture, drawn again from what the code of the README computes: the same wedges, the same numbers."""
    script = runpy.run_path(str(ROOT / "examples" / "pictures.py"))
    runs = script["bodies_of_the_readme"]()
    ends = [float(np.degrees(twist(run).twist_angle[-1])) for run in runs]
    assert ends[0] < -180  # beyond half a turn, as the README says
    assert ends[1] == pytest.approx(0, abs=1e-9)
    for name, dark in (("bodies.gif", False), ("bodies-dark.gif", True)):
        last = still([Motion(content(run)) for run in runs], 3.5, 90, Look(dark))
        words = [text.get_text() for ax in last.axes for text in ax.texts]
        assert [word for word in words if word.startswith("ψ")] == [f"ψ = −{-ends[0]:.1f}°", "ψ = 0.0°"]
        with Image.open(ROOT / "docs" / "images" / name) as film:
            film.seek(round(12.5 * script["SECONDS"]))  # of so many and the last
            assert film.info["duration"] == 1500
            assert difference(script["picture"](last, 90), film) < 2.3, name  # 64 colours; a second before it is 7


def angles(text):
    """The numbers of a picture, in degrees."""
    return [float(word.strip("ψ= °")) for word in text.replace("−", "-").splitlines() if "°" in word]


def test_pictures_of_pages(tmp_path, monkeypatch):
    """Numbers that stand on the pictures, and what the code of the first page, or of the playground, computes."""
    monkeypatch.chdir(tmp_path)
    code = re.findall(r"```python\n(.*?)```", text_of("docs", "index.md"), re.DOTALL)[-1]
    shown = []
    with patch("nontwist.viewer.content.content", lambda run: shown.append(run) or content(run)):
        exec(code, {})
    for name in ("view.png", "view-dark.png"):
        text = stored(f"images/{name}").text["numbers"]
        told, places = angles(text), re.findall(r"\((.*)\)", text.replace("−", "-"))
        for run, own, place in zip(shown, (told[:4], told[4:]), places, strict=True):
            at, d3 = twist(run).interp(time=1.8), run.directors.sel(director=3).interp(time=1.8).values
            assert own[0] == own[2] == pytest.approx(np.degrees(float(at.twist_angle)), abs=0.1)
            assert own[3] == pytest.approx(np.degrees(float(at.solid_angle)), abs=0.2)
            assert [float(x) for x in place.split(",")] == pytest.approx(list(d3), abs=2e-3)
    for name in ("playground.png", "playground-dark.png"):
        told, kept = stored(f"images/{name}").text, {}
        exec(told["code"], kept)
        computed = [np.degrees(float(twist(kept[one]).twist_angle[-1])) for one in ("free", "held")]
        assert angles(told["numbers"]) == pytest.approx(computed, abs=0.06)


def numbers(line):
    return [float(number) for number in re.findall(r"(?<![\w-])-?\d+\.?\d*(?:e[+-]?\d+)?(?!\w)", line)]


def test_user_integrator_order(printed):
    lines = printed("own_integrator.py").splitlines()
    names = ["non-twisting body, load along the directors", "Suslov body, load along fixed axes", "heavy top"]
    assert [line.split(":")[0] for line in lines[::2]] == names
    for order, line in zip(lines[::2], lines[1::2], strict=True):
        assert numbers(order) == [pytest.approx(4, abs=0.2)]
        *errors, defect = numbers(line)
        assert errors == sorted(errors, reverse=True)
        assert errors[-1] < 1e-6
        assert defect < 1e-13


def test_user_compiled_scheme(printed):
    coarse, fine, derivative = printed("own_scheme.py").splitlines()
    errors = [numbers(line)[-1] for line in (coarse, fine)]
    assert errors[0] / errors[1] == pytest.approx(2, abs=0.05)
    assert 0 < errors[1] < 2e-3
    assert numbers(derivative)[-1] < 1e-8


def test_user_body(printed):
    first, *lines = printed("own_body.py").splitlines()
    rate = 2 * 9.81 * 0.2 / (2 * 0.3**2 / 2 * 60)
    assert numbers(first) == [pytest.approx(rate, abs=1e-9)]
    bounds = {"gauss": 1e-9, "energy-momentum": 1e-5, "split": 1e-9, "continuous": 1e-12}
    assert [line.split()[0] for line in lines] == list(bounds)
    for line, bound in zip(lines, bounds.values(), strict=True):
        measured, error, tilt, drift = numbers(line)
        assert measured == pytest.approx(rate, rel=bound, abs=1e-9)
        assert error < bound
        assert tilt < 100 * bound
        assert drift < 1e-10


def test_user_observable(printed):
    measured, closed, ensemble = map(numbers, printed("own_observable.py").splitlines())
    assert measured[-2:] == pytest.approx(closed, abs=2e-6)
    least, *greatest = closed
    ratio = (0.2 * 24) ** 2 / (4 * 0.4 * 1.5 * 9.81 * 0.3)
    greatest.append(np.arccos(ratio - np.sqrt(ratio**2 - 2 * ratio * np.cos(least) + 1)))
    assert ensemble == pytest.approx(greatest, abs=2e-6)


def test_user_load_work(printed):
    *lines, by_dipole = printed("own_load.py").splitlines()
    bounds = {"lie-midpoint": (1e-13, 1e-12), "energy-momentum": (1e-2, 1e-1), "split": (1e-7, 1e-9)}
    assert [line.split()[0] for line in lines] == list(bounds)
    for line, (energy, motion) in zip(lines, bounds.values(), strict=True):
        work, drift, distance = numbers(line)
        assert work < 1e-11
        assert drift < energy
        assert distance < motion
    assert by_dipole == "1 mA m² more of it turns the end by 0.053 rad, 0.033 rad, 0.017 rad"


def test_user_reader(printed):
    whole, cut = printed("own_reader.py").splitlines()
    assert whole == "50 samples, 0.98 s: twist 180.0000°"
    assert cut == "line 50 is '980000|0.000000000|0', not 5 numbers separated by |; correct or delete it"


@pytest.mark.parametrize("name", ["integrator", "body", "load", "reader"])
def test_contributor_pages_show_examples(name):
    page = text_of("docs", "contributing", f"{'recording' if name == 'reader' else name}.md")
    assert f"{{literalinclude}} ../../examples/own_{name}.py" in page
    assert f"!python examples/own_{name}.py" in page
    for path in re.findall(r"`((?:tests|docs|[a-z]+)/[\w./]+\.(?:py|md|json))`", page):
        assert any((ROOT / place / path).is_file() for place in (".", "src/nontwist")) or "munthe_kaas" in path, path


def tether():
    """Lines of a vehicle that loops once and rolls five times on the way, with a gap in which turns are lost."""
    t = np.concatenate([np.linspace(0, 10, 401), np.linspace(12, 14, 81)])
    R = Rotation.from_rotvec(np.outer(0.7 * np.sin(t), [0, 0, 1])) * Rotation.from_rotvec(np.outer(t / 2, [0, 1, 0]))
    R = Rotation.from_rotvec([0.4, 1, 2]) * R * Rotation.from_rotvec(np.outer(2 * np.pi * 0.4 * t, [1, 0, 0]))
    rows = np.column_stack([t, R.as_quat(scalar_first=True)])
    return R, "\n".join(" ".join(map(repr, row)) for row in rows.tolist())


def counted(*command):
    """What a tether counter prints."""
    run = subprocess.run(command, input=tether()[1], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


def test_tether_counters(tmp_path):
    source = ROOT / "examples" / "tether_counter.py"
    found = counted(sys.executable, source)
    expected = twist(tether()[0][:401], axis="x", order=2).twist_angle.values / (2 * np.pi)
    assert [float(line.split()[2]) for line in found[:401]] == pytest.approx(expected, abs=1e-12)
    assert all("gaps" not in line for line in found[:401])
    assert all(line.endswith("(1 gaps too long)") for line in found[401:])
    code = source.read_text(encoding="utf-8").partition('"""\n\n')[2]
    assert len(code.splitlines()) <= 20
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    program = tmp_path / "tether_counter"
    flags = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off"]
    subprocess.run([COMPILER, *flags, "-o", program, source.with_suffix(".c"), "-lm"], check=True)
    for one, other in zip(counted(program), found, strict=True):
        assert one.split()[:2] == other.split()[:2]
        assert float(one.split()[2]) == pytest.approx(float(other.split()[2]), abs=2e-12)
        assert one.partition(" turns")[2] == re.sub(r"^, give or take \S+", "", other.partition(" turns")[2])


def tumbling():
    """What `torch_run` takes as its problem, and a start."""
    load = sine((0, 0.1, 0.2), frequency=0.4)
    how = {"system": STANDARD, "t_end": 2, "step": 0.1, "store": 5, "load": load}
    return how, np.array([0.3, -0.4, 0.5]), runpy.run_path(str(ROOT / "examples" / "torch_run.py"))


def test_pytorch_functions():
    how, W, script = tumbling()
    A, V = script["states"](W, how)
    by_A, by_V = (np.random.default_rng(seed).normal(size=of.shape) for seed, of in ((5, A), (6, V)))

    def loss(W):
        A, V = script["states"](W, how)
        return np.sum(by_A * A) + np.sum(by_V * V)

    steps = 1e-3 * np.eye(3)
    expected = [(8 * (loss(W + e) - loss(W - e)) - loss(W + 2 * e) + loss(W - 2 * e)) / 12e-3 for e in steps]
    np.testing.assert_allclose(script["slopes"](W, A, by_A, by_V, how), expected, rtol=1e-8)


def test_pytorch_gradcheck():
    torch = pytest.importorskip("torch")
    how, W, script = tumbling()
    W = torch.tensor(W, requires_grad=True)
    assert torch.autograd.gradcheck(script["torch_function"](how), (W,))
