"""Cases of recordings that went wrong, by the command that its user types."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from nontwist import read_motion, simulate, standard
from nontwist.cli import app
from nontwist.recordings.reading import read_rates

from .cases import CASES, FOLDER, RATES, written
from .makers import WXYZ, T, quat, spice_kernels, text


def nontwist(*arguments):
    """The result of a command, and all that it says on one line."""
    result = CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "1000"})
    return result, " ".join((result.stderr + result.stdout).split())


def outcome(name, folder):
    """Write the files of a case, call its command, and return its result, what it says, and its numbers."""
    case = CASES[name]
    for file, content in case.files.items():
        written(content, folder / file)
    words = [
        folder / word if word in case.files else FOLDER / word if (FOLDER / word).is_file() else word
        for word in case.arguments
    ]
    result, said = nontwist("twist", *words, "--no-figure", "--json", "--out", folder / "out")
    return result, said, json.loads(result.stdout) if result.exit_code == 0 else {}


@pytest.mark.parametrize("name", CASES)
def test_cases(name, tmp_path):
    case = CASES[name]
    result, said, found = outcome(name, tmp_path)
    if not found:
        assert result.exit_code in (2, 3), result.exception
        assert case.refusal, said
        assert re.search(case.refusal, said), said
        return
    assert case.value is not None, said
    assert found["twist_angle"] == pytest.approx(case.value, abs=case.within)
    assert re.search(case.says, said), said
    if case.duration is not None:
        assert found.get("duration") == pytest.approx(case.duration, abs=1e-4)


def read_or_told(path):
    """The angular velocities of a file, or the message of the refusal."""
    try:
        return read_rates(path), ""
    except ValueError as error:
        return None, str(error)


@pytest.mark.parametrize("name", RATES)
def test_angular_velocities(name, tmp_path):
    content, truth, refusal, within = RATES[name]
    path = FOLDER / content
    if "\n" in content:
        path = tmp_path / "a.csv"
        written(content, path)
    found, said = read_or_told(path)
    if found is None:
        assert refusal, said
        assert re.search(refusal, said), said
        return
    assert abs(found.rates - truth).max() < within
    assert np.ptp(found.time) == pytest.approx(0.02 * (len(truth) - 1), abs=1e-9)


def test_json_of_a_twist_of_few_samples_has_no_nan(tmp_path):
    """E3."""
    written(text({"time": T[:8], **quat("q{}", values=WXYZ[:8])}), tmp_path / "a.csv")
    assert nontwist("twist", tmp_path / "a.csv", "--no-figure", "--out", tmp_path / "o")[0].exit_code == 0
    for command in (["info", "--json"], ["export", "--to", "json", "--out", tmp_path / "o.json"]):
        result, _ = nontwist(command[0], tmp_path / "o.nc", *command[1:])
        assert result.exit_code == 0, result.stderr
        told = result.stdout if command[0] == "info" else (tmp_path / "o.json").read_text(encoding="utf-8")
        assert not re.search(r"\bNaN\b", told)


def test_the_kernels_that_a_caller_has_loaded_stay(tmp_path):
    """E4."""
    spiceypy = pytest.importorskip("spiceypy")
    spice_kernels(tmp_path / "a.tm")
    spiceypy.furnsh(str(tmp_path / "leap.tls"))
    try:
        read_motion(tmp_path / "a.tm", rate=50)
        assert spiceypy.ktotal("ALL") == 1
        assert spiceypy.gdpool("DELTET/DELTA_T_A", 0, 1)[0] == 32.184
    finally:
        spiceypy.kclear()


def test_times_outside_of_a_run_without_an_end_are_told_in_words():
    """E7."""
    with pytest.raises(ValueError, match="outside of the run") as told:
        simulate(standard(np.diag([1.0, 2, 3])), t_start=1, times=[0.5, 2], material_angular_velocity=(1, 0, 0))
    assert "None" not in str(told.value)
