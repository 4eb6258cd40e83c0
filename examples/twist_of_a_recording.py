"""The numbers of docs/tutorials/twist.md: Codman's paradox, a recording, its gyroscope, a gyroscope without errors."""

from pathlib import Path

import numpy as np
import pandas
from scipy.spatial.transform import Rotation

from nontwist import Continuous, rotation, simulate, standard, twist

IMU = Path(__file__).parent / "imu"


def degrees(angle):
    """Format an angle given in rad."""
    return f"{np.degrees(float(angle)):.2f}°"


def codman():
    """Move the arm along an octant: sideways up, to the front, down; never about itself."""
    s = np.linspace(0, np.pi / 2, 91)
    down = Rotation.from_rotvec([np.pi, 0, 0])  # the arm is the z axis of the body and hangs
    up = Rotation.from_rotvec(np.outer(s, [0, -1, 0])) * down
    front = Rotation.from_rotvec(np.outer(s, [0, 0, 1])) * up[-1]
    back = Rotation.from_rotvec(np.outer(s, [-1, 0, 0])) * front[-1]
    arm = twist(Rotation.concatenate([up, front[1:], back[1:]]), order=2)
    end = arm.isel(time=-1)
    print("Codman's paradox, the arm back where it was:")
    print(f"  twist angle        {abs(np.degrees(end.twist_angle.item())):.2f}°")
    print(f"  swing-twist angle  {degrees(end.swing_twist_angle)}")
    print(f"  solid angle        {end.solid_angle.item():.6f} sr = {degrees(end.solid_angle)}")


def recording():
    """Twist of a real recording about the three axes of the sensor."""
    table = pandas.read_csv(IMU / "quaternion.csv")
    motion, time = rotation(table).inv(), table["Time (s)"].to_numpy()  # the sensor reports earth relative to itself
    print("Recording, at its end:")
    for name, axis in {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}.items():
        end = twist(motion, time, axis=axis).isel(time=-1)
        print(
            f"  axis {name}: twist {degrees(end.twist_angle):>8}, swing-twist {degrees(end.swing_twist_angle):>7}, "
            f"solid angle {degrees(end.solid_angle):>6}, error by sampling {degrees(end.error_estimate)}"
        )
    return motion, time


def gyroscope(motion, time):
    """Compare the twist with the integrated gyroscope, and with what a constant bias explains."""
    table = pandas.read_csv(IMU / "sensors.csv")
    clock = table["Time (s)"].to_numpy()
    print("Gyroscope against the recorded attitudes:")
    for k, name in enumerate("XYZ"):
        rate = np.radians(table[f"Gyroscope {name} (deg/s)"].to_numpy())
        turned = np.append(0, np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(clock)))
        gap = twist(motion, time, axis=np.eye(3)[k]).twist_angle.values - np.interp(time, clock, turned)
        gap -= gap[0]
        bias, offset = np.polyfit(time, gap, 1)
        rest = gap - (bias * time + offset)
        print(
            f"  axis {name.lower()}: at the end {degrees(gap[-1]):>7}, r.m.s. {degrees(np.sqrt(np.mean(gap**2)))}; "
            f"a bias of {np.degrees(bias):.2f}°/s leaves {degrees(np.sqrt(np.mean(rest**2)))}"
        )


def synthetic_gyroscope():
    """Integrate the exact angular velocity of a tumbling body: nothing is left to disagree about."""
    time = np.linspace(0, 10, 4001)
    run = simulate(
        standard([1, 2, 2.5]), times=time, angular_velocity=[1, 2, 3], integrator=Continuous(rtol=1e-13, atol=1e-14)
    )
    weights = np.tile([4.0, 2.0], 2000)  # Simpson's rule
    rate = run.twist_rate.values
    integral = (rate[0] - rate[-1] + weights @ rate[1:]) * time[1] / 3
    result = twist(run)
    error = abs(float(result.twist_angle[-1]) - integral)
    print("Gyroscope without errors (tumbling body, 10 s at 400 Hz):")
    print(f"  twist {float(result.twist_angle[-1]):.9f} rad, integrated rate {integral:.9f} rad")
    print(
        f"  difference below 1e-7 rad: {error < 1e-7}; within the estimate: {error <= result.error_estimate[-1].item()}"
    )


if __name__ == "__main__":
    codman()
    gyroscope(*recording())
    synthetic_gyroscope()
