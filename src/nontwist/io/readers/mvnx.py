"""Xsens MVNX: segments and sensors, quaternions q0 (scalar) ... q3 that map segment or sensor to the global frame.

Source: MVN User Manual, MV0319P, chapter on MVNX: ``orientation`` holds ᴳᴮq of each segment in the order of
``segments``, ``sensorOrientation`` ᴳˢq of each sensor, ``angularVelocity`` that of each segment in the global frame,
to tell whether the file inverts its attitudes; frames of another type than ``normal`` are poses of the calibration.
``time`` of a frame is in whole ms: where ``index`` over ``frameRate`` agrees to 1 ms, that is the time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ...analysis.tables import Reading
from ...analysis.time_values import number
from ...geometry.arrays import Array
from .content import Content, reading, stacked

ROUNDED = 1.5e-3  # s, by which the times of frames, in whole ms, miss those of their indices
TAGS = {"orientation": ("segment", 4), "sensorOrientation": ("sensor", 4), "angularVelocity": ("segment", 3)}


def read_mvnx(path: Path, how: Reading) -> Content:
    """Read a file of MVN; sensors have ``sensor`` before their names."""
    labels: dict[str, list[str]] = {"segment": [], "sensor": []}
    rows: dict[str, list[list[float]]] = {tag: [] for tag in TAGS}
    times: list[float | None] = []
    indices: list[float | None] = []
    rate: float | None = None
    with reading("MVNX file"):
        for event, element in ElementTree.iterparse(path, events=("start", "end")):
            tag = element.tag.rpartition("}")[2]
            if event == "start" and tag == "subject":
                rate = number(element.get("frameRate"))
            elif event == "end" and tag in labels and element.get("label"):
                labels[tag].append(str(element.get("label")))
            elif event == "end" and tag == "frame":
                if element.get("type", "normal") == "normal":
                    times.append(number(element.get("time")))
                    indices.append(number(element.get("index")))
                    _frame(element, rows)
                element.clear()
    if not times:
        raise ValueError("there is no frame of type 'normal' in it")
    of = {tag: _by_label(tag, rows[tag], labels, len(times)) for tag in TAGS}
    sensors = {f"sensor {label}": table for label, table in of["sensorOrientation"].items()}
    bodies = {name: np.roll(table, -1, axis=1) for name, table in (of["orientation"] | sensors).items()}
    if not bodies:
        raise ValueError("there is no orientation in its frames; export it with orientations of segments or sensors")
    note = "orientation: quaternions of MVNX, scalar first, body to global"
    return Content(bodies=bodies, spins=of["angularVelocity"], time=_time(times, indices, rate), notes=(note,))


def _frame(element: Any, rows: dict[str, list[list[float]]]) -> None:
    for child in element:
        tag = child.tag.rpartition("}")[2]
        if tag in TAGS:
            rows[tag].append([float(x) for x in (child.text or "").split()])


def _by_label(tag: str, rows: list[list[float]], labels: dict[str, list[str]], count: int) -> dict[str, Array]:
    """Return the columns of each segment or sensor; empty where the frames do not have them."""
    kind, width = TAGS[tag]
    if len(rows) != count or not labels[kind]:
        return {}
    table = stacked(rows, width * len(labels[kind]), f"{tag} of the {kind}s")
    return {label: table[:, width * k : width * (k + 1)] for k, label in enumerate(labels[kind])}


def _time(times: list[float | None], indices: list[float | None], rate: float | None) -> Array | None:
    stated = None if None in times else np.array(times, dtype=float) / 1000
    exact = np.array(indices, dtype=float) / rate if rate and None not in indices else None
    if stated is None:
        return np.arange(len(times)) / rate if rate else None
    return exact if exact is not None and abs(exact - stated).max() < ROUNDED else stated
