"""`reproduction/index.html`: tables and figures in the order of the paper, what it prints beside what was computed.

One file that holds all pictures and uses no network. In the dark the pictures are inverted, and turned back
in hue, so that colours stay what they are.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Collection, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

from .tables import CASES, INERTIA, MISPRINT, QUOTIENT_TOLERANCE, STEP, T_END, Table, printed

SUFFIX = {1: "ic", 2: "ml", 3: "c"}  # of the paper's labels
FIGURES = {  # its figures by their labels, each of one or two pictures, with captions of ours
    "angular-momentum": {"momenta": "Angular momentum over time: a along fixed axes, b along the directors."},
    "energy-precision": {
        "energy": "Kinetic energy over time.",
        "second_quotient": "Second quotient of precision over time; the line is its limit 4.",
    },
    "trajectory": {"path": "Path of the third director; wide and grey the great circle after the load."},
}
DRAWN = {name for pictures in FIGURES.values() for name in pictures}
TABLES = {"sqp": "second_quotient", "invariants": "invariants"}
HEADS = ("t (s)", "quantity", "printed", "computed", "difference", "")
CAPTIONS = {
    "second_quotient": f"Second quotient of precision; agrees within {QUOTIENT_TOLERANCE:g}",
    "invariants": "Motion invariants; printed digits are truncated",
}


def page(tables: Sequence[Table], folder: Path, *, figures: Collection[str], printed_loads: bool) -> str:
    """Return the document for the tables of the cases, and for their figures, which lie in the folders of the cases."""
    rows = [row for table in tables for row in table.rows]
    agreeing = sum(row.agrees for row in rows)
    document = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    return Template(document).substitute(
        inertia="[" + ", ".join("[" + ", ".join(_number(f"{x:.4g}") for x in row) + "]" for row in INERTIA) + "]",
        t_end=f"{T_END:g}",
        step=f"{STEP:g}",
        loads="Loads of cases 2 and 3 are as printed."
        if printed_loads
        else f"Loads of cases 2 and 3 are those printed over {MISPRINT:g}, which give the printed tables.",
        agreeing=agreeing,
        all=len(rows),
        **{"class": "good" if agreeing == len(rows) else "bad"},
        missing="" if {*figures} >= DRAWN else f"Drawn was {', '.join(figures)} alone: a quick reproduction.",
        cases="\n".join(_case(number, tables, figures, folder) for number in sorted({table.case for table in tables})),
    )


def _case(number: int, tables: Sequence[Table], figures: Collection[str], folder: Path) -> str:
    case, end = CASES[number], SUFFIX[number]
    velocity = _number(", ".join(f"{x:g}" for x in case.angular_velocity))
    parts = [f"<h2>Case {number}: {case.title}</h2>\n<p>Initial material angular velocity ({velocity}) rad/s.</p>"]
    for label, pictures in FIGURES.items():
        there = {name: words for name, words in pictures.items() if name in figures}
        if there:
            parts.append(_figure(number, printed(f"fig-{label}-{end}"), there, folder))
    for label, name in TABLES.items():
        (table,) = (one for one in tables if (one.case, one.name) == (number, name))
        parts.append(_table(printed(f"tab-{label}_{end}"), table))
    return "\n".join(parts)


def _figure(number: int, title: str, pictures: dict[str, str], folder: Path) -> str:
    images, links = [], []
    for name, words in pictures.items():
        place = f"case{number}/{name}"
        data = base64.b64encode((folder / f"{place}.png").read_bytes()).decode("ascii")
        width = 820 if name == "momenta" else 400
        images.append(
            f'<img src="data:image/png;base64,{data}" width="{width}" alt="Case {number}: {html.escape(words)}">'
        )
        links += [f'<a href="{place}.pdf">{name}.pdf</a>', f'<a href="{place}_data.csv">{name}_data.csv</a>']
    caption = f"{title}. {' '.join(pictures.values())} {', '.join(links)}"
    return f"<figure><div>{''.join(images)}</div><figcaption>{caption}</figcaption></figure>"


def _table(title: str, table: Table) -> str:
    heads = "".join(f'<th scope="col">{head}</th>' for head in HEADS)
    lines = []
    for row in table.rows:
        name = row.quantity if row.unit == "1" else f"{row.quantity} ({row.unit.replace('m2', 'm²')})"
        verdict = '<td class="good">agrees</td>' if row.agrees else '<td class="bad">differs</td>'
        numbers = (f"{row.printed:.6f}", f"{row.computed:.9f}", f"{row.difference:.1e}")
        cells = "".join(f"<td>{cell}</td>" for cell in (f"{row.time:g}", name, *map(_number, numbers)))
        lines.append(f"<tr>{cells}{verdict}</tr>")
    link = f'<a href="case{table.case}/{table.name}.csv">{table.name}.csv</a>'
    caption = f"<caption>{title}. {CAPTIONS[table.name]}. {link}</caption>"
    body = "\n".join(lines)
    return f'<div class="scroll"><table>{caption}<thead><tr>{heads}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def _number(text: str) -> str:
    return text.replace("-", "−")
