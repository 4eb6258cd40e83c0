"""Files that are no recordings, or not yet: each is refused in one sentence, and nothing is left behind."""

import io
import os
from pathlib import Path

import numpy as np
import pytest

from conftest import nontwist
from nontwist import read_motion, twist
from nontwist.errors import InputError
from nontwist.recordings import reading
from nontwist.recordings import text as text_reader
from nontwist.recordings.formats import READERS
from refusals import refused

HEADER = "time,qw,qx,qy,qz\n"
TURN = [f"{k / 100},{np.cos(k / 20)!s},0,0,{np.sin(k / 20)!s}" for k in range(20)]
ROWS = "\n".join(TURN) + "\n"
GOOD = HEADER + ROWS


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of its own, in which nothing but a.csv is when a test ends."""
    monkeypatch.chdir(tmp_path)
    yield
    assert [one.name for one in Path().iterdir()] == ["a.csv"]


CONTENTS = {
    "empty": ("", "no-content"),
    "blank lines": ("\n\n", "empty"),
    "header alone": (HEADER, "too-few-samples"),
    "one row": (HEADER + TURN[0] + "\n", "too-few-samples"),
    "times all equal": (HEADER + "3,1,0,0,0\n" * 5, "too-few-samples"),
    "headers twice": (GOOD + GOOD, "not-a-number"),
    "prose": ("To whom it may concern.\n", "no-orientation"),
}


def told_in_one_sentence():
    """Require that `nontwist twist` refuses a.csv in one sentence of ours."""
    result = nontwist("twist", "a.csv", "--out", "result.nc")
    assert result.exit_code not in (0, 1), result.output
    assert "Traceback" not in result.output
    assert (result.stderr.count("\n"), "a.csv" in result.stderr) == (1, True)


@pytest.mark.usefixtures("here")
@pytest.mark.filterwarnings("ignore::nontwist.errors.InputWarning")
@pytest.mark.parametrize("case", CONTENTS)
def test_contents_that_are_no_recording(case):
    content, code = CONTENTS[case]
    Path("a.csv").write_text(content, encoding="utf-8")
    with refused(code):
        twist(read_motion("a.csv"))
    told_in_one_sentence()


@pytest.mark.parametrize("suffix", READERS)
def test_files_larger_than_the_memory_are_not_begun(suffix, tmp_path, monkeypatch):
    (tmp_path / f"a{suffix}").write_text(GOOD, encoding="utf-8")
    monkeypatch.setattr(reading, "free_memory", lambda: 1.5 * len(GOOD))
    monkeypatch.setitem(READERS, suffix, lambda path, how: pytest.fail("it is read"))
    with refused("too-large", size=len(GOOD) / 1e9, free=1.5 * len(GOOD) / 1e9):
        read_motion(tmp_path / f"a{suffix}", rate=100)


def test_a_file_that_changes_while_it_is_read(tmp_path, monkeypatch):
    def read(path, how, plain=READERS[".csv"]):
        found = plain(path, how)
        Path(path).write_text(GOOD + ROWS, encoding="utf-8")
        return found

    monkeypatch.setitem(READERS, ".csv", read)
    (tmp_path / "a.csv").write_text(GOOD, encoding="utf-8")
    with refused("file-changed"):
        read_motion(tmp_path / "a.csv")


ODD = {
    "a FIFO": lambda: os.mkfifo("a.csv"),
    "a folder": lambda: Path("a.csv").mkdir(),
    "a loop of links": lambda: Path("a.csv").symlink_to("a.csv"),
    "a link to nothing": lambda: Path("a.csv").symlink_to("b.csv"),
    "a device": lambda: Path("a.csv").symlink_to("/dev/zero"),
}


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows, which has no FIFOs")
@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("case", ODD)
def test_what_is_no_file(case):
    ODD[case]()
    with pytest.raises(OSError, match=r".") as told:
        read_motion("a.csv")
    assert not isinstance(told.value, InputError)
    assert len(str(told.value)) < 200
    told_in_one_sentence()


def test_a_stream_is_read_to_a_limit(monkeypatch):
    monkeypatch.setattr(text_reader, "LONGEST", 100)
    text = "t,qw,qx,qy,qz\n0,1,0,0,0\n1,0,1,0,0\n"
    assert np.array_equal(read_motion(io.StringIO(text)).time, [0, 1])
    with refused("long-stream", size=1e-4):
        read_motion(io.StringIO(text + "2,1,0,0,0\n" * 10))
