"""Examples run, and the pages that quote them quote them as they are."""

import subprocess
import sys
from pathlib import Path

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
