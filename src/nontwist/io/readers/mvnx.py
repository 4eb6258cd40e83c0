"""Xsens MVNX: segments and sensors, quaternions q0 (scalar) ... q3 that map segment or sensor to the global frame.

Source: MVN User Manual, MV0319P, chapter on MVNX: ``orientation`` holds ᴳᴮq of each segment in the order of
``segments``, ``sensorOrientation`` ᴳˢq of each sensor; ``time`` of a frame is in ms; frames of another type than
``normal`` are poses of the calibration.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ...analysis.tables import Reading
from ...analysis.time_values import number
from .content import Content, reading, stacked


def read_mvnx(path: Path, how: Reading) -> Content:
    """Read a file of MVN; sensors have ``sensor`` before their names."""
    labels: dict[str, list[str]] = {"segment": [], "sensor": []}
    rows: dict[str, list[list[float]]] = {"segment": [], "sensor": []}
    times: list[float | None] = []
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
                    _frame(element, rows)
                element.clear()
    if not times:
        raise ValueError("there is no frame of type 'normal' in it")
    bodies = {}
    for kind, prefix in (("segment", ""), ("sensor", "sensor ")):
        if len(rows[kind]) == len(times) and labels[kind]:
            table = stacked(rows[kind], 4 * len(labels[kind]), f"orientation of the {kind}s")
            for k, label in enumerate(labels[kind]):
                bodies[prefix + label] = np.roll(table[:, 4 * k : 4 * k + 4], -1, axis=1)
    if not bodies:
        raise ValueError("there is no orientation in its frames; export it with orientations of segments or sensors")
    time = None if None in times else np.array(times, dtype=float) / 1000
    if time is None and rate:
        time = np.arange(len(times)) / rate
    return Content(bodies=bodies, time=time, notes=("orientation: quaternions of MVNX, scalar first, body to global",))


def _frame(element: Any, rows: dict[str, list[list[float]]]) -> None:
    for child in element:
        kind = {"orientation": "segment", "sensorOrientation": "sensor"}.get(child.tag.rpartition("}")[2])
        if kind is not None:
            rows[kind].append([float(x) for x in (child.text or "").split()])
