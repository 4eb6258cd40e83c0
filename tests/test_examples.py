"""Examples run, and the pages that quote them quote them as they are."""

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


def test_the_twist_tutorial_quotes_its_script():
    page = (ROOT / "docs" / "tutorials" / "twist.md").read_text(encoding="utf-8")
    for line in printed("twist_of_a_recording.py").splitlines():
        assert line in page, line


def test_the_recording_has_its_licence_and_source():
    folder = ROOT / "examples" / "imu"
    assert "Copyright (C) 2016 Thomas Haslwanter" in (folder / "LICENSE.txt").read_text()
    assert "scikit-kinematics" in (folder / "SOURCE.md").read_text()


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
