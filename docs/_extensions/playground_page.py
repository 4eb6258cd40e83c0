"""The playground as a page of the site: written when the site is built, shown on the first page."""

from pathlib import Path

from sphinx.application import Sphinx

from nontwist.playground import playground


def write(app: Sphinx, exception: Exception | None) -> None:
    """Write the page beside the others."""
    if exception is None and app.builder.format == "html":
        playground().save(Path(app.outdir) / "playground.html", force=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page at the end."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True}
