"""What is read of recordings with known truth: the truth, and what 0.2.0 read of them, bit for bit."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from .makers import GYR, SPACE, Q, T, moved
from .rows import (
    MOTIONS,
    RATES,
    RECORDED,
    SPEED,
    TABLES,
    digest,
    machine,
    motion_of,
    rates_of,
    table_of,
    told,
    told_of_rates,
)  # fmt: skip

BEFORE = json.loads(RECORDED.read_text(encoding="utf-8"))
LIBRARIES = {".c3d": "ezc3d", ".bag": "rosbags", "": "rosbags", ".tm": "spiceypy"}
SAME_MACHINE = machine() == BEFORE["machine"]
# Not in 0.2.0, which took two recordings of one day for such as begin together.
SINCE = {"time time of day": {"start": 43200.5}, "time time of day, AM": {"start": 0.5}}


def needed(row):
    """Skip a row whose library is not there."""
    suffix = "." + row.file.rpartition(".")[2] if "." in row.file else ""
    if suffix in LIBRARIES:
        pytest.importorskip(LIBRARIES[suffix])
    return row


def same_times(found, expected, start):
    """Times are compared from the first on; those since 1970 are rounded to 0.24 µs."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert abs(found - found[0] - (expected - expected[0])).max() < (3e-7 if start else 1e-9)


@pytest.mark.parametrize("name", MOTIONS)
def test_motions(name, tmp_path):
    row = needed(MOTIONS[name])
    found = motion_of(row, tmp_path)
    values, said = found.values, {note.partition(": ")[0] for note in found.notes.split("; ")}
    assert {"orientation", "time"} <= said, found.notes
    assert {"direction", "checked", "inverted"} & said, found.notes
    if row.truth is not None:
        turned = Rotation.from_quat(values) if found.dims[-1] == "quat" else Rotation.from_matrix(values.swapaxes(1, 2))
        assert (turned.inv() * row.truth).magnitude().max() < row.within
    if row.truth is not None and row.times is None:
        assert "time" not in found.coords
    elif row.times is not None:
        same_times(found.time.values, row.times, found.attrs.get("start"))
    if row.exact or SAME_MACHINE:
        assert told(found) == BEFORE["motions"][name] | SINCE.get(name, {})


@pytest.mark.parametrize("name", RATES)
def test_rates(name, tmp_path):
    row = needed(RATES[name])
    found = rates_of(row, tmp_path)
    if row.truth is not None:
        assert abs(found.rates - row.truth).max() < row.within
        same_times(found.time, row.times, start=True)
    if found.speed is not None:
        assert abs(found.speed - SPEED).max() < 2e-10
    assert not any(note.startswith("time: none") for note in found.notes)
    if row.exact or SAME_MACHINE:
        assert told_of_rates(found) == BEFORE["rates"][name]


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_loads(name):
    assert digest(table_of(name)) == BEFORE["tables"][name]


def test_the_record_is_of_these():
    assert {kind: set(BEFORE[kind]) for kind in ("motions", "rates", "tables")} == {
        "motions": set(MOTIONS), "rates": set(RATES), "tables": set(TABLES),
    }  # fmt: skip


def test_the_rates_are_those_of_the_motion():
    """The closed form against differences of the attitudes."""
    e = 1e-5
    differences = (moved(T - e).inv() * moved(T + e)).as_rotvec() / (2 * e)
    assert abs(GYR - differences).max() < 1e-8
    assert abs(Rotation.from_quat(Q).apply(differences) - SPACE).max() < 1e-8
