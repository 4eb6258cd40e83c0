"""Biovision hierarchy (BVH): the attitudes of joints in space, from the angles of their chain.

The channels of a joint stand in the order in which the rotations are multiplied: ``Zrotation Xrotation Yrotation`` is
Rz Rx Ry, about moving axes, in degrees; a joint's attitude is its parent's times its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...analysis.places import RowError, naming
from ...analysis.tables import Reading
from ...analysis.time_values import number
from .content import Content, stacked


def read_bvh(path: Path, how: Reading) -> Content:
    """Read the joints of a file."""
    from scipy.spatial.transform import Rotation

    with open(path, encoding="utf-8-sig", errors="replace") as file:
        head, motion, tail = file.read().partition("MOTION")
    if not motion or "HIERARCHY" not in head:
        raise ValueError("it has no HIERARCHY followed by MOTION, as a BVH file has")
    joints = _joints(iter(head.split()))
    first = head.count("\n") + 1  # the line of MOTION
    numbered = [(k, line.strip()) for k, line in enumerate(tail.split("\n"), first) if line.strip()]
    places, lines = np.array([k for k, _ in numbered[2:]]), [line for _, line in numbered]
    stated = {key.lower(): number(value) for key, _, value in (line.partition(":") for line in lines[:2])}
    step = stated.get("frame time")
    if step is None:
        raise ValueError("there is no line 'Frame Time:' below MOTION")
    width = sum(len(channels) for _, _, channels in joints)
    with naming(places):
        rows = [[_float(x, k) for x in line.split()] for k, line in enumerate(lines[2:])]
    table = stacked(rows, width, "motion", places)
    attitudes: list[Rotation] = []
    start = 0
    for _, parent, channels in joints:
        turning = [k for k, name in enumerate(channels) if name.lower().endswith("rotation")]
        own = Rotation.identity(len(table))
        if turning:
            letters = "".join(channels[k][0].upper() for k in turning)
            own = Rotation.from_euler(letters, table[:, [start + k for k in turning]], degrees=True)
        attitudes.append(own if parent is None else attitudes[parent] * own)
        start += len(channels)
    bodies = {name: attitude.as_quat() for (name, _, _), attitude in zip(joints, attitudes, strict=True)}
    notes = ["orientation: joints in space, from angles in degrees about moving axes"]
    frames = stated.get("frames")
    if frames is not None and frames != len(table):
        notes.append(f"the file states {frames:g} frames and holds {len(table)}: cut short or badly written")
    return Content(bodies=bodies, time=step * np.arange(len(table), dtype=float), notes=tuple(notes), lines=places)


def _joints(words: Iterator[str]) -> list[tuple[str, int | None, list[str]]]:
    """Return name, index of the parent and channels of every joint, parents first."""
    joints: list[tuple[str, int | None, list[str]]] = []
    chain: list[int | None] = []
    current: int | None = None
    try:
        for word in words:
            if word in ("ROOT", "JOINT"):
                parent = next((one for one in reversed(chain) if one is not None), None)
                current = len(joints)
                joints.append((next(words), parent, []))
            elif word == "End":
                next(words)
                current = None
            elif word == "{":
                chain.append(current)
            elif word == "}":
                chain.pop()
            elif word == "CHANNELS":
                joints[chain[-1] or 0][2].extend(next(words) for _ in range(int(next(words))))
    except (StopIteration, RuntimeError, IndexError, ValueError) as error:
        raise ValueError("its HIERARCHY is cut short or not one of a BVH file") from error
    if not joints:
        raise ValueError("its HIERARCHY has no ROOT")
    return joints


def _float(text: str, row: int) -> float:
    value = number(text)
    if value is None:
        raise RowError(f"the motion holds {text!r} in", row, ", which is not a number")
    return value
