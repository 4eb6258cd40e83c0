import subprocess
import sys

import pytest
from typer.testing import CliRunner

from nontwist.cli import app


def nontwist(*arguments):
    return CliRunner().invoke(app, arguments)


def test_reproduce_prints_tables_and_leaves_with_0(tmp_path):
    result = nontwist("reproduce", "--case", "1", "--quick", "--out", str(tmp_path))
    assert result.exit_code == 0
    assert "20.571428571" in result.stdout
    assert "3.994933" in result.stdout
    assert "20 of 20 printed numbers agree" in result.stdout
    assert "step 0.005" not in result.stdout


def test_reproduce_leaves_with_1_when_a_number_differs(tmp_path):
    result = nontwist("reproduce", "--case", "3", "--quick", "--printed-loads", "--out", str(tmp_path))
    assert result.exit_code == 1
    assert "DIFFERS" in result.stdout
    assert "20 times smaller" in result.stdout


def test_usage_errors_leave_with_2():
    assert nontwist("reproduce", "--case", "4").exit_code == 2
    assert nontwist("reprodce").exit_code == 2


def test_an_output_that_cannot_be_written_leaves_with_5(tmp_path):
    (tmp_path / "file").write_text("")
    result = nontwist("reproduce", "--quick", "--out", str(tmp_path / "file"))
    assert result.exit_code == 5
    assert "cannot write the results" in result.stderr


def test_version_and_help():
    assert nontwist("--version").stdout.startswith("nontwist 0.")
    assert "reproduce" in nontwist("--help").stdout


@pytest.mark.parametrize("module", ["scipy.spatial", "matplotlib", "xarray", "h5py"])
def test_help_imports_nothing_slow(module):
    code = (
        "import sys; from typer.testing import CliRunner; from nontwist.cli import app;"
        f"CliRunner().invoke(app, ['--help']); sys.exit({module!r} in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
