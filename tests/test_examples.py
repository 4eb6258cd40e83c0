"""Examples run, and the pages that quote them quote them as they are."""

import runpy
import subprocess
import sys
from pathlib import Path

from nontwist import plot

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
