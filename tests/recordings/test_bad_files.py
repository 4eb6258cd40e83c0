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


WRONG = {  # content, code of the refusal; or what makes something that is no file
    "empty": ("", "no-content"),
    "blank lines": ("\n\n", "empty"),
    "header alone": (HEADER, "too-few-samples"),
    "times all equal": (HEADER + "3,1,0,0,0\n" * 5, "too-few-samples"),
    "headers twice": (GOOD + GOOD, "not-a-number"),
    "a FIFO": (lambda path: os.mkfifo(path), None),
    "a folder": (Path.mkdir, None),
    "a loop of links": (lambda path: path.symlink_to(path), None),
    "a link to nothing": (lambda path: path.symlink_to("b.csv"), None),
    "a device": (lambda path: path.symlink_to("/dev/zero"), None),
}


@pytest.mark.filterwarnings("ignore::nontwist.errors.InputWarning")
@pytest.mark.parametrize("case", WRONG)
def test_refused_in_one_sentence(case, here):
    content, code = WRONG[case]
    if os.name == "nt" and not code:
        pytest.skip("links need rights on Windows, which has no FIFOs")
    path = Path("a.csv")
    path.write_text(content, encoding="utf-8") if code else content(path)
    with refused(code) if code else pytest.raises(OSError, match=r"^.{1,199}$") as told:
        twist(read_motion("a.csv"))
    assert code or not isinstance(told.value, InputError)
    result = nontwist("twist", "a.csv", "--out", "result.nc")
    assert result.exit_code not in (0, 1), result.output
    assert (result.stderr.count("\n"), "a.csv" in result.stderr, "Traceback" in result.output) == (1, True, False)
    assert [one.name for one in here.iterdir()] == ["a.csv"]


def test_file_larger_than_memory(tmp_path, monkeypatch):
    (tmp_path / "a.npz").write_text(GOOD, encoding="utf-8")
    monkeypatch.setattr(reading, "free_memory", lambda: 1.5 * len(GOOD))
    monkeypatch.setitem(READERS, ".npz", lambda path, how: pytest.fail("it is read"))
    with refused("too-large", size=len(GOOD) / 1e9, free=1.5 * len(GOOD) / 1e9):
        read_motion(tmp_path / "a.npz", rate=100)


def test_file_changes_while_read(tmp_path, monkeypatch):
    def read(path, how, plain=READERS[".csv"]):
        found = plain(path, how)
        Path(path).write_text(GOOD + ROWS, encoding="utf-8")
        return found

    monkeypatch.setitem(READERS, ".csv", read)
    (tmp_path / "a.csv").write_text(GOOD, encoding="utf-8")
    with refused("file-changed"):
        read_motion(tmp_path / "a.csv")


def test_stream_limit(monkeypatch):
    monkeypatch.setattr(text_reader, "LONGEST", 100)
    text = "t,qw,qx,qy,qz\n0,1,0,0,0\n1,0,1,0,0\n"
    assert np.array_equal(read_motion(io.StringIO(text)).time, [0, 1])
    with refused("long-stream", size=1e-4):
        read_motion(io.StringIO(text + "2,1,0,0,0\n" * 10))
