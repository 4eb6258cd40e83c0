"""Pictures and films of runs as files: PNG of a moment, GIF, and MP4 where there is ffmpeg."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import warn
from ..geometry.arrays import as_array
from ..io.whole import written
from .content import contents
from .drawing import WIDTH, Look, Motion, colours, still

if TYPE_CHECKING:
    from PIL.Image import Image

SECONDS, PAUSE = 8.0, 1.5  # how long a film takes, and stands still at its end
RATES = {".gif": 12.5, ".mp4": 25.0}  # pictures a second
WIDTHS = {".gif": 480, ".mp4": 720, ".png": 960}  # pixels of a run
WIDE = (100, 4096)  # least and largest width of a picture
FASTEST = 50.0  # pictures a second
LEAP = np.radians(120)  # from picture to picture
NO_FFMPEG = "an MP4 film needs ffmpeg, which is not on the path; install it, or write a GIF"


def save_still(
    runs: list[Any], path: str | os.PathLike[str], time: float | None = None, *, force: bool = False, **look: Any
) -> None:
    """Write the picture of a moment, by default the end, as PNG.

    Parameters
    ----------
    runs : list of runs or motions
        As `view` takes them.
    path : path
    time : float, optional
        s.
    force : bool
        Replace a file of this name.
    **look
        As `Pictures` takes it; by default 960 pixels for each run.

    Raises
    ------
    ValueError
        No run, a time outside of all runs, a width that is too small or too large, or no direction for the camera.
    OSError
        The file exists or cannot be written.
    """
    pictures = Pictures(runs, ".png", **look)
    first, last = pictures.span
    if time is not None and not first <= time <= last:
        raise ValueError(f"the picture is asked for at {time:g} s; the run is from {first:g} to {last:g} s")
    with written(path, force=force) as file:
        pictures.at(last if time is None else time).save(file, "PNG")


def save_film(
    runs: list[Any],
    path: str | os.PathLike[str],
    *,
    seconds: float | None = None,
    rate: float | None = None,
    force: bool = False,
    **look: Any,
) -> None:
    """Write a film, GIF or MP4 by the suffix of the file.

    Parameters
    ----------
    runs : list of runs or motions
        As `view` takes them.
    path : path
    seconds : float, optional
        Length of the film, s, 8 by default; at its end it stands still for another 1.5 s.
    rate : float, optional
        Pictures per second, at most 50; by default 12.5 for GIF and 25 for MP4.
    force : bool
        Overwrite an existing file.
    **look
        As `Pictures` takes it; by default 480 pixels for each run of a GIF, 720 of an MP4.

    Raises
    ------
    ValueError
        No run, a suffix that is neither .gif nor .mp4, no ffmpeg for MP4, a length, a rate or a width that is too
        small or too large, or no direction for the camera.
    OSError
        The file exists or cannot be written.
    """
    kind = Path(path).suffix.lower()
    if kind not in RATES:
        raise ValueError(f"a film is a .gif or a .mp4 file, got {path}")
    if kind == ".mp4" and shutil.which("ffmpeg") is None:
        raise ValueError(NO_FFMPEG)
    seconds, rate = SECONDS if seconds is None else seconds, RATES[kind] if rate is None else rate
    if not 0 < rate <= FASTEST:
        raise ValueError(
            f"the rate of a film must be positive and at most {FASTEST:g} pictures per second, got {rate:g}"
        )
    if not 0 < seconds < math.inf:
        raise ValueError(f"the length of a film must be positive, got {seconds:g} s")
    pictures = Pictures(runs, kind, **look)
    rate = 100 / round(100 / rate) if kind == ".gif" else rate  # GIF counts in hundredths of seconds
    times = np.linspace(*pictures.span, 1 + max(1, round(seconds * rate)))
    turn = max(motion.data["turned"] / (len(times) - 1) for motion in pictures.motions)
    if turn > LEAP:  # it seems to turn otherwise, or not at all
        enough = max(seconds, math.ceil(seconds * rate * turn / LEAP / FASTEST))
        warn(
            f"the body turns by {math.degrees(turn):.0f}° from picture to picture, on average, so it may seem to turn "
            f"backwards or to stand; use --seconds {enough:g} --fps {FASTEST:g}, or a part of the run: "
            "--from T0 --to T1"
        )
    with written(path, force=force) as file:
        shots = map(pictures.at, times)
        ground = colours(pictures.look.dark)["card"]
        file.write(_gif(shots, len(times), rate, ground) if kind == ".gif" else _mp4(shots, rate))


class Pictures:
    """Pictures of runs, at any time.

    Parameters
    ----------
    runs : list of runs or motions
    kind : ".gif", ".mp4" or ".png"
        Of the file for which they are.
    width : int, optional
        Pixels of a picture; by default as many for each run as fit the kind of file.
    labels : str or two strings, optional
        As those of `view`; by default one run has the title.
    title : str, optional
        By default that of the run file, if there is one run. Several runs, and one with a label, have it above them.
    camera : (azimuth, elevation), optional
        Degrees: the azimuth from x towards y, the elevation towards z. By default from the side where the paths are,
        and under gravity from above the horizon.
    dark : bool
        Take the colours of the dark page.
    """

    def __init__(
        self,
        runs: list[Any],
        kind: str,
        *,
        width: int | None = None,
        labels: str | Sequence[str] | None = None,
        title: str | None = None,
        camera: tuple[float, float] | None = None,
        dark: bool = False,
    ) -> None:
        found = contents(runs, labels)
        if len(found) == 1 and labels is None:
            found[0]["name"], title = title or found[0]["title"] or found[0]["name"], None
        self.motions = [Motion(data) for data in found]
        if camera is not None:
            azimuth, elevation = as_array(camera, "camera", (2,))
            if abs(elevation) > 90:
                raise ValueError(f"the elevation of the camera must be from -90 to 90 degrees, got {elevation:g}")
            camera = math.radians(azimuth), math.radians(elevation)
        if width is not None and not WIDE[0] <= width <= WIDE[1]:
            raise ValueError(f"the width must be {WIDE[0]} to {WIDE[1]} pixels, got {width}")
        pixels = WIDTHS[kind] * len(found) if width is None else width
        self.look, self.dots = Look(dark, camera, title or ""), (pixels + 0.5) / (WIDTH * len(found))  # rounded down
        times = [float(motion.time[k]) for motion in self.motions for k in (0, -1)]
        self.span = min(times), max(times)

    def at(self, time: float) -> Image:
        """Return the picture of a moment."""
        from PIL import Image

        buffer, figure = BytesIO(), still(self.motions, time, self.dots, self.look)
        size = int(figure.bbox.width), int(figure.bbox.height)
        figure.savefig(buffer, format="rgba", dpi=self.dots)
        return Image.frombytes("RGBA", size, buffer.getvalue()).convert("RGB")


def _gif(pictures: Iterator[Image], count: int, rate: float, ground: str) -> bytes:
    """Return a GIF whose colours are those of its last picture, where everything is on show."""
    from PIL.Image import Dither, Quantize

    shots = list(pictures)
    palette = shots[-1].quantize(64, method=Quantize.FASTOCTREE)
    numbers = np.array(palette.getpalette(), dtype=np.uint8).reshape(-1, 3)
    own = np.frombuffer(bytes.fromhex(ground[1:]), np.uint8)
    numbers[abs(numbers - own.astype(int)).sum(1).argmin()] = own  # which averages of dots have changed
    palette.putpalette(numbers.tobytes())
    first, *rest = (shot.quantize(palette=palette, dither=Dither.NONE) for shot in shots)
    duration = [round(1000 / rate)] * (count - 1) + [round(1000 * PAUSE)]
    buffer = BytesIO()
    first.save(buffer, "GIF", save_all=True, append_images=rest, duration=duration, loop=0)
    return buffer.getvalue()


def _mp4(pictures: Iterator[Image], rate: float) -> bytes:
    first = next(pictures)
    width, height = (side // 2 * 2 for side in first.size)  # what players take has even sides
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "film.mp4"
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
        command = ["ffmpeg", "-v", "error", *raw, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdin is not None
            assert process.stderr is not None
            shot = first
            with suppress(BrokenPipeError):  # it has ended, and says why
                for shot in (first, *pictures):
                    process.stdin.write(shot.crop((0, 0, width, height)).tobytes())
                process.stdin.write(shot.crop((0, 0, width, height)).tobytes() * round(PAUSE * rate))
                process.stdin.close()
            trouble = process.stderr.read().decode(errors="replace").strip()
        if process.returncode or not target.is_file():
            raise OSError(f"ffmpeg could not write the film: {trouble or f'it ended with status {process.returncode}'}")
        return target.read_bytes()
