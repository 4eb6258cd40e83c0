"""Write bvhio.bvh with bvhio 1.5.4: a chain of three joints, each with channels in another order.

The rotations that go in are quaternions; bvhio makes the angles of the channels of them, in 32 bits.
"""

import bvhio
import glm
import numpy as np
from SpatialTransform import Pose

CHANNELS = {
    "upper": ["Xposition", "Yposition", "Zposition", "Zrotation", "Xrotation", "Yrotation"],
    "fore": ["Yrotation", "Zrotation", "Xrotation"],
    "hand": ["Xrotation", "Yrotation", "Zrotation"],
}


def turned(k: int, j: int) -> glm.quat:
    """Return the rotation of joint j against its parent in frame k: by its vector, as in test_recordings."""
    vector = np.array([0.7 * np.sin(0.4 * k + j), 0.2 * j - 0.05 * k, 0.3 + 0.1 * k])
    angle = float(np.linalg.norm(vector))
    return glm.angleAxis(angle, glm.vec3(*(vector / angle)))


joints = []
for j, (name, channels) in enumerate(CHANNELS.items()):
    joint = bvhio.BvhJoint(name, glm.vec3(0, 10 * j, 0))
    joint.Channels = channels
    joint.Keyframes = [Pose(glm.vec3(0, 10 * j, 0), turned(k, j)) for k in range(12)]
    if joints:
        joints[-1].Children = [joint]
    joints.append(joint)
bvhio.writeBvh("bvhio.bvh", bvhio.BvhContainer(joints[0], 12, 0.02), 12)
