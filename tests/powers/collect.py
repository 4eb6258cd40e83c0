"""The table of powers: all that the package can do, by name, with a call of each and its result.

``PYTHONPATH=src:tests python -m powers.collect`` makes the calls that `table.json` gives, and writes their results.
Its rows are the names of 0.2.0; `now` and `why` are written by hand.
"""

import ast
import hashlib
import inspect
import json
import os
import re
import shlex
import shutil
import sys
import tempfile
import warnings
from collections.abc import Mapping
from enum import Enum
from functools import cache, cached_property
from pathlib import Path

import matplotlib
import numpy as np
import pandas
import typer.main
import xarray
from numpydoc.docscrape import NumpyDocString
from PIL import Image
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import nontwist
from nontwist.analysis.statistics import STATISTICS
from nontwist.cli import app
from nontwist.integrators import Integrator
from nontwist.recordings.formats import READERS
from nontwist.runfile.document import json_schema
from public.test_docstrings import NOT_CALLED, PUBLIC
from public.test_fuzz_public import FUNCTIONS, MADE_BY_THE_PACKAGE, leaves

HERE = Path(__file__).parent
TABLE, THINGS = HERE / "table.json", json.loads((HERE / "things.json").read_text(encoding="utf-8"))
SPACE = {name: getattr(nontwist, name) for name in nontwist.__all__}
SPACE |= {"np": np, "Rotation": Rotation, "Path": Path, "hashlib": hashlib}
DATASETS = ("SWUNG", "ENSEMBLE", "SWEPT", "TWIST", "JOINED", "SENSED", "COMPARED", "THROW")


# names


OPERATORS = ("__call__", "__add__", "__mul__", "__rmul__")


def members(name, thing):
    """The members of a class that its users know: its methods, properties and attributes with a description."""
    told = [
        one.strip() for entry in NumpyDocString(inspect.getdoc(thing))["Attributes"] for one in entry.name.split(",")
    ]
    own = [one for one in vars(thing) if not one.startswith("_")]
    if issubclass(thing, Enum):
        told += own
    elif not issubclass(thing, Integrator):
        told += [one for one in own if isinstance(vars(thing)[one], (property, cached_property))]
    told += [one for one in getattr(thing, "_fields", ()) if not one.startswith("_")]
    return {
        *told,
        *(key.rsplit(".", 1)[1] for key in FUNCTIONS if key.startswith(f"{name}.")),
        *(one for one in OPERATORS if one in vars(thing)),
    }


def keys(schema, form, path=""):
    """The keys of run files: ``body.kind``, and ``load[sine].phase`` where the form has a kind."""
    for one in (form, *form.get("anyOf", ()), *form.get("oneOf", ())):
        one = schema["$defs"][one["$ref"].rsplit("/", 1)[1]] if "$ref" in one else one
        if one is not form and ("anyOf" in one or "oneOf" in one):
            yield from keys(schema, one, path)
        kind = one.get("properties", {}).get("kind", {}).get("const")
        base = f"{path}[{kind}]" if kind else path
        for key, inner in one.get("properties", {}).items():
            yield f"{base}.{key}".lstrip(".")
            yield from keys(schema, inner, f"{base}.{key}".lstrip("."))
        if "items" in one:
            yield from keys(schema, one["items"], path)


def names():
    """All powers, as (kind, name)."""
    found = {("name", name) for name in (*nontwist.__all__, "integrators.INTEGRATORS")}
    for name, thing in PUBLIC.items():
        found.add(("plot" if name.startswith("plot.") else "name", name))
        called = {name: thing}
        if inspect.isclass(thing):
            own = {f"{name}.{one}": getattr(thing, one, None) for one in members(name, thing)}
            found |= {("member", one) for one in own}
            made = issubclass(thing, (*NOT_CALLED, *MADE_BY_THE_PACKAGE))
            called = {} if made else called
            called |= {one: call for one, call in own.items() if inspect.isfunction(call) or inspect.ismethod(call)}
        for one, function in called.items():
            given = [key for key in inspect.signature(function).parameters if key != "self"]
            found |= {("keyword", f"{one}({key})") for key in given}
    command = typer.main.get_command(app)
    for name, one in {"": command, **command.commands}.items():
        found |= {("command", name)} if name else set()
        for option in one.params:
            said = [*option.opts, *option.secondary_opts] if option.param_type_name == "option" else [option.name]
            found |= {("option", f"{name} {word}".strip()) for word in said}
    found |= {("key", key) for key in keys(json_schema(), json_schema())}
    for name in DATASETS:
        found |= {("variable", f"{name}.{one}") for one in prepared(name).variables}
        found |= {("attribute", f"{name}.{one}") for one in prepared(name).attrs}
    found |= {("reader", suffix) for suffix in READERS}
    return found | {("reduce", f"{many} {one}") for one in STATISTICS for many in ("ensemble", "sweep")}


# results


def told(value):
    """A result in short: what it is, how many numbers it has, their norm, and a sum that knows order and signs."""
    what = type(value).__name__
    if isinstance(value, (bool, type(None), Enum)) or (isinstance(value, str) and len(value) < 20):
        return f"{what} {value!r}" if isinstance(value, str) else str(value)
    if isinstance(value, (list, tuple)) and value and all(isinstance(one, str) for one in value):
        return f"{what} {' '.join(value)}"
    if isinstance(value, str):
        words = re.sub(r"-?\d+\.?\d*(?:e[+-]?\d+)?", "#", value)
        page = value.lstrip().startswith("<")
        what = "page" if page else f"text {hashlib.sha256(words.encode()).hexdigest()[:12]}"
        value = "" if page else value
    elif isinstance(value, (np.ndarray, xarray.DataArray)):
        what += f" {value.dtype.kind} {'x'.join(map(str, value.shape))}"
        if value.dtype.kind in "OU":
            return f"{what} {','.join(map(str, np.ravel(value)))[:60]}"
    elif isinstance(value, (Mapping, pandas.DataFrame, list, tuple)):
        what += f" of {len(value)}"
    x = np.concatenate([np.zeros(0), *(array.ravel() for array in leaves(value))])
    norm, holes = np.linalg.norm(np.nan_to_num(x, posinf=0, neginf=0)), int((~np.isfinite(x)).sum())
    if x.size == 0:
        return what
    short = f"{what}, {x.size} numbers" + f" {holes} not finite" * (holes > 0)
    if norm < 1e-11:
        return f"{short} |0|"
    signs = float(np.cos(np.arange(x.size)) @ np.nan_to_num(x, posinf=0, neginf=0) / norm)
    return f"{short} |{norm:.11g}| {signs:+.8f}"


def alike(old, new, accuracy=1e-9):
    """Whether two results are the same: numbers to this accuracy, of errors their class alone."""
    failed = re.compile(r"(\w+Error|\w+Interrupt|exit [1-9]\d*)\b")
    if (one := failed.match(old)) or failed.match(new):
        other = failed.match(new)
        return bool(one and other and one[1] == other[1])
    number = re.compile(r"[|]([-+\d.e]+)[|]( [-+]\d\.\d{8})?")
    if number.sub("#", old) != number.sub("#", new):
        return False
    pairs = list(zip(number.findall(old), number.findall(new), strict=True))
    sizes = all(np.isclose(float(a), float(b), rtol=accuracy, atol=1e-11) for (a, _), (b, _) in pairs)
    return sizes and all(abs(float(a or 0) - float(b or 0)) < 100 * accuracy for (_, a), (_, b) in pairs)


FILES = {
    ".nc": lambda path: told(xarray.load_dataset(path, engine="h5netcdf")),
    ".csv": lambda path: told(pandas.read_csv(path, sep=None, engine="python")),
    ".npz": lambda path: told(dict(np.load(path))),
    ".json": lambda path: told(json.loads(path.read_text(encoding="utf-8"))),
    ".toml": lambda path: told(path.read_text(encoding="utf-8")),
    ".png": lambda path: "picture {}x{}".format(*Image.open(path).size),
}


def told_file(path):
    """A file that a command wrote, in short."""
    return "store" if path.is_dir() else FILES.get(path.suffix, lambda path: "written")(path)


def commanded(line):
    """The outcome of the last of these commands: how it ends, the JSON that it prints, the files that it writes."""
    *others, words = (shlex.split(command)[1:] for command in line.split(" && "))
    for other in others:
        CliRunner().invoke(app, other)
    before = {path: path.stat().st_mtime_ns for path in Path().iterdir()}
    done = CliRunner().invoke(app, words, env={"COLUMNS": "200"})
    if done.exit_code:
        return f"exit {done.exit_code}: {(done.stderr or done.stdout).strip().split(chr(10))[0]}"
    parts = ["exit 0", "prints" if done.stdout else "silent"]
    if done.stdout.startswith("{"):
        whole = done.stdout.replace("}\n{", "},{")
        parts[1] = "JSON " + told(json.loads(f"[{whole}]"))
    before[Path("__pycache__")] = Path("__pycache__").stat().st_mtime_ns if Path("__pycache__").exists() else 0
    written = sorted(path for path in Path().iterdir() if path.stat().st_mtime_ns != before.get(path))
    return "; ".join([*parts, *(f"{path}: {told_file(path)}" for path in written)])


def evaluated(text):
    """The value of Python text, whose last statement is an expression; `THINGS` that it names are made before."""
    *first, last = ast.parse(text).body
    named = {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)} & THINGS.keys()
    space = SPACE | {name: prepared(name) for name in named}
    exec(compile(ast.Module(first, []), text, "exec"), space)
    return eval(compile(ast.Expression(last.value), text, "eval"), space)


@cache
def prepared(name):
    """What calls name in capitals, made once by the call in `things.json`."""
    return inside(lambda: evaluated(THINGS[name]))


@cache
def result(call):
    """The result of a call: Python text, or a command line."""
    try:
        if call.startswith("nontwist "):
            return inside(lambda: commanded(call))
        return inside(lambda: told(evaluated(call)))
    except (Exception, nontwist.errors.SimulationInterrupt) as error:
        return f"{type(error).__name__}: {str(error).split(chr(10))[0]}"


def inside(action):
    """Do something in a new folder with the files that calls name."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), matplotlib.rc_context():
        warnings.simplefilter("ignore")
        shutil.copytree(HERE / "files", folder, dirs_exist_ok=True)
        os.chdir(folder)
        try:
            return action()
        finally:
            os.chdir(here)


# the table


def table():
    """The rows of the table, by kind and name."""
    rows = json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else []
    return {(row["kind"], row["name"]): row for row in rows}


def accuracy_of(row):
    """How closely a result is to be found again: fits end where a sum of squares changes by 1e-8 of itself.

    One of them differs by 4e-7 between the kernels of OpenBLAS for Haswell and for Skylake.
    """
    if row["name"] == "fit_inertia(rate)":
        return 5e-7
    return 1e-7 if "fit" in row["call"].lower() else 1e-9


def is_run(row):
    """Whether the call of a row is made."""
    return row["now"] != "gone" and not row["result"].startswith("not run")


def main():
    """Make the calls, and write the table; a result that is the same keeps its digits."""
    rows = table()
    for row in rows.values():
        if is_run(row):
            now = result(row["call"])
            if not alike(row["result"], now, accuracy_of(row)):
                print(f"{row['kind']} {row['name']}: {row['result']} -> {now}", file=sys.stderr)
                row["result"] = now
    lines = [json.dumps(rows[key], ensure_ascii=False) for key in sorted(rows)]
    TABLE.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
