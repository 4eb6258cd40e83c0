"""What `nontwist twist` accepts and prints, besides the numbers themselves."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import ended
from nontwist import open_run, save_run, simulate, standard, twist
from nontwist.geometry.values import error_place, error_text, number_text, text_to_place
from recordings.test_two_sensors import recordings, written
from refusals import said

T = np.arange(200) / 100


def command(tmp_path, *arguments):
    return ended(0, "twist", *arguments, "--no-figure", "--force", "--out", tmp_path / "o")


def rows(result):
    """The rows of a summary, by their labels; lines of one row are joined by ``|``."""
    found, label = {}, ""
    for line in result.stdout.splitlines():
        if line.startswith("│"):
            first, second = (cell.strip() for cell in line.strip("│").split("│"))
            label = first or label
            found[label] = f"{found[label]}|{second}" if label in found else second
    return found


def tilted(size, spin):
    """An axis that moves by next to nothing beside z, and a turn about it."""
    xy = size * np.random.default_rng(0).standard_normal((T.size, 2))
    return Rotation.from_quat(np.concatenate([xy, spin * T[:, None], np.ones((T.size, 1))], axis=1))


def test_exported_run_is_read(tmp_path):
    how = {"rotation": Rotation.from_rotvec([1.5, 0, 0]), "material_angular_velocity": (0.2, 0.1, 3)}
    run = simulate(standard([1, 2, 2.5]), t_end=2, step=0.01, **how)
    save_run(run, tmp_path / "run.nc")
    ended(0, "export", tmp_path / "run.nc", "--out", tmp_path / "run.csv")
    found = command(tmp_path, tmp_path / "run.csv")
    assert "warning" not in found.stderr
    assert open_run(tmp_path / "o.nc").twist_angle[-1] == pytest.approx(float(twist(run).twist_angle[-1]), abs=1e-4)


def test_round_off_prints_0(tmp_path):
    options = [written(tmp_path / "a.csv", tilted(1e-80, 1e-15), T), "--degrees"]
    shown = rows(command(tmp_path, *options))
    assert re.fullmatch(r"0° \(0 turns; sampling ± .*, noise ± 0°\)", shown["total twist"])
    for name in ("swing-twist angle", "path length of the axis", "largest turn between samples"):
        assert shown[name] == "0°"
    assert shown["range of the twist angle"] == "0° to 0°"
    assert shown["solid angle of the path"] == "0 sr (0°)"
    assert shown["largest twist rate"] == "0°/s"
    facts = json.loads(command(tmp_path, *options, "--json").stdout)
    assert 0 < max(facts["path_length"], facts["noise_estimate"]) < 1e-70
    assert min(facts["path_length"], facts["noise_estimate"]) > 0
    assert 0 < facts["largest_turn_between_samples"] < 1e-14


def test_small_values_are_printed(tmp_path):
    shown = rows(command(tmp_path, written(tmp_path / "a.csv", tilted(0.0, 1e-12), T)))
    assert shown["total twist"].startswith("3.98e-12 rad (6.334e-13 turns; ")
    assert shown["swing-twist angle"] == "3.98e-12 rad"
    assert shown["largest twist rate"].startswith("2e-12 rad/s at t = ")
    assert shown["largest turn between samples"] == "2e-14 rad"
    every = f"every {T[1] - T[0]:.4g} s (at most {np.diff(T).max():.4g} s)"
    assert shown["samples"] == f"{T.size}, {T[-1] - T[0]:.6g} s, {every}"
    noise = "of noise, independent from sample to sample, one standard deviation"
    assert shown["±"].replace("|", " ") == f"{noise}; of sampling, an estimate of the error"


def test_printed_digits_of_rates(tmp_path):
    """One digit of the noise, the rate to the same place, both without exponents.

    Central differences of angles with white noise σ at intervals h have σ/(√2 h): the scatter of the rates.
    """
    noise, found = Rotation.from_rotvec(5e-3 * np.random.default_rng(2).standard_normal((T.size, 3))), []
    swing = Rotation.from_rotvec(np.stack([np.sin(T), np.zeros_like(T), 0.3 * T], axis=1))
    for motion in (swing, swing * noise):
        result = command(tmp_path, written(tmp_path / "a.csv", motion, T), "--degrees")
        found.append(open_run(tmp_path / "o.nc").load())
    smooth, rates = (np.degrees(one.twist_rate.values) for one in found)
    level, shown = np.degrees(found[1].attrs["noise_level"] / (np.sqrt(2) * 0.01)), rows(result)
    assert level == pytest.approx(np.degrees(5e-3 / (np.sqrt(2) * 0.01)), rel=0.45)
    assert np.std((rates - smooth)[5:-5]) == pytest.approx(level, rel=0.45)
    assert 10 < level < 95  # an exponent would be printed
    k = abs(rates).argmax()
    largest = f"{round(rates[k], -1):.0f}°/s at t = {found[1].time.values[k]:g} s"
    assert shown["largest twist rate"] == f"{largest}; noise of each rate ± {round(level, -1):.0f}°/s"
    of_noise, of_sampling = shown["±"].split("; ")
    assert of_noise == "of noise, independent from sample to sample, one standard deviation"
    assert of_sampling == "of sampling, an estimate of the error"
    assert not re.search(r"\de[+-]\d", re.sub("sampling ± [^,]*", "", result.stdout))


PLAINLY = [
    (19.7, ".1g", "20"), (-12345.6, ".4g", "-12350"), (99999.0, ".1g", "100000"), (1.26e-3, ".1e", "0.0013"),
    (0.3e-3, ".1e", "3.0e-04"), (163456.0, ".1g", "2e+05"), (0.0, ".1e", "0.0e+00"), (2.5, ".6g", "2.5"),
    (float("nan"), ".1g", "nan"),
]  # fmt: skip
ERRORS = [  # 2.4 as 2 would be 17 % too small
    (14.87, "15"), (1.4142, "1.4"), (2.4, "3"), (2.05, "2"), (0.00961, "0.01"), (0.0196, "0.02"), (0.44, "0.5"),
    (166.6, "170"), (3.4e-10, "4e-10"), (0.0, "0"),
]  # fmt: skip
ROUNDED = [
    (166.63, 1.41, "166.6"), (166.0, 1.41, "166.0"), (128.4, 15.0, "128"), (128.4, 23.0, "130"), (-3.0, 23.0, "0"),
    (2.3456e-8, 1.2e-10, "2.346e-08"), (4e6, 1e5, "4e+06"),
]  # fmt: skip


def test_printed_numbers_are_plain():
    """An uncertainty is not understated."""
    assert [number_text(number, spec) for number, spec, _ in PLAINLY] == [text for *_, text in PLAINLY]
    assert [error_text(error) for error, _ in ERRORS] == [text for _, text in ERRORS]
    assert [text_to_place(x, error_place(error)) for x, error, _ in ROUNDED] == [text for *_, text in ROUNDED]


def turning(t):
    """A swing on two axes with a turn of 0.3 rad/s."""
    return Rotation.from_euler("ZYX", np.stack([0.8 * np.sin(t), 0.5 * np.sin(2 * t), 0.3 * t], axis=1))


def test_gap_behind_the_error(tmp_path):
    t = np.arange(2000) / 100
    gap = t[(t < 8) | (t > 9.9)]
    shown = rows(command(tmp_path, written(tmp_path / "a.csv", turning(gap), gap), "--degrees"))
    found = np.degrees(open_run(tmp_path / "o.nc").error_estimate.values)
    assert np.diff(found).max() > 0.99 * found[-1]
    told = re.search(r"sampling ± (\S+)°, nearly all of it from the gap at 7\.99 s, noise", shown["total twist"])
    assert float(told[1]) >= 0.95 * found[-1]
    assert "gap" not in rows(command(tmp_path, written(tmp_path / "b.csv", turning(t), t)))["total twist"]


def test_twist_identity_in_degrees(tmp_path):
    """τ - ψ = Ω modulo 360°, and the modulus is named where it matters alone."""
    for k, turns in enumerate((0.2, 3.0)):
        t = np.arange(1000) / 100
        spin = Rotation.from_rotvec(np.outer(turns * t, [0, 0, 1]))
        path = Rotation.from_rotvec(np.stack([0.4 * np.sin(t), 0.3 * np.cos(t), 0 * t], axis=1))
        shown = rows(command(tmp_path, written(tmp_path / f"{k}.csv", path * spin, t), "--degrees"))
        sr, area = re.fullmatch(r"(\S+) sr \((\S+)°\)", shown["solid angle of the path"]).groups()
        assert np.degrees(float(sr)) == pytest.approx(float(area), rel=1e-3)
        tau = re.fullmatch(r"(\S+)°" + r" \(modulo 360°\)" * (turns > 1), shown["swing-twist angle"])[1]
        psi = shown["total twist"].split("°")[0]
        off = float(tau) - float(psi) - float(area)
        assert off - 360 * round(off / 360) == pytest.approx(0, abs=0.02)
        assert (round(off / 360) != 0) == (turns > 1)


def test_common_direction_is_printed_once(tmp_path):
    one, two = written(tmp_path / "a.csv", turning(T), T), written(tmp_path / "b.csv", turning(T).inv(), T)
    result = command(tmp_path, one, "--relative-to", two, "--clocks", "shared")
    shown, told = rows(result), "direction: taken as sensor to earth, which nothing in the file confirms"
    assert shown["both sensors"].startswith(told)
    said(shown["read as"])
    assert shown["relative to"] == f"{two}: {shown['read as']}"
    assert result.stdout.count("direction: ") == 1
    own = rows(command(tmp_path, one, "--relative-to", two, "--clocks", "shared", "--relative-options", "--inverse"))
    assert told in own["read as"]
    assert "both sensors" not in own


def test_twist_below_its_error(tmp_path):
    """The axis goes along a path with noise, and back along the same, where the body is turned by 1e-7 rad."""
    noise = Rotation.from_rotvec(1e-3 * np.random.default_rng(0).standard_normal((100, 3)))
    there = noise * Rotation.from_rotvec(np.outer(np.linspace(0, 1, 100), [1, 0, 0]))
    back = there[::-1] * Rotation.from_rotvec([0, 0, 1e-7])
    order = written(tmp_path / "a.csv", Rotation.concatenate([there, back]), T), "--order", "2"
    result = json.loads(command(tmp_path, *order, "--json").stdout)
    assert result["twist_angle"] == pytest.approx(1e-7, rel=1e-6)
    assert result["noise_estimate"] > 1e-4
    assert rows(command(tmp_path, *order))["total twist"].startswith("0 rad (0 turns; sampling ± ")


def test_alignment_errors_are_left_out(tmp_path):
    t, fore, s, arm, _ = recordings(20, (100, 61.7), late=10.0)
    one, two = written(tmp_path / "a.csv", fore, t), written(tmp_path / "b.csv", arm, s)
    shown = rows(command(tmp_path, one, "--relative-to", two, "--align", "static", "--clocks", "shift"))["alignment"]
    assert shown.startswith("clock of the second recording: shifted by ")
    assert shown.endswith("|the errors of the total twist do not include those of the alignment")
    drifting = rows(command(tmp_path, one, "--relative-to", two, "--clocks", "drift"))
    said(drifting["±"])
    assert "alignment" not in rows(command(tmp_path, one))
    plain = json.loads(command(tmp_path, one, "--relative-to", two, "--json").stdout)
    assert "errors" not in plain["alignment"]


def test_twist_result_is_shown(tmp_path):
    file = written(tmp_path / "a.csv", tilted(0.1, 1.0), T)
    np.savetxt(tmp_path / "b.csv", tilted(0.1, 1.0).as_quat(), delimiter=",", header="qx,qy,qz,qw", comments="")
    for other in ([file, "--axis-frame", "space"], [tmp_path / "b.csv"]):  # which no page shows
        assert "nontwist view" not in command(tmp_path, *other).stderr
        ended(3, "view", tmp_path / "o.nc")
    assert f"next: nontwist view {tmp_path / 'o.nc'}" in command(tmp_path, file, "--axis=-Y").stderr
    assert open_run(tmp_path / "o.nc").attrs["axis"] == pytest.approx([0, -1, 0])
    said(ended(3, "twist", tmp_path / "o.nc", "--out", tmp_path / "p").stderr)
    ended(0, "info", tmp_path / "o.nc")
    ended(0, "view", tmp_path / "o.nc", "--no-open", "--out", tmp_path / "o.html")


def test_recording_is_not_overwritten(tmp_path):
    """Not by --force either."""
    file = written(tmp_path / "a.csv", tilted(0.0, 0.1), T)
    before = Path(file).read_bytes()
    done = ended(2, "twist", file, "--csv", "--force", "--out", tmp_path / "a")
    assert f"{file} is the recording itself; choose another name" in done.stderr
    assert Path(file).read_bytes() == before
