"""Take pictures of the pages in headless Chromium, for the README and the documentation.

`python examples/page_pictures.py [FOLDER]` writes into FOLDER (default: docs/images), light and dark, the playground
and the page of the code that stands beside its picture on the first page of the documentation. Each picture carries the
numbers that it shows, and that of the playground the code that its page gives for them, as texts in the file.
"""

import argparse
import contextlib
import re
import shutil
import tempfile
from io import BytesIO, StringIO
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from playwright.sync_api import sync_playwright

from nontwist.playground import playground

MOMENT = 1.8  # s


def take(browser, document, path, **options):
    """Open a document, and yield the tab before its picture is taken."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "page.html").write_text(document, encoding="utf-8")
        tab = browser.new_page(offline=True, reduced_motion="reduce", **options)
        tab.goto((Path(folder) / "page.html").as_uri())
        told = {}
        yield tab, told
        text = PngInfo()
        for name, words in told.items():
            text.add_itxt(name, words)
        Image.open(BytesIO(tab.screenshot())).convert("RGB").save(path, optimize=True, pnginfo=text)
        tab.close()


def page_of_the_first_page():
    """Run the code of docs/index.md, and return the page that it saves."""
    text = (Path(__file__).parents[1] / "docs" / "index.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), contextlib.redirect_stdout(StringIO()):
        for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            exec(code, {})
        return Path("view.html").read_text(encoding="utf-8")


def main(folder):
    """Take all pictures."""
    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        document = page_of_the_first_page()
        for scheme, end in (("light", ""), ("dark", "-dark")):
            size = {"color_scheme": scheme, "viewport": {"width": 1200, "height": 792}}
            for tab, told in take(browser, playground().html, folder / f"playground{end}.png", **size):
                tab.evaluate("world.advance(680); render()")
                told["code"] = tab.evaluate("asPython(world)")
                told["numbers"] = "\n".join(tab.locator(".turn").all_inner_texts())
            size["viewport"] = {"width": 1280, "height": 1290}
            for tab, told in take(browser, document, folder / f"view{end}.png", **size):
                tab.evaluate(f"setTime({MOMENT})")
                told["numbers"] = "\n".join(tab.locator(".turn, .part b, .place").all_inner_texts())
        browser.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[1] / "docs" / "images")
    main(parser.parse_args().folder)
