"""ROS bags, version 1 (.bag) and 2 (.db3, .mcap, or their folder), read by rosbags.

Orientations are found in messages of any type with a field ``orientation``, ``pose``, ``quaternion``, ``rotation`` or
``transform``: Imu, PoseStamped, Odometry, QuaternionStamped, TransformStamped, TFMessage. They map the child or body
frame to the frame of the header (REP 103, geometry_msgs); components are named x, y, z, w. The gyroscope and the
accelerometer of sensor_msgs/Imu, and the angular velocity of nav_msgs/Odometry, which is in its child frame, go along,
to tell whether a driver inverts its attitudes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...analysis.tables import Reading
from .content import Content, library, reading

MEASURED = ("gyr_x", "gyr_y", "gyr_z", "acc_x", "acc_y", "acc_z")
INSIDE = ("pose", "orientation", "quaternion", "transform", "rotation")


def read_ros(path: Path, how: Reading) -> Content:
    """Read the orientations of the topic ``body``, or of the only one that has any."""
    highlevel = library("rosbags.highlevel", "ros")
    typesys = library("rosbags.typesys", "ros")
    folder = path.parent if path.suffix in (".db3",) and (path.parent / "metadata.yaml").exists() else path
    series: dict[str, list[tuple[float, ...]]] = {}
    beside: dict[str, list[tuple[float, ...]]] = {}
    with reading("ROS bag"):
        store = typesys.get_typestore(typesys.Stores.LATEST)
        with highlevel.AnyReader([folder], default_typestore=store) as bag:
            known = {one.topic: one for one in bag.connections}
            for connection, stamp, raw in bag.messages(connections=list(known.values())):
                message = bag.deserialize(raw, connection.msgtype)
                for name, q, clock in _orientations(message, connection.topic):
                    time = stamp * 1e-9 if clock is None else clock
                    series.setdefault(name, []).append((time, q.x, q.y, q.z, q.w))
                    beside.setdefault(name, []).append(_measured(message))
    if not series:
        raise ValueError(f"no topic contains an orientation; there are {', '.join(known) or 'none'}")
    taken = how.body if how.body in series else next(iter(series)) if len(series) == 1 else None
    if taken is None:
        raise ValueError(f"specify the topic: --body (body=) {', '.join(series)}")
    rows = np.array(series[taken])
    start = float(rows[0, 0])
    note = f"orientation: topic {taken}, body to the frame of its header"
    measured = np.array(beside[taken], dtype=float)
    columns = {name: column for name, column in zip(MEASURED, measured.T, strict=True) if np.isfinite(column).any()}
    return Content(columns, bodies={taken: rows[:, 1:]}, time=rows[:, 0] - start, start=start, notes=(note,))


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
