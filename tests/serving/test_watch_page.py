"""The page of `trinoc watch`: for this machine alone, one picture, nothing that names can do."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from tests.capture.made import camera, circles_picture, judgement, rectangle
from tests.serving.asking import ask
from trinoc.errors import InputError
from trinoc.serving.pages import PageContent, serve_pages
from trinoc.serving.watching import (
    WatchState,
    picture_page,
    thumbnail,
    watch_page,
)

ALL = rectangle(0.01, 0.01, 0.99, 0.99)


def test_the_page_shows_the_last_picture_the_field_and_the_advice() -> None:
    shown = (judgement(ALL, name="first.png"), judgement(ALL[:0], refusal="No sheet was found."))
    page = watch_page(WatchState("trinoc watch shots", shown, b"")).content.decode()
    assert 'http-equiv="refresh"' in page
    assert "Take it again: No sheet was found." in page
    assert "100 percent of the field is covered" in page
    assert page.index("made.png") < page.index("first.png")
    assert "prefers-color-scheme: dark" in page
    assert "No picture yet" in watch_page(WatchState("empty")).content.decode()


def test_names_are_text() -> None:
    bad = "<script>alert(1)</script>&\"'.png"
    page = watch_page(WatchState(bad, (judgement(ALL, name=bad),))).content.decode()
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_the_thumbnail_is_a_small_jpeg_with_marks() -> None:
    picture = cv2.resize(circles_picture(camera(0.0, 60.0)), None, fx=4, fy=4)
    small = cv2.imdecode(
        np.frombuffer(thumbnail(picture, judgement(4 * ALL)), np.uint8), cv2.IMREAD_COLOR
    )
    assert small is not None
    assert max(small.shape) == 720
    assert np.ptp(small.astype(int), axis=2).max() > 60
    assert picture_page(WatchState("a", (), b"jpeg")).content == b"jpeg"


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serve_pages({"/": lambda: PageContent("text/plain", b"here")}) as running:
        yield running


def test_only_this_machines_own_pages_are_answered(url: str) -> None:
    assert ask(url) == (200, "here")
    assert ask(url, "/?2") == (200, "here")
    assert ask(url, Host="evil.example")[0] == 403
    assert ask(url, Origin="http://evil.example")[0] == 403


@pytest.mark.parametrize("path", ["/../pages.py", "/%2e%2e/pages.py", "//etc/passwd", "/x"])
def test_there_is_no_other_path(url: str, path: str) -> None:
    assert ask(url, path)[0] == 404


def test_a_port_that_is_taken_is_named(url: str) -> None:
    port = int(url.rstrip("/").rpartition(":")[2])
    for wrong in (port, 70000):
        with pytest.raises(InputError, match=f"Port {wrong} "), serve_pages({}, port=wrong):
            pass


def test_stopped_it_answers_no_more() -> None:
    with serve_pages({}) as url:
        pass
    with pytest.raises(ConnectionRefusedError):
        ask(url)
