"""Pictures and films of runs as files: PNG of a moment, GIF, and MP4 where there is ffmpeg."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..io.whole import written
from .content import content
from .drawing import HEIGHT, WIDTH, Motion, colours, still

if TYPE_CHECKING:
    from PIL.Image import Image

SECONDS, PAUSE = 8.0, 1.5  # how long a film takes, and stands still at its end
RATES = {".gif": 12.5, ".mp4": 25.0}  # pictures a second; GIF counts in hundredths of seconds
DOTS = {".gif": 90, ".mp4": 150, ".png": 200}  # an inch
NO_FFMPEG = "an MP4 film needs ffmpeg, which is not on the path; install it, or write a GIF"


def save_still(
    runs: list[Any], path: str | os.PathLike[str], time: float | None = None, *, dark: bool = False, force: bool = False
) -> None:
    """Write the picture of a moment, by default the end, as PNG.

    Parameters
    ----------
    runs : list of runs or motions
        As `view` takes them.
    path : path
    time : float, optional
        s.
    dark : bool
        Take the colours of the dark page.
    force : bool
        Replace a file of this name.

    Raises
    ------
    ValueError
        No run, or a time outside of all runs.
    OSError
        The file exists or cannot be written.
    """
    motions = _motions(runs)
    first, last = _span(motions)
    if time is not None and not first <= time <= last:
        raise ValueError(f"the picture is asked for at {time:g} s; the run is from {first:g} to {last:g} s")
    with written(path, force=force) as file:
        _picture(motions, last if time is None else time, DOTS[".png"], dark).save(file, "PNG")


def save_film(
    runs: list[Any], path: str | os.PathLike[str], *, seconds: float = SECONDS, dark: bool = False, force: bool = False
) -> None:
    """Write a film, GIF or MP4 by the name of the file; it lasts so many seconds, and stands still at its end.

    With `dark` it has the colours of the dark page.

    Raises
    ------
    ValueError
        No run, a name that is neither .gif nor .mp4, or no ffmpeg for MP4.
    OSError
        The file exists or cannot be written.
    """
    kind = Path(path).suffix.lower()
    if kind not in RATES:
        raise ValueError(f"a film is a .gif or a .mp4 file, got {path}")
    if kind == ".mp4" and shutil.which("ffmpeg") is None:
        raise ValueError(NO_FFMPEG)
    motions = _motions(runs)
    times = np.linspace(*_span(motions), max(2, round(seconds * RATES[kind])))
    with written(path, force=force) as file:
        pictures = (_picture(motions, time, DOTS[kind], dark) for time in times)
        file.write(_gif(pictures, len(times), colours(dark)["card"]) if kind == ".gif" else _mp4(pictures))


def _motions(runs: list[Any]) -> list[Motion]:
    return [Motion(content(run)) for run in runs]


def _span(motions: list[Motion]) -> tuple[float, float]:
    return min(float(motion.time[0]) for motion in motions), max(float(motion.time[-1]) for motion in motions)


def _picture(motions: list[Motion], time: float, resolution: int, dark: bool) -> Image:
    from PIL import Image

    buffer = BytesIO()
    still(motions, time, resolution, dark).savefig(buffer, format="rgba")
    size = (round(WIDTH * resolution) * len(motions), round(HEIGHT * resolution))
    return Image.frombytes("RGBA", size, buffer.getvalue()).convert("RGB")


def _gif(pictures: Iterator[Image], count: int, ground: str) -> bytes:
    """Return a GIF whose colours are those of its last picture, where everything is on show."""
    from PIL.Image import Dither, Quantize

    shots = list(pictures)
    palette = shots[-1].quantize(64, method=Quantize.FASTOCTREE)
    numbers = np.array(palette.getpalette(), dtype=np.uint8).reshape(-1, 3)
    own = np.frombuffer(bytes.fromhex(ground[1:]), np.uint8)
    numbers[abs(numbers - own.astype(int)).sum(1).argmin()] = own  # which averages of dots have changed
    palette.putpalette(numbers.tobytes())
    first, *rest = (shot.quantize(palette=palette, dither=Dither.NONE) for shot in shots)
    duration = [round(1000 / RATES[".gif"])] * (count - 1) + [round(1000 * PAUSE)]
    buffer = BytesIO()
    first.save(buffer, "GIF", save_all=True, append_images=rest, duration=duration, loop=0)
    return buffer.getvalue()


def _mp4(pictures: Iterator[Image]) -> bytes:
    rate, first = RATES[".mp4"], next(pictures)
    width, height = (side // 2 * 2 for side in first.size)  # what players take has even sides
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "film.mp4"
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
        command = ["ffmpeg", "-v", "error", *raw, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdin is not None
            assert process.stderr is not None
            shot = first
            for shot in (first, *pictures):
                process.stdin.write(shot.crop((0, 0, width, height)).tobytes())
            process.stdin.write(shot.crop((0, 0, width, height)).tobytes() * round(PAUSE * rate))
            process.stdin.close()
            trouble = process.stderr.read().decode(errors="replace").strip()
        if process.returncode:
            raise OSError(f"ffmpeg could not write the film: {trouble}")
        return target.read_bytes()
