"""Stills and films of runs without a browser: the scene of the page, drawn by Matplotlib from the same data.

The unit sphere is seen from afar (orthographic), from where the page looks at first. What is on the far side is drawn
first, then the box, which lets it through, then what is near. Of a body that weighs the vertical is dashed, and the
arrow g in the corner points down.
"""

from __future__ import annotations

import base64
import re
import textwrap
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array, Axes, arcs, cross
from ..geometry.attitudes import directors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RING, POINTER, RIBS = (0.7, 0.86), 0.98, 300
WHEEL, MOMENTUM = (0.3, 0.4), 0.66  # of a rotor: its rims, and the longest arrow
DIAL = (1.62, 0.0)  # where the middle of the dial is; its radius is 0.42
LABEL, CLEAR = 0.13, (0.09, 0.17)  # of a label: from the tip of its arrow, from other arrows, from other labels
CORNER = np.array([-1.05, -0.88])  # where the arrow of gravity is
WIDTH, HEIGHT, BAND = 4.3, 3.3, 0.25  # inches of a run, and of a line of the title
FITS = 34  # letters of a name beside the time
TITLE = (38, 80)  # letters of a title above one run, above two
FEW = 4 * np.pi  # rad: of longer paths the area is not filled
CHORD = 0.05  # rad: the longest straight piece of a path


# Where a scene is seen from: the side of the paths, and from above the horizon where there is a vertical.

AZIMUTH, ELEVATION = 0.61, 0.42  # rad
LOWEST, HIGHEST = 0.2, 0.7  # rad: elevations from which a vertical is seen as one
ONE_SIDED = 0.3  # length of the mean of points on the unit sphere from which on they are on one side
PLANE = 0.1  # of the squares of horizontal distances: the part across a vertical plane, at most


@cache
def colours(dark: bool = False) -> dict[str, str]:
    """Return the colours of the pages in the light or in the dark, as their style sheet has them."""
    style = files(__package__).joinpath("common.css").read_text("utf-8")
    return dict(re.findall(r"--([\w-]+): (#\w+)", style.split("}")[1 if dark else 0]))


class Look(NamedTuple):
    """How a picture looks: in the colours of the dark page, from which azimuth and elevation, rad, and its title."""

    dark: bool = False
    camera: tuple[float, float] | None = None
    title: str = ""


DEFAULT = Look()


class Motion:
    """The data of a page, unpacked, at any time."""

    def __init__(self, data: dict[str, Any]) -> None:
        self.data = data
        self.time, self.quaternion = data["start"] + _unpacked(data["time"]), _unpacked(data["attitude"]).reshape(-1, 4)
        self.twist = _unpacked(data["twist"])
        self.path_time, self.path = self._path()
        self.half, self.edges, self.centre = (np.array(data["box"][key]) for key in ("half", "edges", "centre"))
        weight = data["weight"]
        self.down = None if weight is None else np.array(weight["down"])
        self.centre_of_mass = None if weight is None else np.array(weight["centre_of_mass"])
        momenta = [_unpacked(wheel["momentum"]) for wheel in data["rotors"]]
        strongest = max((float(abs(h).max()) for h in momenta), default=0.0) or 1.0  # of all rotors
        self.rotors = [
            (np.array(wheel["axis"]), h / strongest) for wheel, h in zip(data["rotors"], momenta, strict=True)
        ]
        self.fills = float(arcs(self.path).sum()) < FEW

    def _path(self) -> tuple[Array, Array]:
        """Return d3 and its times: the states, and between two of them as many points as their rotation needs."""
        from scipy.spatial.transform import Rotation

        start, end = Rotation.from_quat(self.quaternion[:-1]), Rotation.from_quat(self.quaternion[1:])
        turn = (end * start.inv()).as_rotvec()
        count = np.maximum(1, np.ceil(np.linalg.norm(turn, axis=1) / CHORD)).astype(int)
        k = np.repeat(np.arange(len(count)), count)
        part = (np.arange(len(k)) - np.repeat(np.cumsum(count) - count, count)) / count[k]
        time = self.time[:-1][k] + part * np.diff(self.time)[k]
        between = (Rotation.from_rotvec(part[:, None] * turn[k]) * start[k]).apply([0.0, 0.0, 1.0])
        return np.append(time, self.time[-1]), np.vstack([between, directors(self.quaternion[-1:])[:, 2]])

    def at(self, time: float) -> tuple[Array, float, Array]:
        """Return triad, twist and the path so far: rotations between two states by the shortest way."""
        from scipy.spatial.transform import Rotation, Slerp

        time = float(np.clip(time, self.time[0], self.time[-1]))
        k = min(int(np.searchsorted(self.time, time, side="right")), len(self.time) - 1)
        R = Slerp(self.time[k - 1 : k + 1], Rotation.from_quat(self.quaternion[k - 1 : k + 1]))(time)
        triad: Array = R.as_matrix().T
        path = np.vstack([self.path[: np.searchsorted(self.path_time, time, side="right")], triad[2]])
        return triad, float(np.interp(time, self.time, self.twist)), path


class Camera(NamedTuple):
    """Azimuth and elevation, rad, in upright axes: rows, the third of which is up on the picture."""

    azimuth: float
    elevation: float
    upright: Array = np.eye(3)

    def view(self) -> Array:
        """Return right, up and towards the reader, rows."""
        a, e = self.azimuth, self.elevation
        ca, sa, ce, se = np.cos(a), np.sin(a), np.cos(e), np.sin(e)
        return np.array([[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]]) @ self.upright


def camera_of(motions: list[Motion]) -> Camera:
    """Return the camera that is not chosen by the user.

    It is on the side where the paths are, if they are on one. Up is z, or, of bodies that weigh, opposite to gravity;
    then it is above the horizon, and across the plane in which a pendulum swings.
    """
    down = next((motion.down for motion in motions if motion.down is not None), None)
    upright = np.eye(3) if down is None else _turned_up(-down)
    points = np.concatenate([motion.path for motion in motions]) @ upright.T
    x, y, z = points.mean(0)
    azimuth, elevation = AZIMUTH, ELEVATION
    if np.hypot(np.hypot(x, y), z) > ONE_SIDED:
        azimuth = np.arctan2(y, x) + 0.4
        elevation = np.clip(np.arctan2(z, np.hypot(x, y)) - 0.3, -1.2, 1.2)
    if down is not None:
        elevation = np.clip(elevation, LOWEST, HIGHEST)
        azimuth = _across(points[:, :2], azimuth)
    return Camera(float(azimuth), float(elevation), upright)


def _turned_up(up: Array) -> Array:
    """Return the smallest rotation that turns `up` to z, as a matrix; about x where it is opposite."""
    from scipy.spatial.transform import Rotation

    size = np.hypot(up[0], up[1])
    if size == 0:
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(np.arctan2(size, up[2]) / size * np.array([up[1], -up[0], 0.0])).as_matrix()


def _across(flat: Array, otherwise: float) -> float:
    """Return the azimuth that looks across the vertical plane of a path; `otherwise` where it is in none."""
    mean = flat.mean(0)
    spread, directions = np.linalg.eigh((flat - mean).T @ (flat - mean) / len(flat))
    normal = directions[:, 0]
    if max(spread[0], (mean @ normal) ** 2) > PLANE * spread[1]:
        return otherwise
    normal = normal * np.sign(normal @ [np.cos(AZIMUTH), np.sin(AZIMUTH)])
    return float(np.arctan2(normal[1], normal[0])) + 0.3


def still(motions: list[Motion], time: float, resolution: float, look: Look = DEFAULT) -> Figure:
    """Return the figure of a moment, of so many dots an inch, in the colours of the pages."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    camera = camera_of(motions) if look.camera is None else Camera(*look.camera)
    view, ink = camera.view(), colours(look.dark)
    lines = _lines(look.title, TITLE[len(motions) - 1])
    high = HEIGHT + BAND * len(lines)
    figure = Figure((WIDTH * len(motions), high), dpi=resolution, facecolor=ink["card"])
    for k, motion in enumerate(motions):
        ax = figure.add_axes((k / len(motions), 0, 1 / len(motions), HEIGHT / high))
        ax.set(xlim=(-1.25, 2.1), ylim=(-1.25, 1.32), aspect="equal")
        ax.axis("off")
        _scene(ax, motion, time, view, ink)
        name = "\n".join(textwrap.wrap(motion.data["name"], FITS, max_lines=3, placeholder=" …"))
        ax.text(-1.15, 1.3, name, fontsize=10, fontweight="bold", color=ink["ink"], va="top")
        words = f"t = {np.clip(time, motion.time[0], motion.time[-1]):.2f} s".replace("-", "−")
        ax.text(2.0, 1.3, words, fontsize=9, ha="right", va="top", color=ink["muted"])
        if k > 0:  # between the time of one run and the name of the next
            border = np.full(2, k / len(motions)), np.array([0.02, 0.99]) * HEIGHT / high
            figure.add_artist(Line2D(*border, color=ink["muted"], lw=0.8))
    if lines:
        shown: dict[str, Any] = {"fontsize": 11, "fontweight": "bold", "ha": "center", "va": "top", "color": ink["ink"]}
        figure.text(0.5, 1 - 0.3 * BAND / high, "\n".join(lines), **shown)
    return figure


def _lines(title: str, width: int) -> list[str]:
    """Return a title in at most two lines, as equally long as they can be."""
    whole = textwrap.wrap(title, width, max_lines=2, placeholder=" …")
    narrower = (textwrap.wrap(title, fewer) for fewer in range(1 + len(title) // 2, width))
    return next((lines for lines in narrower if len(lines) == 2), whole) if len(whole) == 2 else whole


def _scene(ax: Axes, motion: Motion, time: float, view: Array, ink: dict[str, str]) -> None:
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    triad, psi, path = motion.at(time)
    turn = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
    frame = turn @ triad[:2]  # the triad turned back by ψ
    ax.add_patch(Circle((0, 0), 1, fc=ink["glass-edge"], ec=ink["grid"], lw=0.8, alpha=0.55, zorder=0))
    names = zip(("d1", "d2", "d3"), motion.data["labels"], (POINTER, POINTER, 1.0), triad, strict=True)
    arrows = [(ink[colour], name, length, d) for colour, name, length, d in names]
    wheels = [(axis @ triad, float(np.interp(time, motion.time, h))) for axis, h in motion.rotors]
    arrows += [(ink["rotor"], "h", MOMENTUM * abs(h), np.sign(h) * axis) for axis, h in wheels if abs(h) > 0.02]
    places = label_places([length * (view[:2] @ d) for *_, length, d in arrows])
    for near in (False, True):
        z = 6 if near else 1
        _graticule(ax, view, near, ink, z)
        if motion.fills:
            _area(ax, path, view, near, ink, z)
        _ring(ax, frame, psi, view, near, ink, z + 1)
        _line(ax, path, view, near, z + 2, color=ink["d3"], lw=1.6, alpha=1 if near else 0.35)
        for axis, _ in wheels:
            _wheel(ax, axis, view, near, ink, z + 2)
        for (colour, name, length, d), place in zip(arrows, places, strict=True):
            if (d @ view[2] >= 0) == near:
                _arrow(ax, d, length, view, z + 3, colour)
                look: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9, "fontweight": "bold"}
                look |= {"color": ink["ink"], "path_effects": [withStroke(linewidth=2, foreground=ink["card"])]}
                ax.text(float(place[0]), float(place[1]), name, zorder=12 if near else z + 3, **look)
    _box(ax, motion, triad, view, ink)
    if motion.down is not None and motion.centre_of_mass is not None:
        _weight(ax, motion.down, view[:2] @ (motion.centre_of_mass @ triad), view, ink)
    _dial(ax, psi, ink)


def label_places(tips: list[Array]) -> list[Array]:
    """Return places for the labels of arrows from the middle: beyond the tip, or else where it is clear of the others.

    Of directions around the tip the first is taken that keeps its distance, or the one that comes nearest to it.
    """
    places: list[Array] = []
    for k, tip in enumerate(tips):
        turns = np.arctan2(tip[1], tip[0]) + np.radians([0, 40, -40, 80, -80, 120, -120])
        tries = tip + LABEL * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        shafts = [_distance(tries, other) / CLEAR[0] for j, other in enumerate(tips) if j != k]
        labels = [np.hypot(*(tries - other).T) / CLEAR[1] for other in places]
        clear = np.minimum(np.min([*shafts, *labels, np.ones(len(turns))], axis=0), 1.0)
        places.append(tries[int(np.argmax(clear))])
    return places


def _distance(points: Array, tip: Array) -> Array:
    """Return the distances of points from the line from the middle to a tip."""
    along = np.clip(points @ tip / max(float(tip @ tip), 1e-12), 0.0, 1.0)
    return np.hypot(*(points - along[:, None] * tip).T)


def _line(ax: Axes, points: Array, view: Array, near: bool, zorder: int, **look: Any) -> None:
    right, up, towards = (points @ view.T).T
    hidden = (towards >= 0) != near
    ax.plot(np.where(hidden, np.nan, right), np.where(hidden, np.nan, up), zorder=zorder, **look)


def graticule(latitudes: Sequence[float], count: int) -> tuple[list[Array], list[Array]]:
    """Return six meridians, and the parallels at these latitudes in degrees, each (count, 3)."""
    angle = np.linspace(0, 2 * np.pi, count)
    c, s = np.cos(angle), np.sin(angle)
    meridians = [np.stack([np.cos(m) * c, np.sin(m) * c, s], axis=1) for m in np.arange(6) * np.pi / 6]
    heights = np.radians(latitudes)
    return meridians, [np.stack([np.cos(h) * c, np.cos(h) * s, 0 * c + np.sin(h)], axis=1) for h in heights]


def _graticule(ax: Axes, view: Array, near: bool, ink: dict[str, str], zorder: int) -> None:
    meridians, parallels = graticule((-30, 0, 30), 91)
    lines = np.vstack([part for points in (*meridians, *parallels) for part in (points, [[np.nan] * 3])])
    _line(ax, lines, view, near, zorder, color=ink["grid"], lw=0.5, alpha=0.5 if near else 0.25)


def _area(ax: Axes, path: Array, view: Array, near: bool, ink: dict[str, str], zorder: int) -> None:
    """Fill what the path and the great circle back enclose: a fan from the start, in one piece, as `area.js` does."""
    a, ends = path[0], path[:: max(1, len(path) // RIBS)]
    ends = np.vstack([ends, path[-1:]])
    angle = np.arctan2(np.linalg.norm(cross(a, ends), axis=1), ends @ a)[:, None, None]
    side = ends - (ends @ a)[:, None] * a
    size = np.linalg.norm(side, axis=1, keepdims=True)
    side = np.divide(side, size, out=np.zeros_like(side), where=size > 1e-9)[:, None]
    parts = np.linspace(0, 1, 9)[None, :, None]
    ribs = np.cos(angle * parts) * a + np.sin(angle * parts) * side
    quads = np.stack([ribs[:-1, :-1], ribs[:-1, 1:], ribs[1:, 1:], ribs[1:, :-1]], axis=2).reshape(-1, 4, 3)
    seen = ((quads[:, 0] + quads[:, 2]) @ view[2] >= 0) == near
    _fill(ax, quads[seen] @ view[:2].T, zorder, fc=ink["twist"], alpha=0.24 if near else 0.12)


def _fill(ax: Axes, polygons: Array, zorder: int, **look: Any) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    if not len(polygons):
        return
    n, corners = polygons.shape[:2]
    closed = np.concatenate([polygons, polygons[:, :1]], axis=1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, *[Path.LINETO] * (corners - 1), Path.CLOSEPOLY], n)
    ax.add_artist(PathPatch(Path(closed, codes), zorder=zorder, **{"lw": 0} | look))  # the limits are known


def _ring(ax: Axes, frame: Array, psi: float, view: Array, near: bool, ink: dict[str, str], zorder: int) -> None:
    """Draw the ring that is fixed in the non-twisting frame, and on it the wedge of twist."""
    turned = np.fmod(psi, 2 * np.pi)
    for last, colour, alpha in ((2 * np.pi, ink["frame"], 0.18), (turned, ink["twist"], 0.85)):
        angle = np.linspace(0, last, max(2, round(abs(last) / (2 * np.pi) * 72) + 1))
        along = np.cos(angle)[:, None] * frame[0] + np.sin(angle)[:, None] * frame[1]
        _band(ax, along, RING, view, near, zorder, fc=colour, alpha=alpha)
        if last == 2 * np.pi:
            for radius in RING:
                _line(ax, radius * along, view, near, zorder, color=ink["frame"], lw=0.8)
    for d in frame:
        if (d @ view[2] >= 0) == near:
            ax.plot(*np.outer(view[:2] @ d, [0, RING[1]]), color=ink["frame"], lw=1.2, zorder=zorder)


def _wheel(ax: Axes, axis: Array, view: Array, near: bool, ink: dict[str, str], zorder: int) -> None:
    _band(ax, circle_about(axis, 91), WHEEL, view, near, zorder, fc=ink["rotor"], alpha=0.75 if near else 0.45)


def circle_about(axis: Array, count: int = 241) -> Array:
    """Return the great circle about a vector, (count, 3)."""
    t = np.linspace(0, 2 * np.pi, count)[:, None]
    a = np.linalg.svd(axis[None])[2][1:]
    return np.cos(t) * a[0] + np.sin(t) * a[1]


def _band(
    ax: Axes, along: Array, radii: tuple[float, float], view: Array, near: bool, zorder: int, **look: Any
) -> None:
    """Fill what is between two radii along unit vectors."""
    inner, outer = (radius * along for radius in radii)
    quads = np.stack([inner[:-1], outer[:-1], outer[1:], inner[1:]], axis=1)
    seen = (quads.mean(1) @ view[2] >= 0) == near
    _fill(ax, quads[seen] @ view[:2].T, zorder, **look)


def _arrow(ax: Axes, d: Array, length: float, view: Array, zorder: int, colour: str) -> None:
    tip = view[:2] @ (length * d)
    look = {"arrowstyle": "-|>,head_width=0.22,head_length=0.42", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (float(tip[0]), float(tip[1])), (0, 0), arrowprops=look, zorder=zorder)


def _box(ax: Axes, motion: Motion, triad: Array, view: Array, ink: dict[str, str]) -> None:
    edges = motion.edges @ triad
    for i in range(3):
        normal = edges[i] * np.where(edges[i] @ view[2] < 0, -1.0, 1.0)
        a, b = (motion.half[j] * edges[j] for j in ((i + 1) % 3, (i + 2) % 3))
        corners = motion.centre @ triad + motion.half[i] * normal + np.array([a + b, a - b, -a - b, b - a])
        shade = 0.25 + 0.3 * (1 - normal @ view[2])
        _fill(ax, corners[None] @ view[:2].T, 5, fc=ink["box"], alpha=min(0.75, 0.35 + float(shade) / 2))
        outline = np.vstack([corners, corners[:1]]) @ view[:2].T
        ax.plot(*outline.T, color=ink["card"], lw=0.8, alpha=0.8, zorder=5)


def _weight(ax: Axes, down: Array, centre: Array, view: Array, ink: dict[str, str]) -> None:
    """Draw the vertical, gravity, and the centre of mass, which is at `centre` on the picture, with its line."""
    from matplotlib.patches import Circle, Wedge

    below = view[:2] @ down
    ax.plot(*zip(-below, below, strict=True), color=ink["muted"], lw=0.9, ls=(0, (5, 3)), zorder=4)
    look: dict[str, Any] = {"arrowstyle": "-|>,head_width=0.2,head_length=0.4", "color": ink["ink"], "lw": 1.6}
    size = max(float(np.hypot(*below)), 1e-9)
    (x0, y0), (x1, y1), (x, y) = (CORNER + part * below for part in (-0.16, 0.16, 0.16 + 0.1 / size))
    ax.annotate("", (x1, y1), (x0, y0), arrowprops=look | {"shrinkA": 0, "shrinkB": 0}, zorder=12)
    ax.text(x, y, "g", ha="center", va="center", fontsize=9, fontweight="bold", color=ink["ink"], zorder=12)
    ax.plot(*zip((0, 0), centre, strict=True), color=ink["ink"], lw=1.4, zorder=5.5)
    ax.add_patch(Circle((0, 0), 0.025, fc=ink["ink"], lw=0, zorder=11))
    ax.add_patch(Circle(tuple(centre), 0.045, fc=ink["card"], ec=ink["ink"], lw=0.8, zorder=11))
    for first in (0, 180):
        ax.add_patch(Wedge(tuple(centre), 0.045, first, first + 90, fc=ink["ink"], lw=0, zorder=11))


def _dial(ax: Axes, psi: float, ink: dict[str, str]) -> None:
    """Draw the twist face on: what is carried without twist is upright, d1 stands at ψ to the left of it."""
    from matplotlib.patches import Circle, Wedge

    middle, radius, degrees = np.array(DIAL), 0.42, np.degrees(np.fmod(psi, 2 * np.pi))
    ax.add_patch(Circle(tuple(middle), radius, fc=ink["glass"], ec=ink["grid"], lw=0.8, zorder=12))
    first, last = sorted((90.0, 90.0 + degrees))
    ax.add_patch(Wedge(tuple(middle), 0.9 * radius, first, last, fc=ink["twist"], alpha=0.62, lw=0, zorder=13))
    hands = ((0, 0.97, "frame", 1.4), (psi + np.pi / 2, 0.6, "d2", 1.6), (psi, 0.86, "d1", 2.2))
    for angle, length, colour, width in hands:
        end = middle + length * radius * np.array([-np.sin(angle), np.cos(angle)])
        ax.plot(*zip(middle, end, strict=True), color=ink[colour], lw=width, solid_capstyle="round", zorder=14)
    words = f"ψ = {np.degrees(psi):.1f}°".replace("-0.0°", "0.0°").replace("-", "−")
    ax.text(middle[0], -0.62, words, color=ink["twist"], fontsize=10, fontweight="bold", ha="center")
    ax.text(middle[0], -0.78, "twist, face on", color=ink["muted"], fontsize=7.5, ha="center")


def _unpacked(text: str) -> Array:
    return np.frombuffer(base64.b64decode(text), "<f4").astype(float)
