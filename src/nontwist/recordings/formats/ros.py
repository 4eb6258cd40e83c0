"""ROS bags, version 1 (.bag) and 2 (.db3, .mcap, or their folder), read by rosbags.

Orientations are found in messages of any type with one of the fields `INSIDE`. They map the child or body frame to the
frame of the header (REP 103, geometry_msgs). A topic that several nodes publish is one stream; transforms are a stream
for each child frame, ``/tf:camera``. The gyroscope and the accelerometer of sensor_msgs/Imu, and the angular velocity
of nav_msgs/Odometry, which is in its child frame, go along, to tell whether a driver inverts its attitudes.
"""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ..options import ReadOptions
from ..table import Table, listed
from .apart import library, readable
from .content import Content

MEASURED = ("gyr_x (rad/s)", "gyr_y (rad/s)", "gyr_z (rad/s)", "acc_x", "acc_y", "acc_z")
SENSORS = ("angular_velocity", "linear_acceleration")
INSIDE = ("pose", "orientation", "quaternion", "transform", "rotation")


def read_ros(path: Path, how: ReadOptions) -> Content:
    """Read the orientations of the topic or child frame ``body``, or of the only one that has any."""
    highlevel, typesys = (library(f"rosbags.{name}", "ros") for name in ("highlevel", "typesys"))
    folder = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").exists() else path
    streams: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    with readable("ROS bag"):
        store = typesys.get_typestore(typesys.Stores.LATEST)
        with highlevel.AnyReader([folder], default_typestore=store) as bag:
            topics = list(dict.fromkeys(one.topic for one in bag.connections))
            asked = [one for one in bag.connections if how.body and how.body.partition(":")[0] == one.topic]
            silent = set[str]()  # types without orientations
            for connection, stamp, raw in bag.messages(connections=asked or bag.connections):
                if connection.msgtype in silent:
                    continue
                message = bag.deserialize(raw, connection.msgtype)
                found = _orientations(message, connection.topic)
                if not found and not hasattr(message, "transforms") and not hasattr(message, "orientation_covariance"):
                    silent.add(connection.msgtype)
                for name, q, clock in found:
                    streams[name].append((clock or stamp * 1e-9, q.x, q.y, q.z, q.w, *_measured(message)))
    if not streams:
        raise InputError("no-messages", topics=listed(topics) or "none")
    named = [name for name in streams if how.body in (None, name, name.partition(":")[2])]
    if len(named) != 1:
        raise InputError("which-topic", names=listed(named or streams))
    rows = np.array(sorted(streams[named[0]], key=lambda row: row[0]), dtype=float)
    start, bodies = float(rows[0, 0]), {named[0]: rows[:, 1:5]}
    note = f"orientation: topic {named[0]}, body to the frame of its header"
    columns = {name: one for name, one in zip(MEASURED, rows[:, 5:].T, strict=True) if np.isfinite(one).any()}
    return Content(Table(columns), bodies, time=rows[:, 0] - start, start=start, notes=(note,))


def _measured(message: Any) -> tuple[float, ...]:
    """Return what gyroscope and accelerometer measured in the frame of the body, nan where there are none."""
    names = [name for name in SENSORS if getattr(message, f"{name}_covariance", (-1,))[0] != -1]
    vectors = [getattr(message, name) if name in names else None for name in SENSORS]
    if hasattr(message, "child_frame_id") and hasattr(message, "twist"):
        vectors = [message.twist.twist.angular, None]
    return tuple(x for one in vectors for x in ((math.nan,) * 3 if one is None else (one.x, one.y, one.z)))


def _orientations(message: Any, name: str) -> list[tuple[str, Any, float]]:
    """Return name, quaternion and time, 0 without one, of every orientation in a message."""
    if hasattr(message, "transforms"):
        return [found for one in message.transforms for found in _orientations(one, f"{name}:{one.child_frame_id}")]
    inner = message
    while inner is not None and not all(hasattr(inner, x) for x in "xyzw"):
        inner = next((getattr(inner, one) for one in INSIDE if hasattr(inner, one)), None)
    if inner is None or getattr(message, "orientation_covariance", (0,))[0] == -1:
        return []  # a device of sensor_msgs/Imu may have no estimate of its orientation
    header = getattr(message, "header", None)
    return [(name, inner, 0.0 if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec)]
