"""The page of `trinoc watch`: for this machine alone, one picture, nothing that names can do."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from tests.capture.made import camera, circles_picture, quality, rectangle
from tests.serving.asking import ask
from trinoc.capture.shots import Shot
from trinoc.errors import InputError
from trinoc.serving.pages import PageContent, serve_pages
from trinoc.serving.watching import (
    WatchState,
    picture_page,
    thumbnail,
    watch_page,
)

ALL = rectangle(0.01, 0.01, 0.99, 0.99)


LOST = quality(ALL[:0], refusal="No sheet was found.")


def page_of(*shots: Shot, **more: Any) -> str:
    return watch_page(WatchState("trinoc watch shots", shots=shots, **more)).content.decode()


def test_the_page_shows_the_last_picture_the_field_and_the_advice() -> None:
    first, last = quality(ALL, name="first.png"), LOST
    page = page_of(Shot("first.png", {"": first}), Shot("made.png", {"": last}))
    assert 'http-equiv="refresh"' in page
    assert "Take it again: No sheet was found." in page
    assert "100 percent of the field is covered" in page
    assert page.index("made.png") < page.index("first.png")
    assert "prefers-color-scheme: dark" in page
    assert "No picture yet" in watch_page(WatchState("empty")).content.decode()


def test_names_are_text() -> None:
    bad = "<script>alert(1)</script>&\"'.png"
    named = Shot(bad, {bad: quality(ALL, name=bad)})
    page = watch_page(WatchState(bad, (bad,), (named,))).content.decode()
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_the_thumbnail_is_a_small_jpeg_with_marks() -> None:
    picture = cv2.resize(circles_picture(camera(0.0, 60.0)), None, fx=4, fy=4)
    small = cv2.imdecode(
        np.frombuffer(thumbnail(picture, quality(4 * ALL)), np.uint8), cv2.IMREAD_COLOR
    )
    assert small is not None
    assert max(small.shape) == 720
    assert np.ptp(small.astype(int), axis=2).max() > 60
    watched = WatchState("a", ("left", "right"), thumbnails={"right": b"jpeg"})
    assert [picture_page(watched, k).content for k in range(2)] == [b"", b"jpeg"]


def test_where_the_board_is_wanted_is_drawn() -> None:
    picture = np.full((240, 320), 128, np.uint8)
    corners = np.array([[40.0, 40.0], [200.0, 40.0], [200.0, 160.0], [40.0, 160.0]])
    content = thumbnail(picture, quality(ALL[:0]), corners)
    drawn = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert drawn is not None
    colour = np.ptp(drawn.astype(int), axis=2) > 100
    assert colour[100, 36:45].any()
    assert colour[158:163, 120].any()
    assert not colour[60:140, 60:180].any()
    # The upper side of the board is the thick one.
    assert colour[35:46, 120].sum() > colour[155:166, 120].sum()


def test_several_cameras_have_a_picture_and_a_field_each() -> None:
    both = Shot("0.50 s", {"left": quality(ALL), "right": LOST}, saved_name="shot_0001")
    cameras = ("left", "right")
    page = page_of(both, cameras=cameras, thumbnails={"left": b"l", "right": b"r"})
    assert "<b>1</b> shots kept of 1 moments" in page
    assert "100 percent of the field of left is covered" in page
    assert "0 percent of the field of right is covered" in page
    assert 'src="/0.jpg' in page
    assert 'src="/1.jpg' in page


def test_the_last_page_says_how_it_ended_and_asks_for_nothing_more() -> None:
    both = Shot("0.50 s", {"left": quality(ALL)}, saved_name="shot_0001")
    page = page_of(
        both,
        cameras=("left",),
        thumbnails={"left": b"l"},
        headline="You can use this rig.",
        details=("written: rig.json",),
        is_last=True,
    )
    assert "You can use this rig." in page
    assert "written: rig.json" in page
    assert 'http-equiv="refresh"' not in page
    assert 'src="data:image/jpeg;base64,' in page


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
