"""The page in a browser: no log, no requests, and one highlight in all figures."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trinoc.calib import CalibrationResult
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.report import write_report

from .browser import chromium, needs_chromium
from .test_shots import made_up

pytestmark = needs_chromium

LIT = """return [...document.querySelectorAll('svg .stroke.lit')]
    .map((e) => [e.closest('section').id, e.closest('figure').querySelector('b').textContent,
                 e.dataset.track]);"""
_SCROLL = "arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})"
PIXELS = """const c = document.getElementById('space-figure');
    return [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data].reduce(
        (sum, value, k) => (sum * 31 + value * (k % 7 + 1)) % 1000003, 0);"""


@pytest.fixture(scope="module")
def browser(
    tmp_path_factory: pytest.TempPathFactory,
    result: CalibrationResult,
    sheet_pictures: dict[str, np.ndarray],
    segments: dict[str, Segments],
    matches: Matches,
    scene_pictures: dict[str, np.ndarray],
) -> Iterator[Any]:
    page = tmp_path_factory.mktemp("page") / "report.html"
    write_report(
        page,
        result=result,
        sheet_pictures=sheet_pictures,
        segments=segments,
        matches=matches,
        scene_pictures=scene_pictures,
    )
    with chromium() as driver:
        driver.get(page.as_uri())
        driver.page = page
        yield driver


def _metrics(driver: Any, width: int, *, mobile: bool = False) -> None:
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": mobile},
    )


def _point(driver: Any, selector: str) -> None:
    """Move the pointer over an element."""
    action = __import__("selenium.webdriver", fromlist=["ActionChains"]).ActionChains(driver)
    element = driver.find_element("css selector", selector)
    driver.execute_script(_SCROLL, element)
    action.move_to_element(element).perform()


def test_nothing_is_logged_or_fetched(browser: Any) -> None:
    assert browser.get_log("browser") == []
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    schemes = {
        event["params"]["request"]["url"].partition(":")[0]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    }
    assert schemes <= {"file", "data"}


def test_a_track_under_the_pointer_is_lit_everywhere(browser: Any, matches: Matches) -> None:
    track = int(np.flatnonzero(matches.stage == "trinocular")[3])
    before = browser.execute_script(PIXELS)
    _point(browser, f'#segments g[data-track="{track}"] .line')
    lit = browser.execute_script(LIT)
    assert {number for _, _, number in lit} == {str(track)}
    for section in ("segments", "matches"):
        assert {view for where, view, _ in lit if where == section} == set(matches.views)
    assert browser.execute_script(PIXELS) != before
    assert f"(track {track})" in browser.find_element("id", "readout").text
    _point(browser, "h1")
    assert browser.execute_script(LIT) == []
    assert browser.execute_script(PIXELS) == before


def test_the_figure_in_space_points_back(browser: Any) -> None:
    canvas = browser.find_element("id", "space-figure")
    browser.execute_script(_SCROLL, canvas)
    # Every place of a coarse grid: some lie on a segment.
    lit = browser.execute_script(
        """const [canvas] = arguments;
        const { left, top, width, height } = canvas.getBoundingClientRect();
        for (let y = 20; y < height; y += 4) for (let x = 20; x < width; x += 4) {
          canvas.dispatchEvent(new PointerEvent('pointermove',
            { clientX: left + x, clientY: top + y, bubbles: true }));
          const lit = document.querySelector('#segments .stroke.lit');
          if (lit) return [lit.dataset.track, document.getElementById('readout').textContent];
        } return null;""",
        canvas,
    )
    assert lit is not None
    assert lit[1].startswith(f"track {lit[0]}, ")
    _point(browser, "h1")


def test_keys_turn_the_figure_and_walk_through_the_segments(browser: Any) -> None:
    canvas = browser.find_element("id", "space-figure")
    _point(browser, "h1")
    canvas.send_keys("\ue00c", "0")  # escape: nothing is lit; the view as it began
    before = browser.execute_script(PIXELS)
    canvas.send_keys("\ue012")  # arrow left
    turned = browser.execute_script(PIXELS)
    assert turned != before
    canvas.send_keys("0")
    assert browser.execute_script(PIXELS) == before
    picture = browser.find_element("css selector", "#segments svg[tabindex]")
    picture.send_keys("\ue014")  # arrow right
    assert browser.find_element("id", "readout").text.startswith("segment 0 of upper")
    picture.send_keys("\ue014")
    assert browser.find_element("id", "readout").text.startswith("segment 1 of upper")


def test_a_slider_shows_one_height_at_a_time(browser: Any) -> None:
    script = """const block = document.querySelector('#field .levels');
        const input = block.querySelector('input');
        return [...Array(Number(input.max) + 1).keys()].map((at) => {
          input.value = at;
          input.dispatchEvent(new Event('input'));
          const levels = [...block.querySelectorAll('[data-said]')];
          return [levels.filter((e) => e.offsetHeight > 0).map((e) => e.dataset.said),
                  block.querySelector('output').textContent]; });"""
    shown_levels = browser.execute_script(script)
    assert len({height for _, height in shown_levels}) == len(shown_levels) > 5
    assert all(levels == [height] for levels, height in shown_levels)


def test_a_phone_shows_all_cameras_without_scrolling_sideways(browser: Any) -> None:
    _metrics(browser, 390, mobile=True)
    assert browser.execute_script("return document.documentElement.scrollWidth") == 390
    cells = browser.execute_script(
        "return [...document.querySelectorAll('.parameters td')]"
        ".map((e) => e.getBoundingClientRect()).map((r) => [r.left, r.right])"
    )
    assert min(left_px for left_px, _ in cells) >= 0
    assert max(right_px for _, right_px in cells) <= 390
    _metrics(browser, 1280)


def test_words_stand_out_from_their_ground_by_day_and_night(browser: Any) -> None:
    script = (Path(__file__).parent / "contrast.js").read_text(encoding="utf-8")
    for scheme in ("light", "dark"):
        browser.execute_cdp_cmd(
            "Emulation.setEmulatedMedia",
            {"features": [{"name": "prefers-color-scheme", "value": scheme}]},
        )
        grounds = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert grounds == {"light": "rgb(255, 255, 255)", "dark": "rgb(23, 24, 27)"}[scheme]
        weak = browser.execute_script(script)
        assert weak == [], scheme


def test_every_picture_has_words_and_every_control_a_name(browser: Any) -> None:
    nameless = browser.execute_script(
        """const shown = document.querySelectorAll('svg[role=img], canvas, button, input');
        return [...shown].filter((e) =>
          !(e.getAttribute('aria-label') || e.textContent.trim() || e.closest('label')));"""
    )
    assert nameless == []


def test_a_printed_table_is_whole(browser: Any, matches: Matches) -> None:
    browser.execute_script("document.querySelectorAll('details').forEach((e) => (e.open = true))")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": []})
    _metrics(browser, 688)  # A4 less its margins
    rows, cut = browser.execute_script(
        """const scroll = document.querySelector('.tracks').parentElement;
        return [document.querySelectorAll('.tracks tbody tr').length,
                [scroll.scrollHeight - scroll.clientHeight,
                 scroll.scrollWidth - scroll.clientWidth]];"""
    )
    assert rows == len(matches)
    assert max(cut) <= 1
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
    _metrics(browser, 1280)


def test_a_page_of_many_shots_fits_a_phone_and_paper(tmp_path: Path) -> None:
    page = tmp_path / "shots.html"
    write_report(page, result=made_up())
    with chromium() as driver:
        driver.get(page.as_uri())
        for width, media in ((390, "screen"), (688, "print")):
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
            _metrics(driver, width, mobile=media == "screen")
            assert driver.execute_script("return document.documentElement.scrollWidth") <= width
