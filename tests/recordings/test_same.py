"""What 0.2.0 read of recordings, bit for bit: those of `test_truth`, which compares them, and tables of loads.

`PYTHONPATH=src:tests python -m recordings.test_same --record` writes what the package reads of all of them to
data/recordings_0.2.0.json.
"""

import json
import sys
import tempfile
from functools import partial

import numpy as np
import pytest

from nontwist.runfile.files import columns_of

from . import test_truth as of
from .makers import GYR, N, T, text, vector

pytestmark = pytest.mark.usefixtures("libraries_read_here")

MOMENT = {"time": T, **vector("M{}", GYR)}
QUOTED = {'"time"': T, '"h"': [f"{x / 3:.17g}" for x in np.round(of.SPEED, 9)]}
TABLES = {
    "moments": (text(MOMENT), None, 4),
    "units": (text({"t (s)": T, **vector("M{} [N m]", GYR)}), None, 4),
    "semicolons": (text(MOMENT, sep=";"), None, 4),
    "decimal commas": (text(MOMENT, sep=";", decimal=","), None, 4),
    "tabs, decimal commas": (text(MOMENT, sep="\t", decimal=","), None, 4),
    "chosen": (text({"note": range(N), **MOMENT}), [*MOMENT], 4),
    "another order": (text(MOMENT), ["time", "Mz", "My", "Mx"], 4),
    "a rotor": (text({"time": T, "h (N m s)": of.SPEED}), None, 2),
    "times": (text({"time": T}), None, 1),
    "one of many": (text(MOMENT), ["Mx"], 1),
    "a mark, quotes and 17 digits": ("\ufeff" + text(QUOTED), None, 2),
}


def table_of(name):
    content, chosen, count = TABLES[name]
    return np.array(columns_of(content.encode(), chosen, count))


def record():
    """Return what the package reads of everything."""
    with tempfile.TemporaryDirectory() as folder:
        place = partial(tempfile.mkdtemp, dir=folder)
        return {
            "machine": of.machine(),
            "motions": {name: of.told(of.motion_of(row, place())[0]) for name, row in of.MOTIONS.items()},
            "rates": {name: of.told_of_rates(of.rates_of(row, place())) for name, row in of.RATES.items()},
            "tables": {name: of.digest(table_of(name)) for name in TABLES},
        }


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_loads(name):
    assert of.digest(table_of(name)) == of.BEFORE["tables"][name]


def test_the_record_is_of_these():
    assert {kind: set(of.BEFORE[kind]) for kind in ("motions", "rates", "tables")} == {
        "motions": set(of.MOTIONS), "rates": set(of.RATES), "tables": set(TABLES),
    }  # fmt: skip


if __name__ == "__main__":
    if sys.argv[1:] != ["--record"]:
        raise SystemExit("python -m recordings.test_same --record")
    of.RECORDED.write_text(json.dumps(record(), indent=1) + "\n", encoding="utf-8")
