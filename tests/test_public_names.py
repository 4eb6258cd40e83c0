"""Public names stay what they are, whatever is imported, in any order."""

import ast
import pkgutil
import random
import subprocess
import sys
from importlib.resources import files

import pytest

import nontwist


def modules():
    return sorted(info.name for info in pkgutil.walk_packages(nontwist.__path__, "nontwist."))


@pytest.mark.parametrize("seed", range(3))
def test_names_survive_every_import(seed):
    order = modules()
    random.Random(seed).shuffle(order)
    code = (
        "import nontwist, importlib, types\n"
        f"for name in {order!r}: importlib.import_module(name)\n"
        "for name in nontwist.__all__:\n"
        "    value = getattr(nontwist, name)\n"
        "    is_module = isinstance(value, types.ModuleType)\n"
        "    assert is_module == (name in nontwist._NAMESPACES), name\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_no_module_bears_the_name_of_a_public_function():
    last = {name.rsplit(".", 1)[1] for name in modules()}
    assert last & set(nontwist._HOME) == set()


def test_the_stub_lists_the_same_names():
    tree = ast.parse(files("nontwist").joinpath("__init__.pyi").read_text())
    listed = {alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert listed == set(nontwist.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'nontwist' has no attribute 'simulat'"):
        nontwist.simulat  # noqa: B018
    assert nontwist.__version__


def test_names_are_listed_for_completion():
    assert {"simulate", "plot", "__version__"} <= set(dir(nontwist))
