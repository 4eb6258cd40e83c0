"""`.. picture:: NAME` shows a picture of the theory, drawn as the site is built, for a light and for a dark ground.

The content is its caption, the option `alt` its description. Everything on a sphere is computed: paths are runs or
closed forms, frames are carried by `nontwisting_frame`, areas are those that the paths enclose.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from nontwist import nontwisting, simulate, standard
from nontwist.curves import nontwisting_frame


class Ink(NamedTuple):
    """Colours on a ground."""

    text: str
    faint: str
    one: str
    two: str
    three: str


INKS = {
    "light": Ink("#1b1b1b", "#9a9a9a", "#0060a0", "#b34700", "#0b7a5a"),
    "dark": Ink("#e8e8e8", "#7d7d7d", "#6cbcf0", "#ffa05c", "#4fd0a5"),
}
VIEW = np.array([0.62, -0.62, 0.48])


class Globe:
    """The unit sphere seen from far away, on axes of Matplotlib."""

    def __init__(self, ax: Any, ink: Ink, view: Any = VIEW) -> None:
        v = np.asarray(view, float) / np.linalg.norm(view)
        right = np.cross((0, 0, 1), v)
        right /= np.linalg.norm(right)
        self.ax, self.ink, self.view, self.flat = ax, ink, v, np.stack([right, np.cross(v, right)])
        ax.set(aspect="equal", xlim=(-1.38, 1.38), ylim=(-1.28, 1.32))
        ax.axis("off")
        around = np.linspace(0, 2 * np.pi, 181)
        ax.fill(np.cos(around), np.sin(around), color=ink.faint, alpha=0.13, linewidth=0)
        ax.plot(np.cos(around), np.sin(around), color=ink.faint, linewidth=0.8)
        for u in np.linspace(0, np.pi, 7)[:-1]:
            self.line(circle((-np.sin(u), np.cos(u), 0), 0), ink.faint, width=0.35)
        for z in (-0.5, 0, 0.5):
            self.line(circle((0, 0, 1), z), ink.faint, width=0.35)

    def at(self, x: Any) -> Any:
        """Return where points of space are on the paper."""
        return np.asarray(x) @ self.flat.T

    def line(self, x: Any, colour: str, width: float = 1.6, style: str = "-") -> None:
        """Draw a curve on the sphere; what is behind it is faint."""
        p, front = self.at(x), np.asarray(x) @ self.view >= -1e-9
        for shown, alpha in ((front, 1.0), (~front, 0.25)):
            near = shown | np.roll(shown, 1) | np.roll(shown, -1)
            q = np.where(near[:, None], p, np.nan)
            self.ax.plot(*q.T, color=colour, linewidth=width, linestyle=style, alpha=alpha)

    def arrow(
        self, start: Any, along: Any, colour: str, label: str = "", width: float = 1.8, beyond: float = 1.18
    ) -> None:
        """Draw a vector from a point, with a name at its tip."""
        a, b = self.at(start), self.at(np.asarray(start) + along)
        how = {"color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
        self.ax.annotate("", b, a, arrowprops={"arrowstyle": "-|>", **how}, zorder=5)
        if label:
            self.ax.text(*(a + beyond * (b - a)), label, color=colour, ha="center", va="center", fontsize=10, zorder=6)


def circle(axis: Any, height: float, points: int = 181) -> Any:
    """Return the circle on the unit sphere round an axis, at a height along it."""
    n = np.asarray(axis, float) / np.linalg.norm(axis)
    a = np.cross(n, (1.0, 0, 0) if abs(n[0]) < 0.9 else (0, 1.0, 0))
    a /= np.linalg.norm(a)
    u = np.linspace(0, 2 * np.pi, points)[:, None]
    return height * n + np.sqrt(1 - height**2) * (np.cos(u) * a + np.sin(u) * np.cross(n, a))


def canvas(panels: int) -> Any:
    """Return a figure and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.3 * panels, 3.1), layout="constrained")
    axes = figure.subplots(1, panels, squeeze=False)[0]
    return figure, axes


def frame(ink: Ink) -> Any:
    """Draw a direction that moves, and the frame that it carries without twist."""
    figure, (ax,) = canvas(1)
    globe, u = Globe(ax, ink), np.linspace(0, 1, 201)
    longitude, latitude = -1.75 + 2.1 * u, 0.05 + 0.75 * np.sin(np.pi * u) ** 2 + 0.25 * np.sin(3 * np.pi * u)
    d3 = np.stack([np.cos(longitude) * np.cos(latitude), np.sin(longitude) * np.cos(latitude), np.sin(latitude)], 1)
    carried = nontwisting_frame(d3, (0, 0, 1))
    globe.line(d3, ink.text)
    for k in (0, 50, 100, 150, 200):
        first = k == 0
        globe.arrow(d3[k], 0.32 * carried[k, 0], ink.one, "$d_1$" if first else "")
        globe.arrow(d3[k], 0.32 * carried[k, 1], ink.two, "$d_2$" if first else "", beyond=1.25)
        globe.arrow(d3[k], 0.28 * d3[k], ink.text, "$d_3$" if k == 200 else "", width=1.2)
    return figure


def area(ink: Ink) -> Any:
    """Draw a frame that went round a closed path has turned by the area inside."""
    figure, (ax,) = canvas(1)
    globe, centre = Globe(ax, ink, (0.55, -0.55, 0.62)), np.array([0.45, -0.45, 0.77])
    d3 = circle(centre, np.cos(np.radians(38)), 361)
    inside = globe.at(d3)
    ax.fill(*inside.T, color=ink.three, alpha=0.28, linewidth=0)
    globe.line(d3, ink.text)
    ax.text(*globe.at(centre / np.linalg.norm(centre)), "Ω", color=ink.three, ha="center", va="center", fontsize=17)
    carried = nontwisting_frame(d3, d3[30] - d3[0])
    for k in range(40, 360, 40):
        globe.arrow(d3[k], 0.26 * carried[k, 0], ink.faint, width=1.0)
    globe.arrow(d3[0], 0.5 * carried[0, 0], ink.one, "before")
    globe.arrow(d3[0], 0.5 * carried[-1, 0], ink.two, "after", beyond=1.14)
    turned = np.arctan2(carried[-1, 0] @ carried[0, 1], carried[-1, 0] @ carried[0, 0])
    angle = np.linspace(0, turned, 40)[:, None]
    arc = d3[0] + 0.22 * (np.cos(angle) * carried[0, 0] + np.sin(angle) * carried[0, 1])
    ax.plot(*globe.at(arc).T, color=ink.three, linewidth=1.6)
    return figure


def bodies(ink: Ink) -> Any:
    """Draw the axes of two free bodies with the same inertia and the same start."""
    figure, axes = canvas(2)
    how = {"material_angular_velocity": (1.5, 4.5, 0), "tolerance": 1e-9, "times": np.linspace(0, 4, 801)}
    for ax, body, name, colour in (
        (axes[0], standard([3, 4, 5]), "standard body", ink.two),
        (axes[1], nontwisting([3, 4, 5]), "non-twisting body", ink.one),
    ):
        run, globe = simulate(body, t_end=4, **how), Globe(ax, ink)
        d = run.directors.values
        globe.line(d[:, :, 2], colour)
        globe.arrow(d[0, :, 2], 0.28 * d[0, :, 2], ink.text, "$d_3(0)$", width=1.2, beyond=1.3)
        ax.set_title(name, color=ink.text, fontsize=10)
    return figure


def momenta(ink: Ink) -> Any:
    """Draw the momentum of a body, split along the third director."""
    figure, (ax,) = canvas(1)
    globe = Globe(ax, ink)
    d3 = np.array([0.62, 0.30, 0.55]) / np.linalg.norm([0.62, 0.30, 0.55])
    e1, e2, _ = nontwisting_frame(d3[None], (0, 0, 1))[0]
    square = d3 + 0.55 * np.array([e1 + e2, e1 - e2, -e1 - e2, -e1 + e2])
    ax.fill(*globe.at(square).T, color=ink.faint, alpha=0.3, linewidth=0.8)
    across, along = 0.5 * (0.8 * e1 + 0.7 * e2), 0.42 * d3
    globe.arrow((0, 0, 0), d3, ink.faint, "$d_3$", width=1.2, beyond=0.55)
    globe.arrow(d3, across, ink.one, r"$\pi_\perp$", beyond=1.25)
    globe.arrow(d3, along, ink.two, r"$\pi_\parallel d_3$", beyond=1.3)
    globe.arrow(d3, across + along, ink.text, r"$\pi$", beyond=1.14)
    for corner in (across, along):
        edge = globe.at([d3 + corner, d3 + across + along])
        ax.plot(*edge.T, color=ink.faint, linewidth=0.9, linestyle=":")
    ax.text(*globe.at(square[2] + 0.08 * e2), "tangent plane", color=ink.text, fontsize=8, ha="center", va="top")
    return figure


def gauss(ink: Ink) -> Any:
    """Draw the momentum in the body by two schemes of order 4 with the same large step: one keeps its curve."""
    inertia, start, h, steps = np.array([3.0, 4.0, 5.0]), np.array([0.4, 2.0, 0.5]), 1.5, 40
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the step is coarse: that is the point
        how = {"step": h, "integrator": "gauss", "order": 4, "material_angular_velocity": start}
        run = simulate(standard(inertia), t_end=h * steps, **how)
    kept = run.material_momentum.values

    def rate(momentum: Any) -> Any:
        return np.cross(momentum, momentum / inertia)

    lost = [inertia * start]
    for _ in range(steps):
        y = lost[-1]
        a = rate(y)
        b = rate(y + h / 2 * a)
        c = rate(y + h / 2 * b)
        d = rate(y + h * c)
        lost.append(y + h / 6 * (a + 2 * b + 2 * c + d))
    figure, axes = canvas(2)
    globe, size = Globe(axes[0], ink, (0.75, -0.45, 0.5)), np.linalg.norm(lost[0])
    fine = simulate(standard(inertia), t_end=30, tolerance=1e-8, material_angular_velocity=start)
    globe.line(fine.material_momentum.values / size, ink.faint, width=1.2)
    for points, colour, sign in ((kept, ink.one, "o"), (np.array(lost), ink.two, "^")):
        front = points @ globe.view >= 0
        axes[0].plot(*globe.at(points[front] / size).T, sign, color=colour, markersize=3.2)
    axes[0].set_title("Π on its sphere", color=ink.text, fontsize=10)
    ax, t = axes[1], h * np.arange(steps + 1)
    for points, colour, sign, name in (
        (np.array(lost), ink.two, "^", "explicit Runge–Kutta"),
        (kept, ink.one, "o", "gauss"),
    ):
        energy = np.sum(points**2 / inertia, axis=1) / 2
        error = np.maximum(abs(energy / energy[0] - 1), 1e-17)
        ax.semilogy(t[1:], error[1:], sign + "-", color=colour, markersize=2.2, linewidth=0.7)
        ax.annotate(
            name, (t[-1], error[-1]), (-4, 12), textcoords="offset points", color=colour, ha="right", fontsize=8
        )
    ax.set_ylim(1e-17, 10)
    ax.set_facecolor("none")
    ax.set_xlabel("time (s)", color=ink.text)
    ax.set_title("relative error of the energy", color=ink.text, fontsize=10)
    ax.tick_params(colors=ink.text, labelsize=8, which="both")
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(ink.text)
    return figure


PICTURES: dict[str, Callable[[Ink], Any]] = {one.__name__: one for one in (frame, area, bodies, momenta, gauss)}


def draw(name: str, folder: Path) -> dict[str, Path]:
    """Draw a picture on both grounds; return where."""
    folder.mkdir(parents=True, exist_ok=True)
    places = {ground: folder / f"{name}-{ground}.svg" for ground in INKS}
    for ground, place in places.items():
        PICTURES[name](INKS[ground]).savefig(place, transparent=True, metadata={"Date": None})
    return places


class Picture(SphinxDirective):
    """Show a picture by its name."""

    required_arguments = 1
    has_content = True
    option_spec = {"alt": directives.unchanged_required}  # noqa: RUF012, as docutils has it

    def run(self) -> list[nodes.Node]:
        """Return one image for each ground, and the caption, which the theme hides with an image in a figure."""
        here = Path(self.env.doc2path(self.env.docname)).parent
        figure = nodes.container(classes=["picture"])
        for ground, place in draw(self.arguments[0], Path(self.env.doctreedir) / "pictures").items():
            uri = Path(os.path.relpath(place, here)).as_posix()
            figure += nodes.image(uri=uri, alt=self.options["alt"], classes=[f"only-{ground}", "theory-picture"])
        figure += nodes.paragraph("", "", *self.parse_inline(" ".join(self.content))[0], classes=["picture-caption"])
        self.set_source_info(figure)
        return [figure]


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the directive."""
    app.add_directive("picture", Picture)
    return {"parallel_read_safe": True}
