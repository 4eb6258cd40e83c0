"""Xsens MVNX: segments and sensors, quaternions q0 (scalar) ... q3 that map segment or sensor to the global frame.

Source: MVN User Manual, MV0319P, chapter on MVNX: ``orientation`` holds ᴳᴮq of each segment in the order of
``segments``, ``sensorOrientation`` ᴳˢq of each sensor, ``angularVelocity`` that of each segment in the global frame,
to tell whether the file inverts its attitudes; frames of another type than ``normal`` are poses of the calibration.
``time`` of a frame is in whole ms: where ``index`` over ``frameRate`` agrees to 1 ms, that is the time.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ..options import ReadOptions
from ..table import number
from .apart import readable
from .content import Content, by_name, stacked

ROUNDED = 1.5e-3  # s, by which the times of frames, in whole ms, miss those of their indices
TAGS = {"orientation": ("segment", 4), "sensorOrientation": ("sensor", 4), "angularVelocity": ("segment", 3)}


def read_mvnx(path: Path, how: ReadOptions) -> Content:
    """Read a file of MVN; sensors have ``sensor`` before their names."""
    labels: dict[str, list[str]] = {"segment": [], "sensor": []}
    rows: dict[str, list[list[float]]] = {tag: [] for tag in TAGS}
    stated: list[tuple[float | None, float | None]] = []  # time and index of each frame
    rate: float | None = None
    with readable("MVNX file"):
        for event, element in ElementTree.iterparse(path, events=("start", "end")):
            tag = element.tag.rpartition("}")[2]
            if event == "start" and tag == "subject":
                rate = number(element.get("frameRate"))
            elif event == "end" and tag in labels and element.get("label"):
                labels[tag].append(str(element.get("label")))
            elif event == "end" and tag == "frame":
                if element.get("type", "normal") == "normal":
                    stated.append((number(element.get("time")), number(element.get("index"))))
                    for child in element:
                        if (name := child.tag.rpartition("}")[2]) in TAGS:
                            rows[name].append([float(x) for x in (child.text or "").split()])
                element.clear()
    if not stated:
        raise InputError("no-frames")
    of: dict[str, dict[str, Array]] = {}
    for tag, (kind, width) in TAGS.items():
        names = labels[kind] if len(rows[tag]) == len(stated) else []
        table = stacked(rows[tag], width * len(names), f"{tag} of the {kind}s") if names else np.empty((0, 0))
        columns = ((name, table[:, width * k : width * (k + 1)]) for k, name in enumerate(names))
        of[tag] = by_name(kind, columns)
    sensors = {f"sensor {label}": table for label, table in of["sensorOrientation"].items()}
    bodies = {name: np.roll(table, -1, axis=1) for name, table in (of["orientation"] | sensors).items()}
    if not bodies:
        raise InputError("no-frames")
    note = "orientation: quaternions of MVNX, scalar first, body to global"
    return Content(bodies=bodies, spins=of["angularVelocity"], time=_time(stated, rate), notes=(note,))


def _time(stated: list[tuple[float | None, float | None]], rate: float | None) -> Array | None:
    times, indices = np.array(stated, dtype=float).T
    if np.isnan(times).any():
        return np.arange(len(times)) / rate if rate else None
    exact = indices / rate if rate else indices * np.nan
    return np.asarray(exact if abs(exact - times / 1000).max() < ROUNDED else times / 1000)
