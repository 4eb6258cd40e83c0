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
from ..table import number
from .content import Content, by_name, stacked

WORDS = re.compile(r"\b(ROOT|JOINT|End|CHANNELS)\b([^{}\r\n]*)|([{}])")


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
    numbered = [(k, line) for k, line in enumerate(tail.split("\n"), head.count("\n") + 1) if line.strip()]
    stated = {key.lower().strip(): number(value) for key, _, value in (line.partition(":") for _, line in numbered[:2])}
    step, frames = stated.get("frame time"), stated.get("frames")
    if step is None:
        raise InputError("no-frame-time")
    places, width = np.array([k for k, _ in numbered[2:]]), sum(len(channels) for _, _, channels in joints)
    table = stacked([line.split() for _, line in numbered[2:]], width, "motion", places)
    attitudes: list[Rotation] = []
    columns = iter(table.T)
    for _, parent, channels in joints:
        own = [(name, next(columns)) for name in channels]
        turning = {name: column for name, column in own if name.lower().endswith("rotation")}
        turned = Rotation.identity(len(table))
        if turning:
            letters = "".join(name[0].upper() for name in turning)
            turned = Rotation.from_euler(letters, np.stack([*turning.values()], axis=1), degrees=True)
        attitudes.append(turned if parent is None else attitudes[parent] * turned)
    bodies = by_name("joint", ((name, one.as_quat()) for (name, _, _), one in zip(joints, attitudes, strict=True)))
    notes = ["orientation: joints in space, from angles in degrees about moving axes"]
    if frames is not None and frames != len(table):
        notes.append(f"the file states {frames:g} frames and holds {len(table)}: cut short or badly written")
    return Content(bodies=bodies, time=step * np.arange(float(len(table))), notes=tuple(notes), lines=places)


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
                if len(channels) != int(count):
                    raise ValueError
                joints[chain[-1] or 0][2].extend(channels)
            else:
                current = None if word == "End" else len(joints)
                if current is not None:
                    joints.append((rest.strip(), chain[-1], []))
        joints[0]  # there is one
    except (IndexError, ValueError) as error:
        raise InputError("hierarchy") from error
    return joints
