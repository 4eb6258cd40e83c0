"""The oldest version that pyproject.toml allows of each dependency, as constraints for pip."""

import re
import tomllib
from pathlib import Path

EXTRAS = ("test", "mesh", "c3d", "ros", "spice", "jax", "sweep")
ONE = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?\s*>=\s*([0-9.]+)")


def oldest(extras=EXTRAS):
    """Return one line for each dependency: ``numpy==2.0``."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(one for extra in extras for one in project["optional-dependencies"][extra])]
    return [f"{match[1]}=={match[2]}" for match in map(ONE.fullmatch, wanted) if match]


if __name__ == "__main__":
    print(*oldest(), sep="\n")
