"""Take pictures of the pages in headless Chromium, for the README and the documentation.

`python examples/page_pictures.py [FOLDER]` writes into FOLDER (default: docs/images) the playground, light and dark,
and the page of the code that stands beside its picture on the first page of the documentation, wide and narrow.
"""

import argparse
import re
import shutil
import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from nontwist.playground import playground


def take(browser, document, path, **options):
    """Open a document, and yield the tab before its picture is taken."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "page.html").write_text(document, encoding="utf-8")
        tab = browser.new_page(offline=True, reduced_motion="reduce", **options)
        tab.goto((Path(folder) / "page.html").as_uri())
        yield tab
        Image.open(BytesIO(tab.screenshot())).convert("RGB").save(path, optimize=True)
        tab.close()


def page_of_the_first_page():
    """Run the code of docs/index.md, and return the page that it saves."""
    text = (Path(__file__).parents[1] / "docs" / "index.md").read_text(encoding="utf-8")
    code = next(code for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if '"view.html"' in code)
    with tempfile.TemporaryDirectory() as folder:
        exec(code.replace('"view.html"', "target"), {"target": Path(folder) / "view.html"})
        return (Path(folder) / "view.html").read_text(encoding="utf-8")


def main(folder):
    """Take all pictures."""
    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        for scheme, name in (("light", "playground.png"), ("dark", "playground-dark.png")):
            size = {"width": 1200, "height": 792}
            for tab in take(browser, playground().html, folder / name, viewport=size, color_scheme=scheme):
                tab.evaluate("world.advance(680); render()")
        document = page_of_the_first_page()
        wide, narrow = {"width": 1280, "height": 1290}, {"width": 390, "height": 844}
        for tab in take(browser, document, folder / "view-wide.png", viewport=wide):
            tab.evaluate("setTime(1.8)")
        for tab in take(browser, document, folder / "view-narrow.png", viewport=narrow):
            tab.evaluate("setTime(1.8)")
        browser.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[1] / "docs" / "images")
    main(parser.parse_args().folder)
