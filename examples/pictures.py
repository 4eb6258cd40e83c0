"""Draw the picture of the documentation's first page, and the film of the README, from the code that stands there.

`python examples/pictures.py [FOLDER]` writes FOLDER/frame.png, FOLDER/bodies.gif and FOLDER/bodies-dark.gif (default:
docs/images).
"""

import argparse
import contextlib
import re
import tempfile
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from PIL import Image

from nontwist import plot, twist
from nontwist.curves import nontwisting_frame, solid_angle
from nontwist.viewer.drawing import colours
from nontwist.viewer.films import save_film

RUST, NAVY, DARK = colours()["d1"], colours()["d3"], "0.15"
ELEVATION, AZIMUTH = 38.0, 20.0


def screen(x, elevation=ELEVATION, azimuth=AZIMUTH):
    """Return points (..., 3) as they are seen: right, up, towards the viewer."""
    e, a = np.radians([elevation, azimuth])
    right = np.array([-np.sin(a), np.cos(a), 0])
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return np.asarray(x) @ np.stack([right, np.cross(towards, right), towards]).T


def stick(ax, foot, along, length, colour, width, zorder):
    """Draw a tangent arrow."""
    tip, foot = screen(foot + length * along), screen(foot)
    arrow = {
        "arrowstyle": "-|>,head_width=0.16,head_length=0.32",
        "color": colour,
        "lw": width,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    ax.annotate("", tip[:2], foot[:2], arrowprops=arrow, zorder=zorder)


def write(ax, place, words, colour, **look):
    """Write words that can be read on the sphere."""
    text = ax.text(*place, words, color=colour, zorder=9, **{"fontsize": 8, "ha": "center", "va": "center"} | look)
    text.set_path_effects([withStroke(linewidth=2, foreground="white")])


def headline(ax, words, colour):
    """Write above the sphere."""
    ax.set_ylim(-1.06, 1.46)
    ax.text(0, 1.36, words, color=colour, fontsize=10, ha="center", va="center")


def circle_and_frames():
    """Return a circle of the axis, its non-twisting frame, and a frame that looks ahead all the time."""
    t = np.linspace(0, 2 * np.pi, 721)
    colatitude = np.arccos(1 - 1 / 6)  # a twelfth of the sphere lies inside: 60 degrees
    z = np.full_like(t, np.cos(colatitude))
    d3 = np.stack([np.sin(colatitude) * np.cos(t), np.sin(colatitude) * np.sin(t), z], axis=1)
    ahead = np.stack([-np.sin(t), np.cos(t), np.zeros_like(t)], axis=1)
    carried = nontwisting_frame(d3, d1=ahead[0], order=4)
    looking = np.stack([ahead, np.cross(d3, ahead), d3], axis=1)
    return t, d3, carried, looking


def frame_picture():
    """Two frames with the same axis: one is carried along without twist, one looks ahead."""
    t, d3, carried, looking = circle_and_frames()
    angle = np.degrees(solid_angle(d3, pole=(0, 0, 1)))
    axes = plot.new_axes(columns=2, panels=2, height=3.3, letters=False)
    titles = {
        "carried without twist": (carried, NAVY, f"back, turned by\nthe area inside:\n{angle:.0f}°"),
        "looking ahead": (looking, RUST, "back as it left:\nit has twisted"),
    }
    for ax, (title, (frame, colour, words)) in zip(axes, titles.items(), strict=True):
        motion = twist(frame.transpose(0, 2, 1), t)
        plot.path(motion, ax, elevation=ELEVATION, azimuth=AZIMUTH)
        ax.get_legend().remove()
        ax.add_patch(Polygon(screen(d3)[:, :2], facecolor=colour, alpha=0.12, zorder=3))
        for k in range(60, 720, 60):
            stick(ax, d3[k], frame[k, 0], 0.22, colour, 1.1, 5)
        stick(ax, d3[0], frame[0, 0], 0.34, DARK, 1.6, 7)
        stick(ax, d3[-1], frame[-1, 0], 0.34, colour, 1.6, 8)
        write(ax, screen(d3[0])[:2] - (0, 0.3), words, colour)
        headline(ax, f"{title}: twist {round(np.degrees(motion.twist_angle[-1].item()))}°", colour)
    return axes[0].figure


def bodies_of_the_readme():
    """Run the code of the README; return the two runs that it views."""
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    space = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), contextlib.redirect_stdout(StringIO()):
        for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            exec(code, space)
    return [space["free"], space["held"]]


SECONDS = 4.0  # of the film, before it stands still


def picture(figure, dpi):
    """Return a figure as a picture."""
    file = BytesIO()
    figure.savefig(file, format="png", dpi=dpi)
    return Image.open(file).convert("RGB")


def main(folder):
    """Write all."""
    folder.mkdir(parents=True, exist_ok=True)
    picture(frame_picture(), 200).quantize(128).save(folder / "frame.png", optimize=True)
    for name, dark in (("bodies.gif", False), ("bodies-dark.gif", True)):
        save_film(bodies_of_the_readme(), folder / name, seconds=SECONDS, width=774, dark=dark, force=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[1] / "docs" / "images")
    main(parser.parse_args().folder)
