"""`view`: a page that animates the directors and the non-twisting frame.

The page is one HTML file without network access, which its security policy forbids. All is drawn on canvases by scripts
of its own: no library, no WebGL.
"""

from __future__ import annotations

import html
import os
import shutil
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from ..analysis.trajectory import Trajectory
from ..geometry.arrays import Dataset
from ..geometry.values import hinted, short_repr
from ..io.whole import written
from .content import as_script, contents
from .drawing import Motion, camera_of

__all__ = ["View", "view"]

SHARED = ("vectors.js", "theme.js", "globe.js", "sphere.js", "dial.js")  # with the playground
SCRIPTS = (*SHARED, "area.js", "motion.js", "charts.js", "curves.js", "viewer.js")


@dataclass(frozen=True)
class View:
    """A page that shows one or two runs; notebooks display it inline.

    Attributes
    ----------
    html : str
        The whole document.
    """

    html: str = field(repr=False)
    title: str

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write the page as one HTML file and return its path.

        Parameters
        ----------
        path : path
        force : bool
            Overwrite an existing file.

        Raises
        ------
        ValueError
            The name does not end in .html.
        FileExistsError
            The file exists, and `force` is not set.
        OSError
            The folder does not exist or cannot be written, or the disk is full; a partial file is removed.
        """
        path = Path(path)
        if path.suffix.lower() not in (".html", ".htm"):
            raise ValueError(
                f"a page is written to a file that ends in .html, got {path.name!r}; films and pictures: "
                "nontwist view RUN --gif FILE, --mp4 FILE, --png FILE"
            )
        with written(path, force=force) as file:
            file.write(self.html.encode())
        return path

    def open(self) -> Path:
        """Write the page to a new temporary folder, open it in a browser, and return its path."""
        folder = Path(tempfile.mkdtemp(prefix="nontwist-"))
        try:
            path = self.save(folder / "view.html")
        except OSError:
            shutil.rmtree(folder)
            raise
        webbrowser.open(path.as_uri())
        return path

    def _repr_html_(self) -> str:
        document, title = html.escape(self.html), html.escape(self.title)
        style = "width:100%;height:820px;border:1px solid #8884;border-radius:8px"
        return f'<iframe title="{title}" style="{style}" sandbox="allow-scripts" srcdoc="{document}"></iframe>'


@hinted
def view(
    run: Dataset | Trajectory | Any,
    other: Dataset | Trajectory | Any = None,
    *,
    title: str | None = None,
    labels: str | Sequence[str] | None = None,
) -> View:
    """Show a run or a recording, or two side by side, on an interactive page.

    The page animates the path of the axis on the unit sphere, a box with the inertia of the body, its triad, and a ring
    fixed in the non-twisting frame: the angle between triad and ring is the twist, which a dial shows along the axis.
    The swing-twist angle less the twist is the solid angle of the path, which is filled. A rotor is drawn as a wheel
    with an arrow, its momentum, gravity as an arrow g, with a line from the pivot to the centre of mass; the box hangs
    there if the run has the attributes `mass` and `centre_of_mass`, as those of run files have.

    Parameters
    ----------
    run, other : Dataset, Trajectory or motion
        A run of `simulate`, `integrate` or `open_run`; a result of `twist` for a recording with times; or any motion
        with times that `twist` accepts. It must have at least two states. At most 5000 states are shown, evenly spaced,
        and the page states how many; ``view(run.sel(time=slice(0, 10)))`` shows all states of a part.
    title : str, optional
        Title of the page; by default the title of the run file, or the labels.
    labels : str or two strings, optional
        What the runs are called; by default two runs have their titles, if these differ, or the names of the bodies, if
        these are equal with the names of the files.

    Returns
    -------
    View
        Displayed inline by notebooks. ``.save(path)`` writes one HTML file that works offline, of 60 to 500 kB, up to
        1 MB for two runs, ``.open()`` opens it in the browser, and ``.html`` is the document.

    Raises
    ------
    ValueError
        An argument is not a run or a motion of one body, or has only one state; the title is not a string; or the
        labels are not one string for each run.

    Examples
    --------
    >>> from nontwist import nontwisting, simulate, standard, view
    >>> how = {"t_end": 2, "material_angular_velocity": (0.1, 2, 0)}
    >>> page = view(simulate(nontwisting([3, 4, 5]), **how), simulate(standard([3, 4, 5]), **how))
    >>> page.title
    'non-twisting body and standard body'
    >>> page.save("two-bodies.html").name
    'two-bodies.html'
    """
    if isinstance(run, (dict, list, tuple)):
        raise ValueError(f"view accepts one run or two, view(a, b), not a {type(run).__name__}")
    if title is not None and not isinstance(title, str):
        raise ValueError(f"title must be a string, got {short_repr(title)}")
    shows = contents([run] if other is None else [run, other], labels)
    title = title or " and ".join(each["title"] or each["name"] for each in shows)
    camera = camera_of([Motion(data) for data in shows])
    seen = camera._asdict() | {"upright": camera.upright.tolist()}
    page = Template(own_text("viewer.html")).substitute(
        title=html.escape(title),
        style=own_text("common.css") + own_text("viewer.css"),
        content=as_script({"title": title, "runs": shows, "camera": seen}),
        script="\n".join(map(own_text, SCRIPTS)),
    )
    return View(page, title)


def own_text(name: str, package: str = __package__) -> str:
    """Return the text of a file beside the modules of a package."""
    return files(package).joinpath(name).read_text(encoding="utf-8")
