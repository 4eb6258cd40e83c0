"""Write opensim.sto and opensim.mot with OpenSim (pyopensim 4.5.2): what its own model does, by its own writers.

A body on a FreeJoint is turned through three angles; OpenSim computes its rotation in ground and writes both.
"""

import numpy as np
from pyopensim import common, simbody, simulation

model = simulation.Model()
body = simulation.Body("forearm", 1.0, simbody.Vec3(0), simbody.Inertia(1))
joint = simulation.FreeJoint("free", model.getGround(), body)
model.addBody(body)
model.addJoint(joint)
state = model.initSystem()

quaternions, angles = common.TimeSeriesTableQuaternion(), common.TimeSeriesTable()
quaternions.setColumnLabels(["forearm_imu"])
angles.setColumnLabels(["free_rot_x", "free_rot_y", "free_rot_z"])
for k in range(12):
    t = k / 50
    three = [0.3 + 2 * t, 0.5 * np.sin(9 * t) - 0.2, 0.4 - 3 * t]
    for j, angle in enumerate(three):
        joint.upd_coordinates(j).setValue(state, float(angle))
    model.realizePosition(state)
    rotation = body.getTransformInGround(state).R()
    quaternions.appendRow(t, simbody.RowVectorQuaternion(1, rotation.convertRotationToQuaternion()))
    angles.appendRow(t, simbody.RowVector([float(np.degrees(a)) for a in three]))
quaternions.addTableMetaDataString("DataRate", "50.000000")
common.STOFileAdapterQuaternion.write(quaternions, "opensim.sto")
angles.addTableMetaDataString("inDegrees", "yes")
common.STOFileAdapter.write(angles, "opensim.mot")
