"""Faults of run files: what is not TOML, what is not a number, what is far too long."""

from __future__ import annotations

import os
import resource
from pathlib import Path

from nontwist.errors import RunFileError
from nontwist.runfile import read_run_file

from .children import answer

SOUND = '[body]\nkind = "standard"\ninertia = [3, 4, 5]\n\n[time]\nt_end = 1\n'


def refusals(folder: Path, text: str | bytes) -> list[str]:
    """Return what is said of a run file, without its folder."""
    path = folder / "run.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    try:
        read_run_file(path)
    except RunFileError as error:
        return [line.replace(f"{folder}/", "") for line in str(error).splitlines()]
    raise AssertionError(f"{text[:80]!r} was read")


def one(folder: Path, text: str | bytes) -> str:
    """Return the one thing that is said of a run file."""
    (reason,) = refusals(folder, text)
    return f"“{reason}”"


def not_finite(folder: Path) -> str:
    """NaN, inf and 1e400 together in a run file."""
    text = SOUND.replace("[3, 4, 5]", "[3, nan, 5]").replace("t_end = 1", "t_end = 1e400\nstep = inf")
    reasons = refusals(folder, text)
    assert len(reasons) == 3, reasons
    return "; ".join(f"“{reason}”" for reason in reasons)


def much_too_long(folder: Path) -> str:
    """A run file of 100 MB."""
    return one(folder, SOUND + "# and so on\n" * (100_000_000 // 12))


def byte_order_mark(folder: Path) -> str:
    """A run file that begins with a byte order mark, as some editors write it."""
    path = folder / "run.toml"
    path.write_text(SOUND, encoding="utf-8-sig")
    assert read_run_file(path).time.t_end == 1
    return "read; the mark is ignored"


def given_twice(folder: Path) -> str:
    """A key given twice, and a table given twice."""
    return f"{one(folder, SOUND + 't_end = 2')}; {one(folder, SOUND + '[time]')}"


def yaml_by_mistake(folder: Path) -> str:
    """YAML in a run file."""
    return one(folder, "body:\n  kind: standard\n  inertia: [3, 4, 5]\n")


def another_encoding(folder: Path) -> str:
    """A run file in UTF-16."""
    return one(folder, SOUND.encode("utf-16"))


def misspelt(folder: Path) -> str:
    """A misspelt key and a misspelt kind."""
    reasons = refusals(folder, SOUND.replace("inertia", "inertai").replace("standard", "Standard"))
    assert any("did you mean inertia?" in reason for reason in reasons), reasons
    return "; ".join(f"“{reason}”" for reason in reasons)


HELD = SOUND.replace("standard", "nontwisting")
COSTLY = {
    "a sine of 1e8 Hz": HELD + '[integrator]\nname = "exact"\n[[load]]\nkind = "sine"\nframe = "body"\n'
    "amplitude = [1, 0, 0]\nfrequency = 1e8\n",
    "20,000 unknown keys": HELD + "".join(f"step_{i} = 1\n" for i in range(20_000)),
    "2e8 stored states": f"{HELD}step = 5e-9\n",
    "a grid of 1e11 values": HELD + '[sweep]\nover = [{ key = "body.inertia.0", kind = "grid", start = 3, end = 4, '
    "count = 100_000_000_000 }]\n",
}


def _checked_in_200_mb(folder: Path) -> dict[str, int]:
    from typer.testing import CliRunner

    from nontwist.cli import app

    def check(text: str) -> int:
        path = folder / "run.toml"
        path.write_text(text, encoding="utf-8")
        return CliRunner().invoke(app, ["check", str(path)]).exit_code

    small = COSTLY["a sine of 1e8 Hz"].replace("1e8", "1")
    assert check(small) == 0  # imports
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0])
    scratch = pages * os.sysconf("SC_PAGE_SIZE") + 200_000_000
    resource.setrlimit(resource.RLIMIT_AS, (scratch, scratch))
    return {what: check(text) for what, text in COSTLY.items()}


def costly(folder: Path) -> str:
    """`nontwist check` with 200 MB left: a sine of 1e8 Hz for `exact`, 20,000 unknown keys, 2e8 stored states.

    And a grid of 1e11 values.
    """
    codes = answer(_checked_in_200_mb, folder)
    large = codes.pop("2e8 stored states")  # in order where 160 GB are free
    assert large in (0, 3), large
    assert set(codes.values()) == {3}, codes
    return "each check ends; what cannot run is refused, with the number that would be possible"


FAULTS = (not_finite, much_too_long, byte_order_mark, given_twice, yaml_by_mistake, another_encoding, misspelt, costly)
LONG = ()
