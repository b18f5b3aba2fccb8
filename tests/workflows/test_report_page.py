"""The report of a real run, and the page of a batch, in a real Chromium: on a phone and a desk, in light and dark."""

from pathlib import Path

import pytest
from e4dgs.workflows.batch.ledger import Ledger, SceneState
from e4dgs.workflows.batch.listing import Entry
from e4dgs.workflows.batch.summary import write_summary

SIZES = {"phone": (390, 844), "desk": (1440, 900)}
COMMAND = "e4dgs batch 'captures/*.mp4' --name tiny --preset fast --set coarse.iterations=300" + " --set fine.iterations=20" * 9
# The least contrast of a text with what lies behind it, of all texts that are seen; those over pictures are left out.
CONTRAST = """() => {
  const parts = text => { const n = text.match(/[\\d.]+/g).map(Number); return n.length < 4 ? [...n, 1] : n; };
  const light = c => [0.2126, 0.7152, 0.0722].reduce((sum, w, k) =>
    sum + w * (c[k] <= 10 ? c[k] / 255 / 12.92 : ((c[k] / 255 + 0.055) / 1.055) ** 2.4), 0);
  const behind = e => { for (; e; e = e.parentElement) { const c = parts(getComputedStyle(e).backgroundColor); if (c[3] > 0) return c; } };
  let worst = [21, ""];
  for (const e of document.querySelectorAll("body, body *")) {
    const text = [...e.childNodes].filter(n => n.nodeType === 3).map(n => n.textContent.trim()).join("");
    if (!text || !e.getClientRects().length || e.closest(".wipe, script")) continue;
    const style = getComputedStyle(e), ink = light(parts(e.closest("svg") ? style.fill : style.color)), paper = light(behind(e));
    const ratio = (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05);
    if (ratio < worst[0]) worst = [ratio, text];
  }
  return worst;
}"""

# Pictures of real captures are wider than those of the run here.
WIDE_PICTURES = """() => Promise.all([...document.images].map(image => {
  image.src = "data:image/svg+xml," + encodeURIComponent('<svg xmlns="http://www.w3.org/2000/svg" width="2000" height="1000"/>');
  return image.decode();
}))"""


@pytest.fixture(scope="module")
def pages(finished_run) -> dict[str, Path]:
    """The report of the run, and a batch of it and of a scene that failed."""
    _, workspace = finished_run
    report = next(workspace.glob("scenes/*/report.html"))
    entries = [Entry(report.parent.name, "/captures/tiny"), Entry("a-scene-with-a-rather-long-name", "/captures/none")]
    ledger = Ledger.create(workspace, "tiny", entries, COMMAND)
    ledger.write(entries[0].name, SceneState("done", seconds=3.0))
    ledger.write(entries[1].name, SceneState("failed", "frames", "/captures/none: there is no such file or folder; look at the path " * 3))
    return {"report": report, "batch": write_summary(ledger)}


@pytest.fixture
def opened(browser, pages):
    """Opens a page by its name; at the end nothing may have been said in the console, or asked of anything outside the file."""
    said: list[str] = []
    asked: list[str] = []
    shown = []

    def show(name: str, width: int = 1440, height: int = 900, scheme: str = "light"):
        page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(pages[name].as_uri())
        shown.append(page)
        return page

    yield show
    for page in shown:
        page.close()
    assert said == [] and asked
    files = {file.as_uri() for file in pages.values()}
    assert [url for url in asked if url not in files and not url.startswith(("data:", "blob:"))] == []


@pytest.mark.parametrize("name", ["report", "batch"])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_page_fits_and_can_be_read(opened, name, size, scheme):
    page = opened(name, *SIZES[size], scheme)
    page.evaluate("document.querySelectorAll('details').forEach(details => details.open = true)")
    page.evaluate(WIDE_PICTURES)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "nothing hangs over the side"
    ratio, text = page.evaluate(CONTRAST)
    assert 4.5 <= ratio < 21, f"{text!r} has a contrast of {ratio:.2f}"
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") == (scheme == "light")


def test_no_text_of_a_curve_is_cut(opened):
    page = opened("report")
    cut = """() => [...document.querySelectorAll("svg text")].filter(text => {
      const box = text.getBoundingClientRect(), frame = text.ownerSVGElement.getBoundingClientRect();
      return box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1 || box.bottom > frame.bottom + 1;
    }).map(text => text.textContent)"""
    assert page.evaluate("document.querySelectorAll('svg text').length") > 10 and page.evaluate(cut) == []


def test_the_slider_and_the_buttons_change_the_picture(opened):
    page = opened("report", 640, 700)
    wipe = page.locator("#wipe")

    def slide(share: float) -> bytes:
        wipe.scroll_into_view_if_needed()
        box = wipe.bounding_box()
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        return wipe.screenshot()

    render, half, truth = slide(0.001), slide(0.5), slide(0.999)
    assert len({render, half, truth}) == 3
    wipe.press("ArrowLeft")
    assert wipe.get_attribute("aria-valuenow") == "95" and wipe.screenshot() != truth
    slide(0.001)
    kinds = {"render": render}
    for kind in ("error", "edges", "depth"):
        page.locator(f"button[data-kind={kind}]").click()
        kinds[kind] = slide(0.001)
        assert page.locator("button.kind[aria-pressed=true]").get_attribute("data-kind") == kind
    assert len(set(kinds.values())) == len(kinds)
    page.locator("#following").click()
    assert slide(0.001) != kinds["depth"] and page.locator("#which").input_value() == "1"
    page.locator("figure.view").nth(2).locator("img").first.click()
    assert page.locator("#which").input_value() == "2"


def test_a_finger_moves_the_slider(browser, pages):
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(pages["report"].as_uri())
    wipe = page.locator("#wipe")
    wipe.scroll_into_view_if_needed()
    size = wipe.bounding_box()
    wipe.tap(position={"x": 0.25 * size["width"], "y": 0.5 * size["height"]})
    assert wipe.get_attribute("aria-valuenow") == "25"
    context.close()


def test_a_table_is_sorted_by_the_head_that_is_pressed(opened):
    page = opened("report")
    table = page.locator("div.scroll table").first
    for _ in range(2):
        table.locator("th", has_text="PSNR").first.click()
    shown = [float(text) for text in table.locator("tbody td:nth-child(3)").all_inner_texts()]
    assert shown == sorted(shown, reverse=True) and len(set(shown)) > 1


def test_the_movies_play(opened):
    page = opened("report")
    movies = page.locator("video")
    assert movies.count() == 2
    for k in range(2):
        movies.nth(k).scroll_into_view_if_needed()
        movie = movies.nth(k).element_handle()
        page.wait_for_function("video => video.readyState >= 2 && video.videoWidth > 0", arg=movie)
        began = movie.evaluate("async video => { await video.play(); return video.currentTime; }")
        page.wait_for_function("([video, began]) => video.currentTime !== began && !video.error", arg=[movie, began])


def test_a_batch_leads_to_its_reports_and_says_how_to_make_it_again(opened, pages):
    page = opened("batch", *SIZES["phone"])
    assert page.locator("pre").inner_text() == COMMAND
    page.locator("table a").first.click()
    page.wait_for_url(pages["report"].as_uri())
    assert page.locator("#compare").is_visible()
