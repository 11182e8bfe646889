"""The report of a run in a real browser: from a file, without network, at three widths, in both
schemes. Run by `make test-browser`, in an environment of its own.

The page is that of the folder in ``UGV_REPORT``, ``runs/yard-workable`` without it. The browser is
Playwright's own, or the one that ``UGV_BROWSER`` names.
"""

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

playwright = pytest.importorskip("playwright.sync_api")
pytestmark = pytest.mark.browser

PAGE = Path(os.environ.get("UGV_REPORT", "runs/yard-workable")).resolve() / "report.html"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WIDTHS, SCHEMES = (420, 800, 1400), ("light", "dark")
#: Of a canvas, sampled at 120 x 120 pixels: the number of colours, a checksum, and the mean levels
#: of blocks of 10 x 10.
PIXELS = """canvas => {
  const copy = document.createElement("canvas");
  copy.width = 120; copy.height = 120;
  const c = copy.getContext("2d");
  c.drawImage(canvas, 0, 0, 120, 120);
  const bytes = c.getImageData(0, 0, 120, 120).data, seen = new Set();
  const blocks = new Array(12 * 12 * 4).fill(0);
  let sum = 0;
  for (let i = 0; i < bytes.length; i += 4) {
    seen.add((bytes[i] << 24) | (bytes[i + 1] << 16) | (bytes[i + 2] << 8) | bytes[i + 3]);
    const x = (i / 4) % 120, y = Math.floor(i / 480);
    for (let k = 0; k < 4; k++) {
      sum = (31 * sum + bytes[i + k]) % 1e9;
      blocks[4 * (12 * Math.floor(y / 10) + Math.floor(x / 10)) + k] += bytes[i + k] / 100;
    }
  }
  return [seen.size, sum, blocks];
}"""
#: Levels of 255, mean of a block of a hundred pixels, by which Chromium draws the same chart in
#: another way: one or two pixels of it.
NOISE = 6.0


def alike(a: list[Any], b: list[Any]) -> bool:
    """Whether two charts look the same."""
    return max(abs(p - q) for p, q in zip(a[2], b[2], strict=True)) < NOISE


@pytest.fixture(scope="module")
def browser() -> Iterator["playwright.Browser"]:
    with playwright.sync_playwright() as running:
        made = running.chromium.launch(
            executable_path=os.environ.get("UGV_BROWSER"), args=FLAGS, timeout=60_000
        )
        yield made
        made.close()


@pytest.fixture(
    scope="module",
    params=[(width, scheme) for width in WIDTHS for scheme in SCHEMES],
    ids=lambda p: f"{p[0]}-{p[1]}",
)
def page(request: pytest.FixtureRequest, browser: "playwright.Browser") -> Iterator["Opened"]:
    width, scheme = request.param
    context = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True
    )
    made = Opened(context.new_page(), width, scheme)
    yield made
    context.close()


class Opened:
    """The page with what its console said, and what it asked the network for."""

    def __init__(self, page: "playwright.Page", width: int, scheme: str) -> None:
        self.page, self.width, self.scheme = page, width, scheme
        self.errors: list[str] = []
        self.requests: list[str] = []
        page.set_default_timeout(60_000)
        page.on("console", self._said)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        page.goto(PAGE.as_uri())
        page.wait_for_selector("#scene-3d[data-drawn]")

    def _said(self, message: "playwright.ConsoleMessage") -> None:
        if message.type == "error":
            self.errors.append(message.text)

    def pixels(self, selector: str) -> list[Any]:
        """What a canvas shows."""
        found: list[Any] = self.page.locator(selector).first.evaluate(PIXELS)
        return found


def test_nothing_is_fetched_and_no_error_is_said(page: Opened) -> None:
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert page.requests[0] == PAGE.as_uri()
    assert len([url for url in page.requests if url.startswith("file:")]) == 1


def test_the_page_is_no_wider_than_the_window(page: Opened) -> None:
    assert page.page.evaluate("document.documentElement.scrollWidth") <= page.width
    outside = page.page.evaluate(
        """[...document.querySelectorAll("h1,h2,h3,p,dd,figcaption,button,.plot")]
        .filter((e) => e.offsetParent && e.getBoundingClientRect().right > innerWidth + 1)
        .map((e) => e.textContent.slice(0, 60))"""
    )
    assert outside == []


def test_the_scheme_is_the_one_asked_for(page: Opened) -> None:
    """Ink on ground has a contrast of 7 and more, soft ink of 4.5 and more (WCAG 2.2)."""
    colours = page.page.evaluate(
        """["ink", "soft", "ground"].map((name) =>
        getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim())"""
    )
    ink, soft, ground = (_luminance(colour) for colour in colours)
    assert (ground > ink) == (page.scheme == "light")
    assert _contrast(ink, ground) >= 7
    assert _contrast(soft, ground) >= 4.5


def _luminance(colour: str) -> float:
    digits = colour.lstrip("#")
    if len(digits) == 3:
        digits = "".join(2 * d for d in digits)
    parts = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _contrast(a: float, b: float) -> float:
    return (max(a, b) + 0.05) / (min(a, b) + 0.05)


def test_the_scene_is_drawn_and_turns(page: Opened) -> None:
    """By keys and by the pointer; the view from above is another one."""
    before = page.pixels("#scene-3d")
    assert before[0] > 20
    canvas = page.page.locator("#scene-3d")
    canvas.scroll_into_view_if_needed()
    canvas.focus()
    page.page.keyboard.press("ArrowLeft")
    turned = page.pixels("#scene-3d")
    assert turned != before
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 60, y + 20, steps=4)
    page.page.mouse.up()
    dragged = page.pixels("#scene-3d")
    assert dragged != turned
    page.page.click('[data-look="top"]')
    assert page.pixels("#scene-3d") != dragged
    page.page.click('[data-look="reset"]')
    assert page.pixels("#scene-3d") == before


def test_parts_of_the_scene_are_switched(page: Opened) -> None:
    """Each switch changes what is drawn, says so, and leads back."""
    buttons = page.page.locator("[data-part]:visible")
    assert buttons.count() >= 5
    for i in range(buttons.count()):
        before, button = page.pixels("#scene-3d"), buttons.nth(i)
        pressed = button.get_attribute("aria-pressed")
        button.click()
        assert button.get_attribute("aria-pressed") != pressed
        assert page.pixels("#scene-3d") != before, button.text_content()
        button.click()
        assert page.pixels("#scene-3d") == before, button.text_content()


def test_every_chart_is_drawn(page: Opened) -> None:
    names = page.page.evaluate("Object.keys(window.twinPage.charts)")
    shown = [n for n in names if page.page.locator(f'[data-chart="{n}"]').is_visible()]
    assert len(shown) >= 10
    for name in shown:
        # A picture without any light is black; of axes and marks there are more colours.
        assert page.pixels(f'[data-chart="{name}"] .plot canvas')[0] >= 2, name


def test_marks_of_a_chart_are_switched_and_zoomed(page: Opened) -> None:
    """The range-Doppler map: its legend, its buttons, its keys."""
    canvas = '[data-chart="map-0"] .plot canvas'
    toggle = page.page.locator('[data-chart="map-0"] .legend button', has_text="detection")
    before = page.pixels(canvas)
    toggle.click()
    assert toggle.get_attribute("aria-pressed") == "false"
    assert not alike(page.pixels(canvas), before)
    toggle.click()
    assert alike(page.pixels(canvas), before)
    page.page.locator(canvas).focus()
    page.page.keyboard.press("+")
    assert not alike(page.pixels(canvas), before)
    page.page.keyboard.press("0")
    assert alike(page.pixels(canvas), before)
    nearer = page.page.locator('[data-chart="map-0"] [data-act="in"]')
    nearer.click()
    assert not alike(page.pixels(canvas), before)
    page.page.locator('[data-chart="map-0"] [data-act="all"]').click()
    assert alike(page.pixels(canvas), before)


def test_no_table_is_cut_off(page: Opened) -> None:
    """On a narrow page a row becomes a block: nothing of it lies beyond the page's edge."""
    page.page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    cut = page.page.evaluate(
        """[...document.querySelectorAll(".table")]
        .filter((e) => e.scrollWidth > e.clientWidth + 1).map((e) => e.textContent.slice(0, 60))"""
    )
    assert cut == []


def test_labels_of_charts_cover_neither_each_other_nor_the_edge(page: Opened) -> None:
    """Five targets have theirs in the map, in the plan and in the picture, at every width."""
    drawn = page.page.evaluate(
        """Object.entries(window.twinPage.charts_drawn).filter(([, c]) => c.placed)
        .map(([name, c]) => [name, c.canvas.clientWidth,
                             c.placed.map((l) => [l.text, l.left, l.middle, l.width])])"""
    )
    texts = {name: [label[0] for label in labels] for name, _, labels in drawn}
    for name in ("map-0", "plan-0", "image-0"):
        assert len(texts[name]) == 5, name
    for name, width, labels in drawn:
        for i, (text, left, middle, wide) in enumerate(labels):
            assert 0 <= left <= left + wide <= width, (name, text)
            for other, start, at, size in labels[:i]:
                apart = left + wide <= start or start + size <= left or abs(middle - at) >= 12
                assert apart, (name, text, other)


def test_a_plan_on_a_narrow_page_has_what_is_ahead_up(page: Opened) -> None:
    name = page.page.evaluate("window.twinPage.charts_drawn['plan-0'].spec.y.name")
    assert name == ("x (m)" if page.width == 420 else "y (m)")


def test_one_picture_is_shown_at_a_time(page: Opened) -> None:
    buttons = page.page.locator("[data-shows]")
    assert buttons.count() >= 2
    for i in range(buttons.count()):
        buttons.nth(i).click()
        boxes = [b.get_attribute("data-shows") for b in buttons.all()]
        visible = [b for b in boxes if page.page.locator(f"#{b}").is_visible()]
        assert visible == [boxes[i]]
    buttons.nth(0).click()


def test_all_of_it_is_reached_by_keys_and_told_in_words(page: Opened) -> None:
    """Every canvas has a name and the focus; every button a name; every link a place."""
    lacking = page.page.evaluate(
        """[...document.querySelectorAll(".plot canvas, #scene-3d")]
        .filter((e) => e.tabIndex !== 0 || !e.getAttribute("aria-label")).length"""
    )
    assert lacking == 0
    nameless = page.page.evaluate(
        """[...document.querySelectorAll("button")]
        .filter((e) => !(e.textContent.trim() || e.getAttribute("aria-label"))).length"""
    )
    assert nameless == 0
    dead = page.page.evaluate(
        """[...document.querySelectorAll("a[href^='#']")].map((a) => a.getAttribute("href"))
        .filter((h) => !document.querySelector(h))"""
    )
    assert dead == []


def test_on_paper_it_is_black_on_white_without_switches(page: Opened) -> None:
    page.page.emulate_media(media="print")
    ground = page.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert re.fullmatch(r"rgb\(255, 255, 255\)", ground)
    assert not page.page.locator("nav").is_visible()
    assert not page.page.locator('[data-look="top"]').is_visible()
    page.page.emulate_media(media="screen")


def test_the_summary_has_the_verdicts_of_the_page(page: Opened) -> None:
    summary = json.loads(PAGE.with_name("summary.json").read_text())
    shown = page.page.locator(".verdicts article").all_text_contents()
    assert len(shown) == len(summary["findings"])
    for finding, text in zip(summary["findings"], shown, strict=True):
        assert finding["result"] in text
        assert all(answer in text for answer in finding["answers"].values())


def test_no_error_was_said_in_the_end(page: Opened) -> None:
    assert page.errors == []
