"""Recordings as their makers write them.

Files that a reference library wrote lie in data/readers; the others have the structure of real exports: MT Manager
4.6 to 2022 and APDM (test data of OpenSim), OptiTrack Motive 1.21 and 1.23, Xsens MVN 2019.
"""

import io

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from nontwist import read_motion, rotation, twist
from nontwist.cli import app
from nontwist.recordings.reading import read_rates
from recordings.makers import ACC, DATA, GYR, N, R, T, apdm, mt_manager, mvnx
from refusals import refused, warned

FILES = DATA / "readers"
WXYZ = np.roll(R.as_quat(), 1, axis=1)


def same(found, expected=R, tolerance=1e-12):
    assert (rotation(found).inv() * expected).magnitude().max() < tolerance


def test_opensim_writes_its_quaternions_and_angles_as_we_read_them():
    t = np.arange(12) / 50
    three = np.stack([0.3 + 2 * t, 0.5 * np.sin(9 * t) - 0.2, 0.4 - 3 * t], axis=1)
    quaternions = read_motion(FILES / "opensim.sto")
    same(quaternions, Rotation.from_euler("XYZ", three), 1e-14)
    assert quaternions.time.values == pytest.approx(t, abs=1e-15)
    angles = read_motion(FILES / "opensim.mot", [f"free_rot_{x}" for x in "xyz"], euler="XYZ")
    same(angles, Rotation.from_euler("XYZ", three), 1e-14)
    # its rotation in ground of the last frame, as SimTK::Rotation gave it
    last = [
        [0.934227080753713, 0.24852452834453098, 0.25584237412423283],
        [-0.02313259708242066, 0.7579979454246571, -0.6518466059466912],
        [-0.35592786423461975, 0.6030544532155674, 0.7138912255506824],
    ]
    assert abs(rotation(quaternions)[-1].as_matrix() - last).max() < 1e-14


def test_bvhio_writes_the_chain_that_we_read():
    k = np.arange(12)
    whole = Rotation.identity(12)
    for j, name in enumerate(("upper", "fore", "hand")):
        vectors = np.stack([0.7 * np.sin(0.4 * k + j), 0.2 * j - 0.05 * k, 0.3 + 0.1 * k], axis=1)
        whole = whole * Rotation.from_rotvec(vectors)
        found = read_motion(FILES / "bvhio.bvh", body=name)
        same(found, whole, 1e-6)  # it computes in 32 bits
        assert found.time.values == pytest.approx(0.02 * k)


@pytest.mark.parametrize("separator", ["\t", ";", ",", " "])
def test_mt_manager_with_empty_fields_in_each_of_its_separators(separator):
    found = read_motion(io.StringIO(mt_manager(separator)), rate=50, normalize=True)
    same(found, tolerance=2e-6)
    assert found.time.values == pytest.approx(T)
    assert "checked: agreement with the gyroscope 1.00 as it is" in found.notes


def test_blanks_that_hide_empty_fields_are_refused():
    aligned = mt_manager(" ").replace("      ", "   ")
    with refused("empty-fields", headers=21, fields=16):
        read_motion(io.StringIO(aligned), rate=50)


def test_a_quaternion_and_the_same_attitude_as_a_matrix_are_one():
    text = mt_manager("\t", ("Acc", "Gyr", "Quat", "Euler", "Mat"))
    found = read_motion(io.StringIO(text), rate=50, normalize=True)
    same(found, tolerance=2e-6)
    assert found.notes.startswith("orientation: quaternion Quat_q0, Quat_q1, Quat_q2, Quat_q3; ")
    mixed = text.replace("Quat_q1", "Quat_qa").replace("Quat_q2", "Quat_q1").replace("Quat_qa", "Quat_q2")
    with refused("several-orientations"):
        read_motion(io.StringIO(mixed), rate=50)


def test_apdm():
    text = apdm()
    found = read_motion(io.StringIO(text), body="Upper")
    same(found, tolerance=1e-9)
    assert np.array_equal(found.time, T)
    assert "checked: agreement with the gyroscope 1.00 as it is" in found.notes
    with warned("reading-by-evidence"):
        same(read_motion(io.StringIO(text), body="Lower"), tolerance=1e-9)
    with warned("options-contradicted"):
        same(read_motion(io.StringIO(text), body="Lower", inverse=False), R.inv(), 1e-9)


@pytest.mark.parametrize("labels", [("Type", "Name", "ID"), ("", "", "")])
def test_motive_with_its_markers_and_lost_frames(labels):
    """Formats 1.23 and 1.21, which has no words before the types, names and identities."""
    body = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    marker = ["Position"] * 3 + ["Marker Quality"]
    types = ["Rigid Body"] * 8 + ["Rigid Body Marker"] * 4 + ["Marker"] * 3
    names = ["arm"] * 8 + ['"arm:Marker1"'] * 4 + ["arm:Marker1"] * 3
    lines = ["Format Version,1.23,Take Name,Take 1,Rotation Type,Quaternion,Coordinate Space,Global", ""]
    for label, cells in zip(labels, (types, names, ['"DF9A05"'] * 15), strict=True):
        lines.append(",".join(["", label, *cells]))
    lines += [",".join(["", "", *body, *marker, *["Position"] * 3]), "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,,X,Y,Z"]
    for k in range(N):
        row = [*R[k].as_quat(), 1, 2, 3, 1e-4, 1, 2, 3, 0.9]
        cells = [""] * 12 if k == 4 else [repr(float(x)) for x in row]
        lines.append(",".join([str(k), f"{T[k]:.6f}", *cells, "1", "2", "3"]))
    found = read_motion(io.StringIO("\n".join(lines)))
    assert not np.isfinite(found.values[4]).any()
    kept = np.delete(np.arange(N), 4)
    same(found[kept], R[kept])
    assert found.time.values == pytest.approx(T)


def written(path, *motion):
    path.write_text(mvnx(*motion), encoding="utf-8")
    return path


def test_mvnx_is_checked_by_its_angular_velocities(tmp_path):
    right = read_motion(written(tmp_path / "a.mvnx", R), body="LeftHand")
    same(right, tolerance=1e-8)
    assert "checked: agreement with the angular velocity 1.00 as it is" in right.notes
    with warned("reading-by-evidence"):
        same(read_motion(written(tmp_path / "b.mvnx", R.inv()), body="LeftHand"), tolerance=1e-8)
    same(read_motion(tmp_path / "b.mvnx", body="LeftHand", inverse=True), tolerance=1e-8)
    assert "checked" not in read_motion(tmp_path / "a.mvnx", body="Pelvis").notes  # it is at rest


def test_times_of_mvnx_are_those_of_its_indices(tmp_path):
    found = read_motion(written(tmp_path / "a.mvnx", R, 1 / 60), body="LeftHand")
    assert found.time.values == pytest.approx(np.arange(N) / 60, rel=1e-7)
    path = tmp_path / "b.mvnx"
    path.write_text((tmp_path / "a.mvnx").read_text(encoding="utf-8").replace('index="', 'index="7'), encoding="utf-8")
    assert read_motion(path, body="LeftHand").time.values[1] == 0.017


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_arrays_of_a_gyroscope_beside_attitudes_tell_as_well(suffix, tmp_path):
    import scipy.io

    def write(attitudes):
        arrays = {"attitude": attitudes.as_matrix(), "time": T, "gyr": GYR, "acc": ACC}
        path = tmp_path / f"a.{suffix}"
        if suffix == "npz":
            np.savez(path, **arrays)
        else:
            scipy.io.savemat(path, arrays)
        return path

    same(read_motion(write(R)))
    with warned("reading-by-evidence"):
        same(read_motion(write(R.inv())))


def rows(keep=slice(None), **changed):
    """A table of the motion; `changed` maps a row to its fields."""
    lines = [f"{t!r},{','.join(map(repr, q))}" for t, q in zip(T.tolist(), WXYZ.tolist(), strict=True)]
    lines = [changed.get(f"row{k}", line) for k, line in enumerate(lines)]
    return "time,qw,qx,qy,qz\n" + "\n".join(lines[keep]) + "\n"


@pytest.mark.parametrize("first", ["0.0,nan,,,", "2026-03-01T12:00:00,nan,,,", "0.0,,,,"])
def test_a_first_row_that_is_missing_is_no_header(first):
    text = rows(row0=first, row1=first)
    if first.startswith("2026"):
        text = text.replace("\n0.", "\n2026-03-01T12:00:00.").replace("\n1.", "\n2026-03-01T12:00:01.")
    found = read_motion(io.StringIO(text))
    assert len(found) == N
    assert not np.isfinite(found.values[:2]).any()
    same(found[2:], R[2:])


def test_why_no_samples_are_left_is_said():
    text = rows(slice(0, 3), row0="0,nan,0,0,0", row1="0.02,,,,", row2="0.04,0,0,0,0")
    with refused("too-few-samples", left=0, count=3) as told:
        twist(read_motion(io.StringIO(text)))
    assert told.value.fields["why"].startswith(": dropped 3 rows")


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".mat", ".c3d", ".bag"])
def test_a_table_with_the_suffix_of_another_format_is_told_its_own(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    path.write_text(rows(), encoding="utf-8")
    with refused("text-inside", suffix=suffix):
        read_motion(path)
    path.write_bytes(b"\x93NUMPY\x01\x00 cut short")
    with refused("unreadable"):
        read_motion(path)


def test_a_line_that_is_too_long_is_named():
    with refused("fields", place="line 9", count=5):
        read_motion(io.StringIO(rows(row7="0.14,1,0,0,0,7,8")))


def test_apps_of_phones_are_read_without_options():
    """Headers as the documentation of Sensor Logger and the experiment gyroscope.phyphox have them."""
    start = 1_718_030_736_872_695_300
    time = [f"{start + round(1e9 * t)},{t + 0.07:.10f}" for t in T]
    angles = R.as_euler("ZYX")
    orientation = io.StringIO(
        "time,seconds_elapsed,qz,qy,qx,qw,roll,pitch,yaw\n"
        + "\n".join(
            ",".join([t, *(f"{x:.17g}" for x in (*q[:0:-1], q[0], *a[::-1]))])
            for t, q, a in zip(time, WXYZ, angles, strict=True)
        )
    )
    found = read_motion(orientation)
    same(found)
    assert found.time.values == pytest.approx(T, abs=1e-9)
    assert found.attrs["start"] == pytest.approx(1e-9 * start, rel=1e-15)
    gyroscope = "time,seconds_elapsed,z,y,x\n" + "\n".join(
        ",".join([t, *(f"{x:.17g}" for x in g[::-1])]) for t, g in zip(time, GYR, strict=True)
    )
    rates = read_rates(io.StringIO(gyroscope), ["time", "x", "y", "z"], unit="rad/s")
    assert (rates.rates == GYR).all()
    raw_data = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)","Absolute (rad/s)"\n'
    raw_data += "\n".join(
        ",".join(f"{x:.16E}" for x in (t, *g, np.linalg.norm(g))) for t, g in zip(T, GYR, strict=True)
    )
    rates = read_rates(io.StringIO(raw_data))
    assert (rates.rates == GYR).all()
    assert (rates.time == T).all()
    for named in ("{}", "Attitude {}"):
        headers = ",".join(f'"{named.format(x)}"' for x in "wxyz")
        lines = [",".join(f"{x:.16E}" for x in (t, *q)) for t, q in zip(T, WXYZ, strict=True)]
        same(read_motion(io.StringIO("\n".join(['"Time (s)",' + headers, *lines]))))


def test_suffixes_that_are_not_known_are_told_what_is(tmp_path):
    for name, content, code in (
        ("a.xlsx", b"PK\x03\x04\x00", "unknown-format"),
        ("a.zip", b"PK\x03\x04\x00", "packed"),
        ("a.csv.gz", b"\x1f\x8b\x08", "packed"),
        ("a.json", b'{"time": 0}', "json"),
        ("a.sto", rows().encode(), "no-endheader"),
    ):
        (tmp_path / name).write_bytes(content)
        with refused(code):
            read_motion(tmp_path / name)


def test_no_words_of_a_library_are_in_errors_of_options(tmp_path):
    (tmp_path / "a.csv").write_text(rows(), encoding="utf-8")
    for option, word in (("--angle-unit", "grad"), ("--clocks", "foo"), ("--align", "foo")):
        result = CliRunner().invoke(app, ["twist", str(tmp_path / "a.csv"), option, word])
        assert result.exit_code == 2
        assert f"Error: Invalid value for '{option}': '{word}' is not one of '" in result.stderr
