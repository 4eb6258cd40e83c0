"""What `pyproject.toml` asks for and what `constraints.txt` pins fit together."""

import tomllib
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PINNED = [line.split("==") for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()]


def test_pins_are_the_dependencies():
    wanted = map(Requirement, sum(PROJECT["optional-dependencies"].values(), PROJECT["dependencies"]))
    pins = {canonicalize_name(name): version for name, version in PINNED} | {"nontwist": "0"}
    assert [need for need in wanted if not need.specifier.contains(pins[canonicalize_name(need.name)])] == []


def test_pins_accept_every_python():
    """Else `make` fails where Python is 3.11.2, as on Debian 12, though the package accepts it."""
    least = f"{PROJECT['requires-python'].removeprefix('>=')}.0"
    for name, pinned in PINNED:
        with suppress(PackageNotFoundError):
            found = distribution(name)
            accepted = SpecifierSet(found.metadata.get("Requires-Python") or "")
            assert found.version != pinned or accepted.contains(least), name


def test_recipe():
    lines = (ROOT / "recipe" / "meta.yaml").read_text(encoding="utf-8").partition("  run:\n")[2].partition("\n\n")[0]
    asked = [line.strip(" -").replace("-base", "").replace(" ", "") for line in lines.splitlines()]
    assert asked == [f"python{PROJECT['requires-python']}", *PROJECT["dependencies"]]
