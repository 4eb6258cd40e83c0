"""Readers of recordings; `READERS` maps each suffix to its reader.

A reader takes a path and the options of the caller (`ReadOptions`), and returns a `Content`. To add one, add a file
here and its line in `READERS`, or set ``READERS[".suffix"]`` in a module of your own.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..options import ReadOptions
from ..table import Content
from ..text import read_gyroflow, read_text
from .capture import read_bvh, read_mvnx, read_opensim
from .libraries import read_c3d, read_matlab, read_numpy, read_ros, read_run, read_spice, readable

READERS: dict[str, Callable[[Path, ReadOptions], Content]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".log"), read_text),
    ".gcsv": read_gyroflow,
    **dict.fromkeys((".sto", ".mot"), read_opensim),
    ".mvnx": read_mvnx,
    ".bvh": read_bvh,
    **dict.fromkeys((".npy", ".npz"), read_numpy),
    ".mat": read_matlab,
    ".c3d": read_c3d,
    **dict.fromkeys((".bag", ".mcap", ".db3"), read_ros),
    ".tm": read_spice,
    **dict.fromkeys((".nc", ".nc4", ".h5"), read_run),
}
# How files begin whose suffix says nothing: the suffix of their reader, or the code of an error and what they are.
BEGINNINGS: dict[bytes, str | tuple[str, str]] = {
    **{b"\x93NUMPY": ".npy", b"HIERARCHY": ".bvh", b"#ROSBAG": ".bag", b"\x89MCAP0": ".mcap"},
    **{b"PK\x03\x04": ("packed", "a ZIP archive"), b"7z\xbc\xaf": ("packed", "a 7z archive")},
    **{b"\x1f\x8b": ("packed", "packed by gzip"), b"BZh": ("packed", "packed by bzip2")},
    **dict.fromkeys((b"{", b"["), ("json", "")),
    **{b"#!OML:ASF": ("skeleton", ""), b"PathFileType": ("trc", "")},
}

__all__ = ["BEGINNINGS", "READERS", "Content", "ReadOptions", "readable"]
