"""Public names stay what they are, whatever is imported, in any order."""

import ast
import pkgutil
import random
import subprocess
import sys
from importlib.resources import files
from types import ModuleType

import pytest

import nontwist

NAMESPACES = {name for name in nontwist.__all__ if isinstance(getattr(nontwist, name), ModuleType)}


def modules():
    return sorted(info.name for info in pkgutil.walk_packages(nontwist.__path__, "nontwist."))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_names_survive_every_import(seed):
    """And every module can be imported without LLVM."""
    order = modules()
    random.Random(seed).shuffle(order)
    code = (
        "import sys, importlib, types\n"
        "sys.modules['llvmlite'] = None\n"
        "import nontwist\n"
        f"for name in {order!r}: importlib.import_module(name)\n"
        "for name in nontwist.__all__:\n"
        "    value = getattr(nontwist, name)\n"
        "    is_module = isinstance(value, types.ModuleType)\n"
        f"    assert is_module == (name in {NAMESPACES}), name\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_no_module_bears_the_name_of_a_public_function():
    last = {name.rsplit(".", 1)[1] for name in modules()}
    assert last & (set(nontwist.__all__) - NAMESPACES) == set()


def test_the_names_are_those_of_the_stub_as_python_reads_it():
    tree = ast.parse(files("nontwist").joinpath("__init__.pyi").read_text(encoding="utf-8"))
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    assert {(alias.name, alias.asname, node.module, node.level) for node in nodes for alias in node.names} == {
        (name, name, home.removeprefix("nontwist").lstrip(".") or None, 1) for name, home in nontwist._HOME.items()
    }


def test_names_are_listed_for_completion_and_others_are_attribute_errors():
    assert {"simulate", "plot", "__version__"} <= set(dir(nontwist))
    assert nontwist.__version__
    with pytest.raises(AttributeError, match="module 'nontwist' has no attribute 'simulat'"):
        nontwist.simulat  # noqa: B018
