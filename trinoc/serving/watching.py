"""Web page of `trinoc watch`: last images, goal positions of the board, covered fields."""

import base64
import zlib
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import cv2
import jinja2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.capture.advice import covered_cells, field_share
from trinoc.capture.image_quality import ImageQuality
from trinoc.capture.measures import GRID
from trinoc.capture.shots import Shot, advise_cameras, camera_qualities
from trinoc.image.grey import grey_image
from trinoc.serving.pages import PageContent

_LONGEST_SIDE_PX = 720
_MOST_ROWS = 40
REFRESH_S = 2
# Blue, green, red: good points, other points, goal outline, its dark border.
_GOOD, _BAD, _WANTED, _EDGE = (115, 158, 0), (0, 94, 213), (0, 200, 255), (30, 30, 30)

_TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("trinoc.serving"), autoescape=True, trim_blocks=True
)


class WatchState(NamedTuple):
    """Content of the page.

    Attributes
    ----------
    title : str
        Title.
    cameras : tuple of str
        Camera names; ("",) for one unnamed camera.
    shots : tuple of Shot
        Evaluated shots.
    thumbnails : mapping of bytes
        Last image of each camera, JPEG.
    wanted : frozenset of str
        Cameras whose thumbnail has the goal outline.
    headline : str
        Next step or result of the calibration; "" for the advice of the shots.
    details : tuple of str
        Sentences below the headline.
    tone : str
        "plain", "good" or "bad": colour of the headline.
    is_last : bool
        True if the page will not change, so that the browser stops refreshing.
    """

    title: str
    cameras: tuple[str, ...] = ("",)
    shots: tuple[Shot, ...] = ()
    thumbnails: Mapping[str, bytes] = {}
    wanted: frozenset[str] = frozenset()
    headline: str = ""
    details: tuple[str, ...] = ()
    tone: Literal["plain", "good", "bad"] = "plain"
    is_last: bool = False


def watch_page(state: WatchState) -> PageContent:
    """Return the page as HTML."""
    shots, last = state.shots, state.shots[-1] if state.shots else None
    html = _TEMPLATES.get_template("watch.html.j2").render(
        title=state.title,
        refresh_s=None if state.is_last else REFRESH_S,
        headline=state.headline or advise_cameras(shots, state.cameras).sentence,
        details=state.details,
        tone=state.tone if state.headline or last is None or last.good_cameras else "bad",
        views=[_view(state, number) for number in range(len(state.cameras))],
        rows=_rows(state),
        named=state.cameras != ("",),
        count=len(shots),
        kept=sum(bool(shot.saved_name) for shot in shots),
        good=sum(bool(shot.good_cameras) for shot in shots),
        grid=GRID,
    )
    return PageContent("text/html; charset=utf-8", html.encode("utf-8", errors="replace"))


def picture_page(state: WatchState, number: int) -> PageContent:
    """Return the last image of a camera as JPEG. number : index of the camera."""
    return PageContent("image/jpeg", state.thumbnails.get(state.cameras[number], b""))


def _view(state: WatchState, number: int) -> dict[str, Any]:
    """Values for the page's template about one camera: its last image and the covered part of its
    field.
    """
    camera = state.cameras[number]
    qualities = camera_qualities(state.shots, camera)
    last, cells = qualities[-1] if qualities else None, covered_cells(qualities)
    caption = "" if last is None else f"{last.name}, {last.size_px[0]} x {last.size_px[1]} px"
    if last is not None and not last.is_good:
        caption += ": " + (last.refusal or "; ".join(last.faults))
    return {
        "number": number,
        "camera": camera,
        "caption": caption,
        "wanted": camera in state.wanted,
        "name": "" if last is None else last.name,
        "image": _address(state, number),
        "share": field_share(qualities),
        "good": sum(quality.is_good for quality in qualities),
        "count": len(qualities),
        "cells": [(*divmod(k, GRID[1]), bool(cell)) for k, cell in enumerate(cells.flat)],
    }


def _address(state: WatchState, number: int) -> str:
    """Address of a camera's last image; the image itself as a data URI if the server is about to
    stop.
    """
    content = state.thumbnails.get(state.cameras[number])
    if not content:
        return ""
    if state.is_last:
        return f"data:image/jpeg;base64,{base64.b64encode(content).decode()}"
    return f"/{number}.jpg?{zlib.crc32(content)}"


def _rows(state: WatchState) -> list[tuple[Shot, str, ImageQuality]]:
    """Most recent images with their shot and camera name, newest first."""
    rows = [(shot, *item) for shot in state.shots[::-1] for item in shot.qualities.items()]
    return rows[:_MOST_ROWS]


def thumbnail(
    image: Shaped[np.ndarray, "..."],
    quality: ImageQuality | None = None,
    wanted_px: Float[np.ndarray, "4 2"] | None = None,
) -> bytes:
    """Return an image as a small JPEG with the detected points marked.

    wanted_px : (4, 2) corners of the goal outline, which is drawn with a thick upper side.
    """
    picture = grey_image(image)
    factor = min(1.0, _LONGEST_SIDE_PX / max(picture.size_px))
    small = cv2.resize(picture.as_8_bit(), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    colours = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    if quality is not None:
        for point in quality.points_px:
            mark = _GOOD if quality.is_good else _BAD
            cv2.circle(colours, _pixel(point, factor), 4, mark, 2, cv2.LINE_AA)
    if wanted_px is not None:
        corners = [_pixel(corner, factor) for corner in wanted_px]
        # A dark border keeps the outline visible on paper and on ink.
        for colour, extra_width in ((_EDGE, 4), (_WANTED, 0)):
            for k in range(4):
                width = extra_width + (9 if k == 0 else 2)
                cv2.line(colours, corners[k], corners[(k + 1) % 4], colour, width, cv2.LINE_AA)
    is_encoded, encoded = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return encoded.tobytes() if is_encoded else b""


def _pixel(point: Float[np.ndarray, "2"], factor: float) -> tuple[int, int]:
    return round(float(point[0]) * factor), round(float(point[1]) * factor)
