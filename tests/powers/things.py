"""What the calls of the table name: bodies, runs, recordings, and the files of the folder in which they are made."""

import atexit
import hashlib
import shutil
import tempfile
import warnings
from functools import cache
from pathlib import Path

import ezc3d
import h5py
import numpy as np
import pandas
import scipy.io
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import nontwist as nt
from test_recordings import MVNX
from test_two_sensors import MOUNTED, recordings

N = 40
T = np.arange(N) / 50
TURNS = Rotation.from_euler("ZYX", np.stack([0.3 + 2 * T, 0.5 * np.sin(3 * T), 0.4 - T], axis=1))
WXYZ = np.roll(TURNS.as_quat(), 1, axis=1)
WAY = np.stack([0.6 * np.cos(3 * T), 0.6 * np.sin(3 * T), np.full(N, 0.8)], axis=1)
S = np.arange(120) / 200
SPIN = nt.exact.free_standard([1, 2, 2.5], (3, 8, 1), S)[1]
ROUND = 2 * np.pi * np.arange(24)[:, None] / 24
OUT = np.hstack([np.cos(ROUND), np.sin(ROUND), 0 * ROUND])
LOOP = 0.6 * OUT + [0, 0, 0.8]
ACROSS = np.cos(3 * ROUND) * OUT + np.sin(3 * ROUND) * [0, 0, 1]
VERTICES = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
TEXTS = {
    "run.toml": """
body = { kind = "nontwisting", inertia = [3, 4, 5] }
start.angular_velocity.body = [0.3, 0.5, 0]
load = [{ kind = "sine", frame = "body", amplitude = [1, 0, 0], frequency = 2 }]
time = { t_end = 1, step = 0.1 }
""",
    "sweep.toml": """
body = { kind = "standard", inertia = [3, 4, 5] }
start.angular_velocity.body = [0, 1, 0.5]
time = { t_end = 1, step = 0.1 }
sweep.over = [{ key = "start.angular_velocity.body.1", kind = "grid", start = 1, end = 4, count = 4 }]
sweep.variables = ["quaternion", "kinetic_energy"]
sweep.reduce = ["drift", "extrema", "averages", "total_twist"]
""",
    "top.toml": """
body = { kind = "standard", inertia = [2, 2.2, 1] }
start.angular_velocity.body = [0.3, 0.5, 2]
time = { t_end = 1, step = 0.1 }
""",
    "load.csv": "t,x,y,z,more\n0,0,0,0,9\n0.5,1,2,0,9\n1,0,0,3,9\n",
    "plain.csv": "t,x,y,z\n0,0,0,0\n0.5,1,2,0\n1,0,0,3\n",
    "rotor.csv": "t,h\n0,0.1\n1,0.4\n",
    "times.csv": "t,more\n0.2,1\n0.7,2\n",
    "only.csv": "t\n0.2\n0.7\n",
    "own.py": "print('imported')\n",
}


@cache
def things():
    """What a call may name besides the public names: each made once."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return made()


def made():
    """Make them."""
    body, free, top = nt.nontwisting([3, 4, 5]), nt.standard([3, 4, 5]), nt.heavy_top([2, 2.2, 1], 0.5, [0, 0, 0.3])
    held, chain = {"material_angular_velocity": (0.3, 0.5, 0)}, {"material_angular_velocity": (1, 2, 0.5)}
    runs = [nt.simulate(body, t_end=1, step=step, integrator="energy-momentum", **held) for step in (0.1, 0.05, 0.025)]
    load = nt.pulse((1, 0, 0), end=0.5) + nt.rotor((0, 0, 1), 0.3) + nt.spring(2, (0, 0, 1), (0, 0, 2))
    swung = nt.simulate(
        body, t_end=1, step=0.1, load=load, events=nt.axis_crosses((1, 0, 0), (1, 0, 0), cosine=0.98), **held
    )
    thrown = nt.simulate(nt.standard([1, 2, 2.5]), t_end=0.6, step=0.005, material_angular_velocity=(3, 8, 1))
    throw = nt.sensors.gyroscope(thrown, noise=1e-4)
    string = nt.heavy_top([0.020, 0.022, 0.004], mass=0.5, centre_of_mass=(0, 0, -0.15))
    swing = nt.simulate(string, t_end=2, rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]], angular_velocity=(1, 2, 5))
    gyrostat, held_too = (
        nt.sensors.gyroscope(
            nt.simulate(
                kind([1, 2, 2.5]),
                load=nt.rotor(axis, 0.3),
                material_angular_velocity=W,
                **{"t_end": 0.6, "step": 0.005},
            ),
            noise=1e-4,
        )
        for kind, axis, W in ((nt.standard, (0, 0, 1), (3, 8, 1)), (nt.nontwisting, (0, 0.6, 0.8), (3, 8, 0)))
    )
    spins, states = np.array([[0.3, 0.5, 0.1], [1, 2, 0.5], [0, 0.4, 1]]), []
    nt.simulate(free, t_end=1, step=0.5, events=lambda t, state: states.append(state) or 1.0, **chain)
    t, motion, s, other, *_ = recordings(60, (50, 50), 0.0, 2.0, MOUNTED)
    how = {"variables": "all", "reduce": ("drift", "extrema", "averages", "total_twist")}
    wrt = "material_angular_velocity", "load_scale"
    joint = {"time": t, "relative_to": other, "relative_time": s}

    def stepped():
        loop = nt.stepper(free, step=0.1)
        loop.reset(**chain)
        loop.step(body_moment=(0, 0, 1))
        return loop

    def counted():
        counter = nt.TwistCounter()
        counter.update(TURNS[:9])
        return counter

    def failure(action):
        try:
            return action()
        except Exception as error:
            return error

    found = {
        **{name: getattr(nt, name) for name in nt.__all__},
        **{"np": np, "Rotation": Rotation, "T": T, "TURNS": TURNS, "WXYZ": WXYZ, "WAY": WAY, "LOOP": LOOP},
        **{"ACROSS": ACROSS, "VERTICES": VERTICES, "FACES": FACES, "FRAMES": TURNS.as_matrix(), "SPINS": spins},
        **{"LOAD": load, "BODY": body, "FREE": free, "TOP": top, "SPUN": nt.nontwisting([3, 4, 5], spin=0.5)},
        **{"STACK": nt.DirectorSystem.stack([free, top, nt.standard([2, 2, 3])]), "STATE": states[0]},
        **{"RUN": runs[0], "RUN2": runs[1], "RUN4": runs[2], "QUOTIENTS": nt.second_quotient(*runs), "SWUNG": swung},
        **{"THROW": throw, "THROWN": thrown, "PENDULUM": nt.sensors.gyroscope(swing, noise=1e-4, rate=100)},
        **{"GYROSTAT": gyrostat, "HELD": held_too},
        **{
            "STEPPED": stepped,
            "COUNTED": counted,
            "sha": lambda name: hashlib.sha256(Path(name).read_bytes()).hexdigest(),
        },
        "TRAJECTORY": nt.integrate(free, t_end=1, step=0.1, load=load, **chain),
        "ENSEMBLE": nt.simulate_ensemble(top, t_end=1, step=0.1, material_angular_velocity=spins, **how),
        "SENSED": nt.sensitivities(free, t_end=1, step=0.1, wrt=wrt, load=nt.sine((1, 0, 0), 1), **chain),
        "TWIST": nt.twist(swung),
        "JOINT": (motion, joint),
        "JOINED": nt.twist(motion, **joint, clocks="shift", shake=(1, 5)),
        "COMPARED": nt.compare(free, t_end=1, integrators=["split"], steps=[0.1, 0.05], repeats=1, **chain),
        "FIT": nt.fit_inertia(throw, interval="all"),
        "PROPAGATOR": nt.propagator(free, t_end=1, step=0.1),
        "STEERING": nt.steer(TURNS[0], TURNS[30]),
        "EFFORT": nt.least_effort(body, TURNS[0], TURNS[30], t_end=1, nodes=5),
        "FAILED": failure(lambda: nt.simulate(free, t_end=1, step=0.5, material_angular_velocity=(0, 0, 20))),
        "REFUSED": failure(lambda: nt.read_run_file(__file__)),
    }
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder)
    prepare(folder, {"run": runs[0], "swung": swung, "twist": found["TWIST"], "thrown": thrown, "m": thrown})
    for name in ("PENDULUM", "GYROSTAT", "HELD"):
        columns = dict(zip(("gx (rad/s)", "gy (rad/s)", "gz (rad/s)"), found[name].gyroscope.values.T, strict=True))
        pandas.DataFrame({"t (s)": found[name].time.values, **columns}).to_csv(
            folder / f"{name.lower()}.csv", index=False
        )
    for name, when, turned in (("long", t, motion), ("other", s, other)):
        columns = dict(zip(("qx", "qy", "qz", "qw"), turned.as_quat().T, strict=True))
        pandas.DataFrame({"time": when, **columns}).to_csv(folder / f"{name}.csv", index=False)
    return found | {"FOLDER": folder, "SWEPT": nt.open_sweep(folder / "store")}


def prepare(folder, runs):
    """Write the files that calls name."""
    for name, run in runs.items():
        nt.save_run(run, folder / f"{name}.nc")
    for suffix in ("nc4", "h5"):
        shutil.copy(folder / "run.nc", folder / f"m.{suffix}")
    for name, text in TEXTS.items():
        (folder / name).write_text(text, encoding="utf-8")
    nt.sweep(folder / "sweep.toml", folder / "store", workers=1)
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*VERTICES[k]) for k in face)
        + "endloop\nendfacet\n"
        for face in FACES
    )
    (folder / "mesh.stl").write_text(f"solid m\n{facets}endsolid m\n", encoding="utf-8")
    write_recordings(folder)


def write_recordings(folder):
    """Write recordings of every format: m.csv, m.tsv, ..., and those that options are for."""
    named = dict(zip(("time", "qw", "qx", "qy", "qz"), (T, *WXYZ.T), strict=True))
    angles = dict(zip(("time", "x", "y", "z"), (T, *TURNS.as_euler("ZYX", degrees=True).T), strict=True))
    spin = dict(zip(("gx", "gy", "gz"), SPIN.T, strict=True))
    bodies = {f"{body}_{name}": one for body in "ab" for name, one in list(named.items())[1:]}
    tables = {
        "m.csv": named,
        "angles.csv": angles,
        "vectors.csv": angles,
        "rounded.csv": {k: v.round(3) for k, v in named.items()},
    }
    tables |= {
        "bodies.csv": {"time": T, **bodies},
        "gyro.csv": {"t": S, **spin},
        "more.csv": {"t": S, "u": 1000 * S, **spin},
    }
    attitude = Rotation.from_matrix(nt.exact.free_standard([1, 2, 2.5], (3, 8, 1), S)[0]).as_quat()
    tables |= {"both.csv": {"t": S, **spin, **dict(zip(("qx", "qy", "qz", "qw"), attitude.T, strict=True))}}
    tables |= {
        "degrees.csv": {"t": S, **{name: np.degrees(one) for name, one in spin.items()}},
        "clocks.csv": {"u": 2 * T, **named},
    }
    tables |= {
        "sensors.csv": {
            "t": S,
            **{f"{body}_gyr_{x} (rad/s)": w for body in "ab" for x, w in zip("xyz", SPIN.T, strict=True)},
        }
    }
    for name, columns in tables.items():
        pandas.DataFrame(columns).to_csv(folder / name, index=False)
    for suffix in ("tsv", "txt", "dat", "log"):
        pandas.DataFrame(named).to_csv(folder / f"m.{suffix}", index=False, sep="\t")
    for one in (Path(__file__).parents[1] / "data" / "readers").glob("*.[bms][vot][hto]"):
        shutil.copy(one, folder / f"m{one.suffix}")
    frame = '<frame time="{:.0f}" index="{}" type="normal"><orientation>1 0 0 0 {} {} {} {}</orientation></frame>'
    rows = "\n".join(frame.format(1000 * t, k, *q) for k, (t, q) in enumerate(zip(T, WXYZ, strict=True)))
    (folder / "m.mvnx").write_text(MVNX.format(rows), encoding="utf-8")
    np.save(folder / "m.npy", np.column_stack([T, WXYZ]))
    np.savez(folder / "m.npz", arm=WXYZ, t=T)
    scipy.io.savemat(folder / "m.mat", {"quat": WXYZ, "time": T[:, None]})
    with h5py.File(folder / "m73.mat", "w", userblock_size=512) as file:
        file["quat"], file["time"] = WXYZ.T, T[None]
    marks = ezc3d.c3d()
    marks["parameters"]["POINT"]["RATE"]["value"], marks["parameters"]["POINT"]["LABELS"]["value"] = [50], ["m"]
    marks["data"]["points"], marks["data"]["rotations"] = (
        np.zeros((4, 1, N)),
        np.tile(np.eye(4)[:, :, None, None], (1, 1, 1, N)),
    )
    marks["data"]["rotations"][:3, :3, 0] = np.moveaxis(TURNS.as_matrix(), 0, 2)
    marks.add_parameter("ROTATION", "LABELS", ["arm_4X4"])
    marks.write(str(folder / "m.c3d"))
    kinds = rosbag2.StoragePlugin
    write_bag(rosbag1.Writer(folder / "m.bag"), Stores.ROS1_NOETIC, "serialize_ros1", {"seq": 0})
    for plugin in (kinds.SQLITE3, kinds.MCAP):
        write_bag(
            rosbag2.Writer(folder / plugin.name, version=8, storage_plugin=plugin),
            Stores.ROS2_HUMBLE,
            "serialize_cdr",
            {},
        )


def write_bag(writer, types, serialize, first):
    """Write a ROS bag with one topic."""
    store = get_typestore(types)
    names = "builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Quaternion"
    stamped, (when, header, turn) = "geometry_msgs/msg/QuaternionStamped", (store.types[name] for name in names)
    with writer:
        topic = writer.add_connection("/arm", stamped, typestore=store)
        for t, q in zip(T, TURNS.as_quat(), strict=True):
            stamp = when(1_700_000_000, round(1e9 * t))
            message = store.types[stamped](header(**first, stamp=stamp, frame_id="map"), turn(*q))
            writer.write(
                topic, 1_700_000_000_000_000_000 + round(1e9 * t), getattr(store, serialize)(message, topic.msgtype)
            )
