"""The site as readers see it: built without a warning, every page in a browser, wide and narrow, light and dark."""

import fcntl
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import quote, unquote, urldefrag, urlsplit

import pytest

from conftest import until

pytest.importorskip("sphinx")
pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
SCREENS = {"wide": (1440, 900, "light"), "narrow": (390, 844, "dark")}
GROUND = {"light": range(200, 256), "dark": range(60)}  # brightness of the page behind the text
LOOK = """() => {
    const visible = (e) => e.getClientRects().length > 0;
    const article = document.querySelector('article') || document.body;
    const words = article.cloneNode(true);
    words.querySelectorAll('pre, code, math, script, style, dt').forEach((e) => e.remove());
    return {
        width: document.documentElement.scrollWidth,
        wide: [...article.querySelectorAll('*')].filter(visible)
            .filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
            .filter((e) => !e.closest('pre, table, .math, .cell_output, .pst-scrollable-table-container'))
            .map((e) => e.tagName + ' ' + e.textContent.trim().slice(0, 40)),
        images: [...document.images].filter((i) => !i.naturalWidth).map((i) => i.src),
        unlabelled: [...article.querySelectorAll('img')]
            .filter((i) => !i.alt || i.alt.includes('_images/')).map((i) => i.src),
        formulas: [...article.querySelectorAll('math')].filter(visible).map((m) => {
            const box = m.getBoundingClientRect();
            return [m.textContent, box.width, box.height];
        }),
        words: words.textContent,
        links: [...document.links].map((a) => a.href),
        ids: [...document.querySelectorAll('[id]')].map((e) => e.id),
        ground: getComputedStyle(document.body).backgroundColor,
    };
}"""


NOISE = ("nontwist: loading ", "nontwist: compiling ")  # what a slow machine waits for


@pytest.fixture(scope="module")
def site(tmp_path_factory, worker_id):
    """Build the site once for all workers."""
    base = tmp_path_factory.getbasetemp()
    out = (base if worker_id == "master" else base.parent) / "site"
    out.mkdir(exist_ok=True)
    with (out / "lock").open("w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (out / "built").exists():
            options = ["-W", "--keep-going", "-q", "-j", "4", "-b", "html", "-d", out / "doctrees"]
            build = [sys.executable, "-m", "sphinx", *options, ROOT / "docs", out / "html"]
            done = subprocess.run(build, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            told = [line for line in done.stderr.splitlines() if not line.startswith(NOISE)]
            assert told == []
            (out / "built").touch()
    return out / "html"


def seen(browser, site):
    """Yield the name of every page, the screen, and what it shows there, asks for and complains of."""
    pages = sorted(path for path in site.rglob("*.html") if "_static" not in path.parts)
    for screen, (width, height, scheme) in SCREENS.items():
        size = {"width": width, "height": height}
        page, trouble = browser.new_page(offline=True, color_scheme=scheme, viewport=size), []
        page.on("console", lambda message, t=trouble: t.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error, t=trouble: t.append(str(error)))
        page.on("requestfailed", lambda request, t=trouble: t.append(f"no {request.url}"))
        page.on("request", lambda r, t=trouble: t.append(f"asks {r.url}") if r.url.startswith("http") else None)
        for path in pages:
            trouble.clear()
            page.goto(path.as_uri())
            yield path.relative_to(site).as_posix(), screen, page.evaluate(LOOK) | {"trouble": [*trouble]}
        page.close()


RAW = re.compile(r"\\frac|\\mathrm|\\Lambda|\$|[\^_]\{|\{(?:eval-rst|ref|doc)\}|```|\]\(|\*\*")


def faults(look, screen):
    """Yield what is wrong with a page on a screen, links left aside."""
    width, _, scheme = SCREENS[screen]
    if look["width"] > width:
        yield f"{look['width']} px wide on a screen of {width}"
    for what in ("wide", "trouble", "images", "unlabelled"):
        yield from (f"{what}: {one}" for one in look[what][:3])
    for text, *box in look["formulas"]:
        if "\\" in text or min(box) < 4:
            yield f"formula {text!r} is drawn {box} px large"
    yield from (f"raw {look['words'][sign.start() - 20 : sign.end() + 30]!r}" for sign in RAW.finditer(look["words"]))
    ground = [int(number) for number in look["ground"].strip("rgba()").split(",")[:3]]
    if sum(ground) // 3 not in GROUND[scheme]:
        yield f"ground {ground} in {scheme}"


def broken_links(site, pages):
    """Yield the links of pages that lead to no file, or to no place in it."""
    ids = {(site / name).as_uri(): look["ids"] for name, look in pages.items()}
    for name, link in ((name, link) for name, look in pages.items() for link in set(look["links"])):
        address, place = urldefrag(link)
        if urlsplit(address).scheme == "file" and not Path(unquote(urlsplit(address).path)).is_file():
            yield f"{name}: leads to no file {link}"
        elif address in ids and place and unquote(place) not in ids[address]:
            yield f"{name}: leads to no place {link}"


def test_every_page_on_every_screen(browser, site):
    pages, wrong = {}, []
    for name, screen, look in seen(browser, site):
        pages[name] = look
        wrong += [f"{name}, {screen}: {fault}" for fault in faults(look, screen)]
    wrong += broken_links(site, pages)
    assert {"index.html", "reference/commands.html", "search.html", "contributing/integrator.html"} <= pages.keys()
    assert sum(len(look["formulas"]) for look in pages.values()) > 70
    assert wrong == []


COMMON = {
    "reference/api/nontwist.curves.frame_of_curve": "frame_of_curve",
    "tutorials/tennis-racket": "tennis racket, Dzhanibekov, intermediate axis",
    "tutorials/pendulum": "pendulum, precession",
    "glossary": "gimbal, Bishop frame",
    "conventions": "attitude, quaternion, quaternion order, units",
    "howto/recordings": "Euler angles, IMU",
    "howto/satellites": "gravity gradient, detumbling, reaction wheel",
    "tutorials/twist": "swing-twist, swing twist",
    "howto/continue": "restart",
    "howto/forearm": "shoulder",
    "howto/matlab": "MATLAB",
    "howto/coming-from": "SciPy",
    "howto/accuracy": "tolerance",
    "tutorials/lesson": "lesson",
    "howto/curves": "DNA",
    "tutorials/sweeps": "Monte Carlo",
    "getting-started": "install",
}


def test_search(browser, site):
    page, firsts = browser.new_page(offline=True), {}
    expected = {words: name for name, several in COMMON.items() for words in several.split(", ")}
    for words in expected:
        page.goto(f"{(site / 'search.html').as_uri()}?q={quote(words)}")
        first = page.locator("#search-results li a").first
        first.wait_for()
        firsts[words] = first.get_attribute("href").partition(".html")[0]
    assert firsts == expected


def test_code_links_to_reference(site):
    cells, reference, theory = (
        (site / f"{name}.html").read_text(encoding="utf-8")
        for name in ("howto/satellites", "reference/api/nontwist.simulate", "theory/frame")
    )
    assert 'href="../reference/api/nontwist.simulate.html#nontwist.simulate"' in cells
    assert "../../_modules/nontwist/driver/runs.html#simulate" in reference
    assert theory.count('class="glossary-link') > 5
    pictures = {f"{name}-{scheme}.svg" for name in ("frame", "area") for scheme in GROUND}
    assert pictures <= set(re.findall(r"_images/([\w-]+\.svg)", theory))


def test_playground_on_first_page(browser, site):
    page = browser.new_page(offline=True, color_scheme="dark")
    page.goto((site / "index.html").as_uri())
    page.locator("iframe.playground").scroll_into_view_if_needed()
    inside = page.frame_locator("iframe.playground")
    inside.locator("#play.playing").wait_for()
    inside.get_by_role("button", name="Tennis racket").click()
    assert inside.locator("html").get_attribute("data-theme") == "dark"
    page.evaluate("document.documentElement.dataset.theme = 'light'")
    inside.locator("html[data-theme=light]").wait_for()

    def is_as_high_as_its_content():
        height, content = (
            one.bounding_box()["height"] for one in (page.locator("iframe.playground"), inside.locator("html"))
        )
        return content <= height <= content + 8

    until(page, is_as_high_as_its_content)
    page.close()
