"""What makers of sensors call their columns: add a line for a new one.

Headers are compared without case, blanks and marks, and without a unit in brackets at their end: ``Quat_W [-]`` is
``quatw``.
"""

from __future__ import annotations

QUATERNION = ("quaternions", "quaternion", "quat", "q")  # what may be before a letter or number of a quaternion
# The four letters, the scalar first; what is before them, None for anything; whether the scalar is known to be first.
QUATERNIONS = (
    ("w x y z", None, True),  # qw, Quat_W, orientation/w, Quat_W_CAL; Motive
    ("r i j k", QUATERNION, True),
    ("s x y z", QUATERNION, True),
    ("real i j k", QUATERNION, True),
    ("scalar x y z", None, True),  # APDM: Upper/Orientation/Scalar
    ("0 x y z", QUATERNION, True),  # NDI: Q0, Qx, Qy, Qz
    ("0 1 2 3", ("quatq",), True),  # Xsens MT Manager
    ("0 1 2 3", QUATERNION, None),
    ("1 2 3 4", QUATERNION, None),
)
# Nine elements of a matrix that maps body to space, row by row.
MATRICES = (
    "11 12 13 21 22 23 31 32 33",  # r11, Mat[1][1]
    "00 01 02 10 11 12 20 21 22",
    "rot0 rot3 rot6 rot1 rot4 rot7 rot2 rot5 rot8",  # Qualisys QTM, column by column: Λ = Rx(roll) Ry(pitch) Rz(yaw)
    "d1x d2x d3x d1y d2y d3y d1z d2z d3z",  # directors
)
# Axis of the angle that a name stands for, at the end of a header; names of angles before x, y, z.
ANGLES = {"roll": "x", "pitch": "y", "yaw": "z", "heading": "z", "azimuth": "z", "course": "z"}
EULER = ("euler", "angle", "eul")
ROTATION_VECTOR = ("rotvec", "rotationvector", "rotvector", "rv", "r", "axisangle")
# Before x, y, z; those of one or two letters are alone there.
GYROSCOPE: tuple[str, ...] = ("gyroscope", "gyro", "gyr", "angularvelocity", "angularrate", "angvel")
GYROSCOPE += ("rotationrate", "gyrorotation", "omega", "g", "w")
ACCELEROMETER = ("accelerometer", "acceleration", "accel", "acc", "linearacceleration", "a")
# of other sensors and of bodies, not markers
OTHER: tuple[str, ...] = ("magnetometer", "magneticfield", "mag", "m", "pos", "position", "vel", "velocity")
OTHER += ("speed", "force", "f", "torque", "moment", "trans", "translation")
OF_SENSORS = (GYROSCOPE, ACCELEROMETER, OTHER, QUATERNION, ROTATION_VECTOR)
# Columns that name the sensor, body or frame of each row.
SENSOR = {"sensorid", "sensor", "sensorname", "id", "deviceid", "device", "devicetag", "frameid", "childframeid"}
SENSOR |= {"headerframeid", "topic", "body", "bodyid", "segment", "tag", "address", "mac", "name", "trackerid"}
SENSOR |= {"toolid"}
# Words of times, and words that may be beside them; words of numbers of samples.
TIMES = {"t", "time", "timestamp", "stamp", "datetime", "seconds", "secs", "sec", "epoch", "epoc", "datenum"}
TIMES |= {"zeit", "temps", "tiempo", "tempo", "tijd"}
BESIDE_TIME = {"elapsed", "unix", "utc", "cal", "sample", "header", "field", "system", "sensor", "fine", "local"}
BESIDE_TIME |= {"date", "logging", "gps", "gnss", "excel", "serial", "matlab", "day"}
LIKE_TIME = "time|stamp|date|clock|zeit|datum|temps|heure|tiempo|hora|tijd"
COUNTERS = {"packet", "counter", "packetcounter", "frame", "frames", "sample", "samples", "index", "number", "count"}
TICKS = {("sample", "time", "fine")}  # whose length depends on the device
# Parts of a time that may be in columns of their own, beside units of time.
PARTS = {"date": "date", "datum": "date", "time": "time", "zeit": "time", "uhrzeit": "time"}
PARTS |= {"year": "year", "month": "month"}
