"""The published digits."""

import csv
import json
import math
import re

import numpy as np
import pytest

from conftest import LOW_CONTRAST
from nontwist import open_run, reproduce
from nontwist.paper.tables import printed_tables

NOTES = {  # Q_II at t = 1 ... 5 when every step is solved to round-off
    1: [3.994928, 3.994875, 3.994787, 3.994663, 3.994503],
    2: [3.987879, 3.985380, 3.984407, 3.983256, 3.981796],
    3: [3.997970, 3.997409, 3.997323, 3.997286, 3.997256],
}


@pytest.fixture(scope="module")
def reproduction(tmp_path_factory):
    return reproduce(tmp_path_factory.mktemp("paper"))


@pytest.mark.parametrize("case", [1, 2, 3])
def test_every_printed_digit_of_the_invariants(reproduction, case):
    table = next(t for t in reproduction.tables if (t.case, t.name) == (case, "invariants"))
    assert len(table.rows) == 15
    printed = printed_tables()
    for row in table.rows:
        digits = f"{math.trunc(row.computed * 1e6) / 1e6:.6f}"
        expected = dict(zip(("Π1", "Π2"), printed[f"case{case}"]["material_momentum"], strict=True))
        expected["K"] = printed[f"case{case}"]["kinetic_energy"]
        assert digits == f"{expected[row.quantity]:.6f}"
        assert row.agrees


@pytest.mark.parametrize("case", [1, 2, 3])
def test_second_quotients(reproduction, case):
    table = next(t for t in reproduction.tables if (t.case, t.name) == (case, "second_quotient"))
    computed = np.array([row.computed for row in table.rows])
    assert computed == pytest.approx(np.array(printed_tables()[f"case{case}"]["second_quotient"]), abs=6e-5)
    assert computed == pytest.approx(np.array(NOTES[case]), abs=2e-6)
    assert [row.time for row in table.rows] == [1, 2, 3, 4, 5]


def test_all_tables_agree(reproduction):
    assert reproduction.agrees
    assert sum(len(table.rows) for table in reproduction.tables) == 60


def test_files(reproduction):
    figures = ["momenta", "energy", "second_quotient", "path"]
    for case in (1, 2, 3):
        folder = reproduction.folder / f"case{case}"
        expected = {"invariants.csv", "second_quotient.csv", "h.nc", "h2.nc", "h4.nc"}
        expected |= {f"{name}{end}" for name in figures for end in (".pdf", ".png", "_data.csv")}
        assert {path.name for path in folder.iterdir()} == expected
        run = open_run(folder / "h2.nc")
        assert run.attrs["step"] == 0.0025
        scheme = {"name": "energy-momentum", "order": 2, "dissipation": 0.0, "moments": "paper"}
        assert json.loads(run.attrs["integrator"]) == scheme
        data = np.genfromtxt(folder / "path_data.csv", delimiter=",", names=True)
        h = open_run(folder / "h.nc")
        assert np.array_equal(data["d3_y"], h.directors.sel(director=3, axis="y"))
        with (folder / "invariants.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        assert rows[0].keys() == {"time", "quantity", "unit", "printed", "computed", "difference", "agrees"}
        assert float(rows[2]["computed"]) == pytest.approx(
            float(h.kinetic_energy.sel(time=1, method="nearest")), abs=1e-12
        )


def test_the_page_shows_every_table_and_figure_in_the_order_of_the_paper(reproduction, visit_still):
    document = reproduction.page.read_text(encoding="utf-8")
    titles = re.findall(r"<(?:figcaption|caption)>((?:Figure|Table) \d)\.", document)
    parts = [[f"Figure {3 * k + j}" for j in (1, 2, 3)] + [f"Table {2 * k + j}" for j in (1, 2)] for k in range(3)]
    assert titles == [title for part in parts for title in part]
    assert document.count("data:image/png;base64,") == 12
    assert "60 of 60 printed numbers agree." in document
    cells = re.findall(r"<td>([^<]*)</td>", document)
    for table in reproduction.tables:
        for row in table.rows:
            k = cells.index(f"{row.computed:.9f}".replace("-", "−"))
            assert cells[k - 1] == f"{row.printed:.6f}".replace("-", "−")
    for link in re.findall(r'href="([^"]*)"', document):
        assert link == "data:," or (reproduction.folder / link).is_file()
    for scheme in ("light", "dark"):
        for width in (1280, 390):
            page = visit_still(document, viewport={"width": width, "height": 800}, color_scheme=scheme)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert page.evaluate(LOW_CONTRAST) == []
            assert page.evaluate("[...document.images].filter((i) => !i.naturalWidth || !i.alt).length") == 0


def test_printed_loads_miss_the_tables_by_twenty(tmp_path):
    """In a quick reproduction of one case."""
    result = reproduce(tmp_path, [2], quick=True, printed_loads=True)
    assert not result.agrees
    row = next(row for row in result.tables[0].rows if row.quantity == "Π1")
    assert 15 < row.computed / row.printed < 20.1
    files = {"invariants.csv", "second_quotient.csv", "momenta.pdf", "momenta.png", "momenta_data.csv"}
    assert {path.name for path in (tmp_path / "case2").iterdir()} == files
    document = result.page.read_text(encoding="utf-8")
    assert re.findall(r"(?:Figure|Table) \d", document) == ["Figure 4", "Table 3", "Table 4"]
    assert "Drawn was momenta alone: a quick reproduction." in document
    assert "Loads of cases 2 and 3 are as printed." in document
    assert '<td class="bad">differs</td>' in document
    with pytest.raises(FileExistsError, match=r"index\.html"):
        reproduce(tmp_path, [3], quick=True)


def test_a_case_that_the_paper_does_not_have(tmp_path):
    with pytest.raises(ValueError, match=re.escape("the paper has the cases 1, 2, 3; got 4")):
        reproduce(tmp_path, [4])
