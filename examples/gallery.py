"""Draw docs/gallery.md: every function of nontwist.plot, with the code that made the figure.

`python examples/gallery.py [FOLDER]` writes FOLDER/gallery.md and the pictures FOLDER/gallery/*.png (default: docs).
"""

import argparse
import inspect
import textwrap
from pathlib import Path

import numpy as np
from PIL import Image

from nontwist import compare, heavy_top, nontwisting, plot, pulse, simulate, standard
from nontwist.comparison import second_quotient
from nontwist.curves import closed_frame

inertia = [[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]]
load = pulse((-61.8125, -26.875, 0), start=0, end=1)
case3 = {"material_angular_velocity": (1.5, 4.5, 0), "load": load, "t_end": 5, "step": 0.005}
runs = {
    "non-twisting": simulate(nontwisting(inertia), integrator="energy-momentum", **case3),
    "standard": simulate(standard(inertia), integrator="energy-momentum", **case3),
}


def show_momenta():
    """After the load ends, the non-twisting body conserves its momentum in the body, the standard body in space."""
    left, right = plot.new_axes(columns=2, panels=2)
    plot.momenta(runs, left, frame="space")
    return plot.momenta(runs, right, frame="body")


def show_directors():
    """Each director by its components in space."""
    for director, ax in enumerate(plot.new_axes(columns=2, panels=3), start=1):
        plot.directors(runs["non-twisting"], ax, director=director)
    return ax


def show_path():
    """One turn of d3, with triads: left, a free non-twisting body (a great circle); right, a standard body."""
    left, right = plot.new_axes(columns=2, panels=2, height=3.6)
    free = {"t_end": 0.33, "material_angular_velocity": (6, -18, 0)}
    look = {"great_circle": True, "triads": 13}
    plot.path(simulate(nontwisting(inertia), **free), left, **look, azimuth=55)
    return plot.path(simulate(standard([2, 4, 5]), **free), right, **look, azimuth=-30)


def show_twist_angle():
    """Angle by which each body turned about its third director: the non-twisting body does not turn about it."""
    return plot.twist_angle(runs, degrees=True)


def show_energy():
    """Energies of a heavy top, released upright with little spin."""
    body = heavy_top([2, 2, 0.5], mass=1.5, centre_of_mass=[0, 0, 0.6])
    return plot.energy(simulate(body, t_end=6, material_angular_velocity=[1, 0, 2]))


def show_energy_drift():
    """Balance of energy and work: exact to round-off (grey line) for two integrators, to a tolerance for the third."""
    names = ("energy-momentum", "gauss", "continuous")
    return plot.energy_drift({name: simulate(nontwisting(inertia), integrator=name, **case3) for name in names})


def show_orthonormality():
    """Deviation of the directors from orthonormality."""
    return plot.orthonormality(runs)


def show_second_quotient():
    """For order 2, the quotient of the changes under halved steps tends to 4."""
    case1 = {"t_end": 5, "material_angular_velocity": (6, -18, 0), "integrator": "energy-momentum"}
    halved = [simulate(nontwisting(inertia), step=0.005 / k, **case1) for k in (1, 2, 4)]
    return plot.second_quotient(second_quotient(*halved))


def show_reaction_moment():
    """Moment that suppresses the twist."""
    return plot.reaction_moment(runs["non-twisting"])


def show_multipliers():
    """All multipliers of the director scheme."""
    return plot.multipliers(runs["non-twisting"])


def show_polhode():
    """Angular velocity on the inertia ellipsoid: a path round one of the stable axes, close to the separatrix."""
    body = standard([1, 2, 3])
    return plot.polhode(simulate(body, t_end=25, material_angular_velocity=[0.01, 2, 0.01]), azimuth=60)


def show_work_precision():
    """Run time of a free standard body over its largest error, for halved steps; a run without steps is a point."""
    schemes = [*(("gauss", order) for order in (2, 4, 8, 12)), "lie-midpoint", "energy-momentum", "exact"]
    start = {"t_end": 100, "material_angular_velocity": (6, -18, 1)}
    return plot.work_precision(compare(standard(inertia), integrators=schemes, **start))


t = 2 * np.pi * np.arange(800) / 800
circle = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
tangents = np.stack([-np.sin(t), np.cos(t), 0 * t], axis=1)
r = 2 + np.cos(3 * t)
trefoil = np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1)


def show_tube():
    """Tube along a trefoil: its stripes close, because the frames that sweep it do."""
    return plot.tube(trefoil, radius=0.45, elevation=60)


def show_ribbon():
    """Ribbon along a circle, with two full turns: its twist is 2, and the writhe of the circle is 0."""
    frames, _ = closed_frame(tangents, (0, 0, 1), turns=2, points=circle)
    return plot.ribbon(circle, frames[:, 0], elevation=40)


def show_dna_circle():
    """Relaxed circle of 210 base pairs of DNA: 20 turns of 10.5 base pairs each, so the strands have Lk = 20."""
    frames, _ = closed_frame(tangents, (0, 0, 1), turns=20, points=circle)
    return plot.ribbon(circle, frames[:, 0], width=0.19, elevation=40)


PAGE = """# Gallery

Every function of `nontwist.plot` draws one run, or several, in a dictionary with labels as keys. Colour
distinguishes components, line style runs; both are distinct in greyscale. A figure is one column wide
(89 mm) unless axes are given, as by `plot.new_axes(columns=2, panels=2)`; `with plot.style("springer"):` uses the type
of another journal. `plot.save(ax, "figure.pdf", "figure.png")` writes the figure.

`python examples/gallery.py` makes this page, with these runs:

```python
{runs}
```

The last figures use these curves:

```python
import numpy as np

{curves}
```

## Figures for slides

Settings of `matplotlib.rcParams` take precedence; `height=4.05` gives two columns the shape of 16:9.

```python
import matplotlib

large = {{"font.size": 16, "lines.linewidth": 2.5, "axes.linewidth": 1.2}}
with matplotlib.rc_context(large):
    (ax,) = plot.new_axes(columns=2, height=4.05)
    plot.momenta(runs, ax, frame="body")
    plot.save(ax, "slide.png")
```
"""
SECTION = """
## {name}

{caption}

![plot.{name}](gallery/{name}.png)

```python
{code}
```
"""


def main(folder):
    """Draw all figures and write the page that shows them."""
    (folder / "gallery").mkdir(parents=True, exist_ok=True)
    source = Path(__file__).read_text(encoding="utf-8")
    page = PAGE.format(
        runs=source[source.index("from nontwist") : source.index("def show")].strip(),
        curves=source[source.index("t = 2 *") : source.index("def show_tube")].strip(),
    )
    for function in [value for name, value in globals().items() if name.startswith("show_")]:
        name = function.__name__.removeprefix("show_")
        picture = folder / "gallery" / f"{name}.png"
        with plot.style():
            function().figure.savefig(picture, dpi=200)
        Image.open(picture).convert("RGB").quantize(128).save(picture, optimize=True)
        body = inspect.getsource(function).partition('"""\n')[2]
        code = textwrap.dedent(body).replace("return ", "").removesuffix("ax\n").strip()
        page += SECTION.format(name=name, caption=function.__doc__, code=code)
    (folder / "gallery.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[1] / "docs")
    main(parser.parse_args().folder)
