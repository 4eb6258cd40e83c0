"""The published digits."""

import csv
import json
import math
import re
from unittest.mock import patch

import numpy as np
import pytest
from matplotlib.figure import Figure

from conftest import LOW_CONTRAST, ended
from nontwist import open_run, reproduce
from nontwist.paper.tables import printed_tables

NOTES = {  # Q_II at t = 1 ... 5 when every step is solved to round-off
    1: [3.994928, 3.994875, 3.994787, 3.994663, 3.994503],
    2: [3.987879, 3.985380, 3.984407, 3.983256, 3.981796],
    3: [3.997970, 3.997409, 3.997323, 3.997286, 3.997256],
}


@pytest.fixture(scope="module")
def reproductions(tmp_path_factory):
    """The first case with all figures, and the others with one each; files for print are empty."""
    whole, quick = (tmp_path_factory.mktemp(name) for name in ("whole", "quick"))
    with drawing("png"):
        return reproduce(whole, [1]), reproduce(quick, [2, 3], quick=True)


def drawing(*formats):
    """Let figures be drawn in these formats alone; test_plot looks at files of others."""

    def savefig(figure, place, format, **how):
        if format in formats:
            assert all(ax.has_data() for ax in figure.axes)
            sound(figure, place, format=format, **how)

    sound = Figure.savefig
    return patch.object(Figure, "savefig", savefig)


def test_printed_digits(reproductions):
    whole, quick = reproductions
    tables = {(table.case, table.name): table.rows for table in (*whole.tables, *quick.tables)}
    assert whole.agrees
    assert quick.agrees
    for case, printed in ((case, printed_tables()[f"case{case}"]) for case in (1, 2, 3)):
        expected = dict(zip(("Π1", "Π2"), printed["material_momentum"], strict=True)) | {"K": printed["kinetic_energy"]}
        rows = tables.pop((case, "invariants"))
        assert len(rows) == 15
        for row in rows:
            assert f"{math.trunc(row.computed * 1e6) / 1e6:.6f}" == f"{expected[row.quantity]:.6f}"
            assert row.agrees
        rows = tables.pop((case, "second_quotient"))
        computed = np.array([row.computed for row in rows])
        assert computed == pytest.approx(np.array(printed["second_quotient"]), abs=6e-5)
        assert computed == pytest.approx(np.array(NOTES[case]), abs=2e-6)
        assert [row.time for row in rows] == [1, 2, 3, 4, 5]
    assert not tables


def test_files(reproductions):
    folders = [reproductions[0].folder / "case1", *(reproductions[1].folder / f"case{k}" for k in (2, 3))]
    for folder, names in zip(folders, (("energy", "second_quotient", "path"), (), ()), strict=True):
        expected = {f"{name}{end}" for name in (*names, "momenta") for end in (".pdf", ".png", "_data.csv")}
        expected |= {"invariants.csv", "second_quotient.csv"} | ({"h.nc", "h2.nc", "h4.nc"} if names else set())
        assert {path.name for path in folder.iterdir()} == expected
    h, h2 = (open_run(folders[0] / f"{name}.nc") for name in ("h", "h2"))
    assert h2.attrs["step"] == 0.0025
    scheme = {"name": "energy-momentum", "order": 2, "dissipation": 0.0, "moments": "paper"}
    assert json.loads(h2.attrs["integrator"]) == scheme
    tip, momentum = h.directors.sel(director=3, axis="y"), h.material_momentum.sel(director=2)
    columns = {"d3_y": tip, "material_momentum_2": momentum, "kinetic_energy": h.kinetic_energy}
    for name, (column, shown) in zip(("path", "momenta", "energy"), columns.items(), strict=True):
        data = np.genfromtxt(folders[0] / f"{name}_data.csv", delimiter=",", names=True)
        assert np.array_equal(data["time"], shown.time)
        assert np.array_equal(data[column], shown)
    with (folders[0] / "invariants.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert rows[0].keys() == {"time", "quantity", "unit", "printed", "computed", "difference", "agrees"}
    K = float(h.kinetic_energy.sel(time=1, method="nearest"))
    assert float(rows[2]["computed"]) == pytest.approx(K, abs=1e-12)
    assert float(rows[2]["difference"]) == pytest.approx(K - float(rows[2]["printed"]), abs=1e-12)


def test_tables_and_figures_of_page(reproductions, visit):
    orders = ("F1 F2 F3 T1 T2", "F4 T3 T4 F7 T5 T6")
    for result, order, pictures, count in zip(reproductions, orders, (4, 2), (20, 40), strict=True):
        document = result.page.read_text(encoding="utf-8")
        titles = re.findall(r"<(?:figcaption|caption)>(F|T)(?:igure|able) (\d)\.", document)
        assert " ".join(map("".join, titles)) == order
        drawn = ["momenta", "energy", "second_quotient", "path"] if pictures == 4 else 2 * ["momenta"]
        assert re.findall(r'href="case\d/(\w+)\.pdf"', document) == drawn
        assert document.count("data:image/png;base64,") == pictures
        assert f"{count} of {count} printed numbers agree." in document
        assert ("Drawn was momenta alone: a quick reproduction." in document) == (pictures == 2)
        cells = re.findall(r"<td>([^<]*)</td>", document)
        for row in (row for table in result.tables for row in table.rows):
            k = cells.index(f"{row.computed:.9f}".replace("-", "−"))
            assert cells[k - 1] == f"{row.printed:.6f}".replace("-", "−")
        for link in re.findall(r'href="([^"]*)"', document):
            assert link == "data:," or (result.folder / link).is_file()
    page = visit(reproductions[0].page.read_text(encoding="utf-8"), moves=False)
    for scheme, width in (("light", 1280), ("dark", 390)):
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(LOW_CONTRAST) == []
    assert page.evaluate("[...document.images].filter((i) => !i.naturalWidth || !i.alt).length") == 0


@drawing()
def test_printed_loads_miss_the_tables(tmp_path):
    """In a quick reproduction of one case, by the command, whose exit status is then 1."""
    result = ended(1, "reproduce", "--case", "2", "--quick", "--printed-loads", "--out", tmp_path)
    assert "DIFFERS" in result.stdout
    assert "20 times smaller" in result.stdout
    with (tmp_path / "case2" / "invariants.csv").open(encoding="utf-8") as file:
        row = next(row for row in csv.DictReader(file) if row["quantity"] == "Π1")
    assert 15 < float(row["computed"]) / float(row["printed"]) < 20.1
    document = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Loads of cases 2 and 3 are as printed." in document
    assert '<td class="bad">differs</td>' in document
    with pytest.raises(FileExistsError, match=r"index\.html"):
        reproduce(tmp_path, [3], quick=True)
    with pytest.raises(ValueError, match=re.escape("the paper has the cases 1, 2, 3; got 4")):
        reproduce(tmp_path, [4])
