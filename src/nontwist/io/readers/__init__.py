"""Readers of recordings, one file each; `READERS` maps each suffix to its reader.

A reader takes a path and the options of the caller (`Reading`), and returns a `Content`. To add one, add a file here
and its line in `READERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ...analysis.tables import Reading
from .arrays import read_npy, read_npz
from .bvh import read_bvh
from .c3d import read_c3d
from .content import Content
from .matlab import read_mat
from .mvnx import read_mvnx
from .opensim import read_opensim
from .ros import read_ros
from .runs import read_run
from .spice import read_spice
from .text import read_text

READERS: dict[str, Callable[[Path, Reading], Content]] = {
    ".csv": read_text,
    ".tsv": read_text,
    ".txt": read_text,
    ".dat": read_text,
    ".log": read_text,
    ".sto": read_opensim,
    ".mot": read_opensim,
    ".mvnx": read_mvnx,
    ".bvh": read_bvh,
    ".npy": read_npy,
    ".npz": read_npz,
    ".mat": read_mat,
    ".c3d": read_c3d,
    ".bag": read_ros,
    ".mcap": read_ros,
    ".db3": read_ros,
    ".tm": read_spice,
    ".nc": read_run,
    ".nc4": read_run,
    ".h5": read_run,
}

__all__ = ["READERS", "Content", "Reading"]
