"""Biovision hierarchy (BVH): the attitudes of joints in space, from the angles of their chain.

The channels of a joint are in the order in which the rotations are multiplied: ``Zrotation Xrotation Yrotation`` is
Rz Rx Ry, about moving axes, in degrees; a joint's attitude is its parent's times its own.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from ..table import number, place
from .content import Content, by_name, stacked


def read_bvh(path: Path, how: ReadOptions) -> Content:
    """Read the joints of a file."""
    from scipy.spatial.transform import Rotation

    with open(path, encoding="utf-8-sig", errors="replace") as file:
        head, motion, tail = file.read().partition("MOTION")
    if not motion or "HIERARCHY" not in head:
        raise InputError("no-hierarchy")
    joints = _joints(head.splitlines())
    if re.search(r"\d,\d", tail) and not re.search(r"\d\.\d", tail):
        tail = re.sub(r"(?<=\d),(?=\d)", ".", tail)
    numbered = [(k, line.strip()) for k, line in enumerate(tail.split("\n"), head.count("\n") + 1) if line.strip()]
    places, lines = np.array([k for k, _ in numbered[2:]]), [line for _, line in numbered]
    stated = {key.lower().strip(): number(value) for key, _, value in (line.partition(":") for line in lines[:2])}
    step, frames = stated.get("frame time"), stated.get("frames")
    if step is None:
        raise InputError("no-frame-time")
    rows = [line.split() for line in lines[2:]]
    for k, row in enumerate(rows):
        if wrong := [cell for cell in row if number(cell) is None]:
            raise InputError("not-a-number", what="the motion", value=wrong[0], place=place(k, places))
    width = sum(len(channels) for _, _, channels in joints)
    table = stacked([[float(x) for x in row] for row in rows], width, "motion", places)
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
    bodies = by_name("joint", ((name, one.as_quat()) for (name, _, _), one in zip(joints, attitudes, strict=True)))
    notes = ["orientation: joints in space, from angles in degrees about moving axes"]
    if frames is not None and frames != len(table):
        notes.append(f"the file states {frames:g} frames and holds {len(table)}: cut short or badly written")
    time = step * np.arange(len(table), dtype=float)
    return Content(bodies=bodies, time=time, notes=tuple(notes), lines=places)


def _joints(lines: list[str]) -> list[tuple[str, int | None, list[str]]]:
    """Return name, index of the parent and channels of every joint, parents first."""
    joints: list[tuple[str, int | None, list[str]]] = []
    chain: list[int | None] = []
    current: int | None = None
    try:
        for line in "\n".join(lines).replace("{", "\n{\n").replace("}", "\n}\n").split("\n"):
            word, _, rest = line.strip().partition(" ")
            if word in ("ROOT", "JOINT"):
                parent = next((one for one in reversed(chain) if one is not None), None)
                current = len(joints)
                joints.append((rest.strip(), parent, []))
            elif word == "End":
                current = None
            elif word == "{":
                chain.append(current)
            elif word == "}":
                chain.pop()
            elif word == "CHANNELS":
                count, *channels = rest.split()
                if len(channels) != int(count):
                    raise ValueError
                joints[chain[-1] or 0][2].extend(channels)
    except (IndexError, ValueError) as error:
        raise InputError("hierarchy") from error
    if not joints:
        raise InputError("hierarchy")
    return joints
