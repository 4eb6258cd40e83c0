"""A reader of your own: the log of a made-up device, a line for each sample, its fields separated by |."""

import tempfile
from pathlib import Path

import numpy as np

from nontwist import read_motion, twist
from nontwist.recordings.formats import READERS, Content, ReadOptions, readable
from nontwist.recordings.table import number


def read_spinlog(path: Path, how: ReadOptions) -> Content:
    """Read a log of a made-up device: time in µs and a quaternion, scalar first, body to space."""
    with readable("spin log"):
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    if not lines:
        raise ValueError("it has no lines of numbers; export the log again")
    rows = [[number(field) for field in line.split("|")] for line in lines]
    for k, row in enumerate(rows):
        if len(row) != 5 or None in row:
            raise ValueError(f"line {k + 1} is {lines[k][:40]!r}, not 5 numbers separated by |; correct or delete it")
    table = np.array(rows, dtype=float)
    quaternions = np.roll(table[:, 1:], -1, axis=1)
    return Content(bodies={"device": quaternions}, time=table[:, 0] * 1e-6, lines=np.arange(1, len(rows) + 1))


READERS[".spin"] = read_spinlog


def write(path: Path | str) -> str:
    """Write the log of half a turn about the third axis to a file, and return it."""
    angles = np.linspace(0, np.pi / 2, 50)
    log = "\n".join(f"{20000 * k}|{np.cos(a):.9f}|0|0|{np.sin(a):.9f}" for k, a in enumerate(angles))
    Path(path).write_text(log, encoding="utf-8")
    return log


def main() -> None:
    """Write a log to a temporary folder, and read it, whole and cut off."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "half.spin"
        log = write(path)
        found = twist(read_motion(path))
        total = np.degrees(found.twist_angle[-1].item())
        print(f"{found.sizes['time']} samples, {found.time[-1].item():g} s: twist {total:.4f}°")
        path.write_text(log[:-14], encoding="utf-8")
        try:
            read_motion(path)
        except ValueError as error:
            print(error)


if __name__ == "__main__":
    main()
