"""ROS bags, version 1 (.bag) and 2 (.db3, .mcap, or their folder), read by rosbags.

Orientations are found in messages of any type with a field ``orientation``, ``pose``, ``quaternion``, ``rotation`` or
``transform``: Imu, PoseStamped, Odometry, QuaternionStamped, TransformStamped, TFMessage. They map the child or body
frame to the frame of the header (REP 103, geometry_msgs); components are named x, y, z, w. A topic that several nodes
publish is one stream; transforms are a stream for each child frame, ``/tf:camera``. The gyroscope and the
accelerometer of sensor_msgs/Imu, and the angular velocity of nav_msgs/Odometry, which is in its child frame, go along,
to tell whether a driver inverts its attitudes.
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
from .content import Content, library, readable

MEASURED = ("gyr_x (rad/s)", "gyr_y (rad/s)", "gyr_z (rad/s)", "acc_x", "acc_y", "acc_z")
INSIDE = ("pose", "orientation", "quaternion", "transform", "rotation")


def read_ros(path: Path, how: ReadOptions) -> Content:
    """Read the orientations of the topic or child frame ``body``, or of the only one that has any."""
    highlevel = library("rosbags.highlevel", "ros")
    typesys = library("rosbags.typesys", "ros")
    folder = path.parent if path.suffix in (".db3",) and (path.parent / "metadata.yaml").exists() else path
    streams: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    topics: list[str] = []
    with readable("ROS bag"):
        store = typesys.get_typestore(typesys.Stores.LATEST)
        with highlevel.AnyReader([folder], default_typestore=store) as bag:
            topics = list(dict.fromkeys(one.topic for one in bag.connections))
            asked = [one for one in bag.connections if how.body is None or how.body.partition(":")[0] == one.topic]
            silent = set[str]()  # types without orientations
            for connection, stamp, raw in bag.messages(connections=asked or bag.connections):
                if connection.msgtype in silent:
                    continue
                message = bag.deserialize(raw, connection.msgtype)
                found = _orientations(message, connection.topic)
                if not found and not hasattr(message, "transforms") and not hasattr(message, "orientation_covariance"):
                    silent.add(connection.msgtype)
                for name, q, clock in found:
                    time = stamp * 1e-9 if clock is None else clock
                    streams[name].append((time, q.x, q.y, q.z, q.w, *_measured(message)))
    if not streams:
        raise InputError("no-messages", topics=listed(topics) or "none")
    named = [name for name in streams if how.body in (None, name, name.partition(":")[2])]
    if len(named) != 1:
        raise InputError("which-topic", names=listed(named or streams))
    rows = np.array(sorted(streams[named[0]], key=lambda row: row[0]), dtype=float)
    start = float(rows[0, 0])
    note = f"orientation: topic {named[0]}, body to the frame of its header"
    columns = {name: one for name, one in zip(MEASURED, rows[:, 5:].T, strict=True) if np.isfinite(one).any()}
    attitudes = {named[0]: rows[:, 1:5]}
    return Content(Table(columns), bodies=attitudes, time=rows[:, 0] - start, start=start, notes=(note,))


def _measured(message: Any) -> tuple[float, ...]:
    """Return what gyroscope and accelerometer measured in the frame of the body, nan where there are none."""
    found: list[float] = []
    if hasattr(message, "child_frame_id") and hasattr(message, "twist"):
        angular = message.twist.twist.angular
        return (angular.x, angular.y, angular.z, math.nan, math.nan, math.nan)
    for name in ("angular_velocity", "linear_acceleration"):
        vector, covariance = getattr(message, name, None), getattr(message, f"{name}_covariance", (-1,))
        found += [math.nan] * 3 if vector is None or covariance[0] == -1 else [vector.x, vector.y, vector.z]
    return tuple(found)


def _orientations(message: Any, name: str) -> list[tuple[str, Any, float | None]]:
    """Return name, quaternion and time of every orientation in a message."""
    if hasattr(message, "transforms"):
        return [found for one in message.transforms for found in _orientations(one, f"{name}:{one.child_frame_id}")]
    covariance = getattr(message, "orientation_covariance", None)
    if covariance is not None and covariance[0] == -1:
        return []  # sensor_msgs/Imu: the device has no estimate of its orientation
    header, inner = getattr(message, "header", None), message
    while not all(hasattr(inner, x) for x in "xyzw"):
        inner = next((getattr(inner, one) for one in INSIDE if hasattr(inner, one)), None)
        if inner is None:
            return []
    clock = None if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec
    return [(name, inner, clock or None)]
