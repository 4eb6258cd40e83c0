"""Examples run, and the pages that quote them quote them as they are."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nontwist import plot, solid_angle, twist

ROOT = Path(__file__).parents[1]


def printed(script):
    path = ROOT / "examples" / script
    return subprocess.run([sys.executable, path], capture_output=True, text=True, check=True).stdout


def test_the_recording_has_its_licence_and_source():
    folder = ROOT / "examples" / "imu"
    assert "Copyright (C) 2016 Thomas Haslwanter" in (folder / "LICENSE.txt").read_text(encoding="utf-8")
    assert "scikit-kinematics" in (folder / "SOURCE.md").read_text(encoding="utf-8")


def test_the_gallery_shows_every_figure_and_is_what_its_script_makes(tmp_path):
    runpy.run_path(str(ROOT / "examples" / "gallery.py"))["main"](tmp_path)
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert (tmp_path / "gallery.md").read_text(encoding="utf-8") == page
    figures = set(plot.__all__) - {"new_axes", "save"}
    for folder in (tmp_path, ROOT / "docs"):
        pictures = {path.stem: path.stat().st_size for path in (folder / "gallery").iterdir()}
        assert pictures.keys() == figures
        assert all(3000 < size <= 150_000 for size in pictures.values())
    for name in figures:
        assert f"plot.{name}(" in page
        assert f"(gallery/{name}.png)" in page


def test_the_picture_of_the_first_page_says_what_is_true():
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
    with Image.open(ROOT / "docs" / "images" / "bodies.gif") as moving:
        assert (moving.n_frames, moving.info["loop"]) == (64, 0)


def numbers(line):
    return [float(number) for number in re.findall(r"(?<![\w-])-?\d+\.?\d*(?:e[+-]?\d+)?(?!\w)", line)]


def test_an_integrator_of_ones_own_has_its_order_on_every_body():
    lines = printed("own_integrator.py").splitlines()
    names = ["non-twisting body, load along the directors", "Suslov body, load along fixed axes", "heavy top"]
    assert [line.split(":")[0] for line in lines[::2]] == names
    for order, line in zip(lines[::2], lines[1::2], strict=True):
        assert numbers(order) == [pytest.approx(4, abs=0.2)]
        *errors, defect = numbers(line)
        assert errors == sorted(errors, reverse=True)
        assert errors[-1] < 1e-6
        assert defect < 1e-13


def test_a_body_of_ones_own_goes_round_at_the_rate_of_the_formula():
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


def test_a_load_of_ones_own_does_the_work_that_it_says():
    lines = printed("own_load.py").splitlines()
    bounds = {"lie-midpoint": (1e-13, 1e-12), "energy-momentum": (1e-2, 1e-1), "split": (1e-7, 1e-9)}
    assert [line.split()[0] for line in lines] == list(bounds)
    for line, (energy, motion) in zip(lines, bounds.values(), strict=True):
        work, drift, distance = numbers(line)
        assert work < 1e-11
        assert drift < energy
        assert distance < motion


@pytest.mark.parametrize("name", ["integrator", "body", "load"])
def test_the_pages_for_contributors_show_their_examples(name):
    page = (ROOT / "docs" / "contributing" / f"{name}.md").read_text(encoding="utf-8")
    assert f"{{literalinclude}} ../../examples/own_{name}.py" in page
    assert f"!python examples/own_{name}.py" in page
    for path in re.findall(r"`((?:tests|docs|[a-z]+)/[\w./]+\.(?:py|md|json))`", page):
        places = [ROOT / path, ROOT / "src" / "nontwist" / path]
        assert any(place.is_file() for place in places) or path == "integrators/munthe_kaas.py", path
