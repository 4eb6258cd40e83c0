"""Files of motion capture in texts: BVH, Xsens MVNX, OpenSim storage (.sto, .mot).

**Biovision hierarchy (BVH)**: the attitudes of joints in space, from the angles of their chain. The channels of a joint
are in the order in which the rotations are multiplied: ``Zrotation Xrotation Yrotation`` is Rz Rx Ry, about moving
axes, in degrees; a joint's attitude is its parent's times its own.

**MVNX**: segments and sensors, quaternions q0 (scalar) ... q3 that map segment or sensor to the global frame. Source:
MVN User Manual, MV0319P, chapter on MVNX: ``orientation`` holds ᴳᴮq of each segment in the order of ``segments``,
``sensorOrientation`` ᴳˢq of each sensor, ``angularVelocity`` that of each segment in the global frame, to tell whether
the file inverts its attitudes; frames of another type than ``normal`` are poses of the calibration. ``time`` of a frame
is in whole ms, or in s, as the frame rate decides: where ``index`` over ``frameRate`` agrees to 1 ms with those there
are, that is the time.

**OpenSim**: the header ends with ``endheader``; it holds ``DataType=Quaternion`` for quaternions, ``w,x,y,z`` in a
field each, and ``inDegrees=yes`` or ``no`` for angles. Labels follow, then rows, separated by tabs or blanks, or by
commas where a spreadsheet has saved the file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array
from ..options import ReadOptions
from ..table import Content, Table, by_name, number, numbered, place, stacked
from ..text import fields_of, opened
from .libraries import readable

WORDS = re.compile(r"\b(ROOT|JOINT|End|CHANNELS)\b([^{}\r\n]*)|([{}])")
IN_SECONDS = 30.0  # periods of the frame rate: times that are closer together are no ms, which would be 1000
ROUNDED = 1.5e-3  # s, by which the times of frames, in whole ms, miss those of their indices
TAGS = {"orientation": ("segment", 4), "sensorOrientation": ("sensor", 4), "angularVelocity": ("segment", 3)}


def read_bvh(path: Path, how: ReadOptions) -> Content:
    """Read the joints of a file."""
    from scipy.spatial.transform import Rotation

    with open(path, encoding="utf-8-sig", errors="replace") as file:
        head, motion, tail = file.read().partition("MOTION")
    if not motion or "HIERARCHY" not in head:
        raise InputError("no-hierarchy")
    joints = _joints(head)
    if "," in tail and not re.search(r"\d\.\d", tail):
        tail = re.sub(r"(?<=\d),(?=\d)", ".", tail)
    content = [(k, line) for k, line in enumerate(tail.split("\n"), head.count("\n") + 1) if line.strip()]
    stated = {key.lower().strip(): number(value) for key, _, value in (line.partition(":") for _, line in content[:2])}
    step, frames = stated.get("frame time"), stated.get("frames")
    if step is None or not (how.rate or 0 < step < np.inf):
        raise InputError("no-frame-time")
    places, width = np.array([k for k, _ in content[2:]]), sum(len(channels) for _, _, channels in joints)
    table = stacked([line.split() for _, line in content[2:]], width, "motion", places)
    attitudes: list[Rotation] = []
    columns = iter(table.T)
    for _, parent, channels in joints:
        angles = [column for name, column in zip(channels, columns, strict=False) if _axes([name])]
        turned = Rotation.identity(len(table))
        if angles:
            turned = Rotation.from_euler(_axes(channels), np.stack(angles, axis=1), degrees=True)
        attitudes.append(turned if parent is None else attitudes[parent] * turned)
    bodies = by_name("joint", ((name, one.as_quat()) for (name, _, _), one in zip(joints, attitudes, strict=True)))
    notes = ["orientation: joints in space, from angles in degrees about moving axes"]
    if frames is not None and frames != len(table):
        notes.append(f"the file states {frames:g} frames and holds {len(table)}: cut short or badly written")
    return Content(bodies=bodies, time=step * np.arange(float(len(table))), notes=tuple(notes), lines=places)


def _axes(channels: Sequence[str]) -> str:
    """Return the letters of the axes that the rotations among channels are about."""
    return "".join(name[0].upper() for name in channels if name.lower().endswith("rotation"))


def _joints(head: str) -> list[tuple[str, int | None, list[str]]]:
    """Return name, index of the parent and channels of every joint, parents first."""
    joints: list[tuple[str, int | None, list[str]]] = []
    chain: list[int | None] = [None]  # of joints that are open; None is outside of them, or an end
    current: int | None = None
    try:
        for word, rest, brace in WORDS.findall(head):
            if brace == "{":
                chain.append(current)
            elif brace:
                chain.pop()
            elif word == "CHANNELS":
                count, *channels = rest.split()
                own = joints[chain[-1] or 0][2]
                own += channels
                is_known = re.fullmatch(r"(?!.*(.)\1)[XYZ]{0,3}", _axes(own))
                if len(channels) != int(count) or not is_known or (channels and chain[-1] is None):
                    raise ValueError
            else:
                current = None if word == "End" else len(joints)
                if current is not None:
                    joints.append((rest.strip(), chain[-1], []))
        joints[0]  # there is one
    except (IndexError, ValueError) as error:
        raise InputError("hierarchy") from error
    return joints


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
    exact, steps = indices / (rate or np.nan), np.diff(times)
    steps = steps[steps > 0]
    is_in_seconds = steps.size > 0 and np.median(steps) * (rate or np.inf) < IN_SECONDS
    times = times if is_in_seconds else times / 1000
    if np.isfinite(exact).all() and np.fmax.reduce(abs(exact - times), initial=0.0) < ROUNDED:
        return np.asarray(exact)
    if np.isfinite(times).any():
        return np.asarray(times)
    return np.arange(len(times)) / rate if rate else None


def read_opensim(path: Path, how: ReadOptions) -> Content:
    """Read a storage file."""
    lines = opened(path.read_bytes()).read().splitlines()
    above = [line.strip(" \t,;\r") for line in lines]
    end = next((k for k, line in enumerate(above) if line.lower() == "endheader"), None)
    if end is None:
        raise InputError("no-endheader")
    stated = {key.strip().lower(): value.strip() for key, _, value in (line.partition("=") for line in above[:end])}
    content = [(k, line) for k, line in enumerate(lines[end + 1 :], end + 2) if line.strip(" \t,;")]
    if len(content) < 2:
        raise InputError("no-rows")
    first = content[0][1]
    sign = next((one for one in ",;" if one in first and "\t" not in first), None)
    labels, *cells = [fields_of(line, sign) for _, line in content]
    if sign == ";" and not any("." in cell for row in cells for cell in row):
        cells = [[cell.replace(",", ".") for cell in row] for row in cells]
    places = np.array([k for k, _ in content[1:]])
    is_quaternion = stated.get("datatype", "").lower() == "quaternion" or any("," in cell for cell in cells[0])
    if not is_quaternion and all(labels.count(name) < 2 for name in how.columns or ()):
        labels = numbered(labels)  # forces, which two plates have
    for k, row in enumerate(cells):
        if len(row) != len(labels):
            raise InputError("labels", place=place(k, places), count=len(row), labels=len(labels))
    columns = (np.array(one, dtype=object) for one in zip(*cells, strict=True))
    table = Table(by_name("column", zip(labels, columns, strict=True)), places)
    if is_quaternion:
        time = next((table.numbers(label) for label in labels if label.lower() == "time"), None)
        bodies = {}
        for label in labels:
            if label.lower() != "time":
                rows = [cell.split(",") for cell in table.columns[label]]
                bodies[label] = np.roll(stacked(rows, 4, f"quaternion {label!r}", places), -1, axis=1)
        note = "orientation: quaternions of OpenSim, scalar first"
        return Content(bodies=bodies, time=time, notes=(note,), lines=places)
    units: dict[str, Literal["deg", "rad"]] = {"yes": "deg", "no": "rad"}
    unit = units.get(stated.get("indegrees", "").lower())
    note = "angles: " + (f"{unit}, as inDegrees={stated['indegrees']} says" if unit else "the header has no inDegrees")
    numbers = {label: table.numbers(label) for label in labels}
    return Content(Table(numbers, places), angle_unit=unit, notes=(note,))
