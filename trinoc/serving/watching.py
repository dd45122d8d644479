"""The page of `trinoc watch`: last pictures, where the board is wanted, the fields so far."""

import base64
import zlib
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import cv2
import jinja2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.capture.advice import field, field_share
from trinoc.capture.judgement import Judgement
from trinoc.capture.measures import GRID
from trinoc.capture.shots import Shot, advise_cameras, list_own
from trinoc.image.grey import grey_image
from trinoc.serving.pages import PageContent

_LONGEST_SIDE_PX = 720
_MOST_ROWS = 40
REFRESH_S = 2
# Blue, green, red: of places that are good, of others, and of where the board is wanted.
_GOOD, _BAD, _WANTED, _EDGE = (115, 158, 0), (0, 94, 213), (0, 200, 255), (30, 30, 30)

_TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("trinoc.serving"), autoescape=True, trim_blocks=True
)


class WatchState(NamedTuple):
    """All that the page shows.

    Fields
    ------
    title : what is watched.
    cameras : their names; of one camera "" may stand for its name.
    shots : what was judged so far.
    thumbnails : of cameras, their last picture as a JPEG.
    wanted : cameras over whose picture it is drawn where the board is wanted next.
    headline : what to do next, or how the calibration came out; "" for what the shots call for.
    details : sentences below it.
    tone : of the headline, whether it is good or bad news.
    is_last : whether the page changes no more, so that nobody asks for it again.
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


def watch_page(watched: WatchState) -> PageContent:
    """The page as HTML."""
    shots, last = watched.shots, watched.shots[-1] if watched.shots else None
    html = _TEMPLATES.get_template("watch.html.j2").render(
        title=watched.title,
        refresh_s=None if watched.is_last else REFRESH_S,
        headline=watched.headline or advise_cameras(shots, watched.cameras).sentence,
        details=watched.details,
        tone=watched.tone if watched.headline or last is None or last.good else "bad",
        views=[_view(watched, number) for number in range(len(watched.cameras))],
        rows=_rows(watched),
        named=watched.cameras != ("",),
        count=len(shots),
        kept=sum(bool(shot.kept) for shot in shots),
        good=sum(bool(shot.good) for shot in shots),
        grid=GRID,
    )
    return PageContent("text/html; charset=utf-8", html.encode("utf-8", errors="replace"))


def picture_page(watched: WatchState, number: int) -> PageContent:
    """The last picture of a camera."""
    return PageContent("image/jpeg", watched.thumbnails.get(watched.cameras[number], b""))


def _view(watched: WatchState, number: int) -> dict[str, Any]:
    """What a camera saw: its last picture and its field."""
    camera = watched.cameras[number]
    own = list_own(watched.shots, camera)
    last, cells = own[-1] if own else None, field(own)
    caption = "" if last is None else f"{last.name}, {last.size_px[0]} x {last.size_px[1]} px"
    if last is not None and not last.good:
        caption += ": " + (last.refusal or "; ".join(last.faults))
    return {
        "number": number,
        "camera": camera,
        "caption": caption,
        "wanted": camera in watched.wanted,
        "name": "" if last is None else last.name,
        "image": _address(watched, number),
        "share": field_share(own),
        "good": sum(judgement.good for judgement in own),
        "count": len(own),
        "cells": [(*divmod(k, GRID[1]), bool(cell)) for k, cell in enumerate(cells.flat)],
    }


def _address(watched: WatchState, number: int) -> str:
    """Where the picture of a camera is; in the page itself when nobody serves it any more."""
    content = watched.thumbnails.get(watched.cameras[number])
    if not content:
        return ""
    if watched.is_last:
        return f"data:image/jpeg;base64,{base64.b64encode(content).decode()}"
    return f"/{number}.jpg?{zlib.crc32(content)}"


def _rows(watched: WatchState) -> list[tuple[Shot, str, Judgement]]:
    """The pictures judged last, the last one first."""
    rows = [(shot, *each) for shot in watched.shots[::-1] for each in shot.judgements.items()]
    return rows[:_MOST_ROWS]


def thumbnail(
    image: Shaped[np.ndarray, "..."],
    judgement: Judgement | None = None,
    wanted_px: Float[np.ndarray, "4 2"] | None = None,
) -> bytes:
    """The picture as a small JPEG, with what was found of the board marked.

    wanted_px : the corners of the board where it is wanted next, drawn with its upper side thick.
    """
    picture = grey_image(image)
    factor = min(1.0, _LONGEST_SIDE_PX / max(picture.size_px))
    small = cv2.resize(picture.as_8_bit(), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    colours = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    if judgement is not None:
        for place in judgement.places_px:
            mark = _GOOD if judgement.good else _BAD
            cv2.circle(colours, _pixel(place, factor), 4, mark, 2, cv2.LINE_AA)
    if wanted_px is not None:
        corners = [_pixel(corner, factor) for corner in wanted_px]
        # A dark edge, so that it is seen on paper as well as on ink.
        for colour, more in ((_EDGE, 4), (_WANTED, 0)):
            for k in range(4):
                width = more + (9 if k == 0 else 2)
                cv2.line(colours, corners[k], corners[(k + 1) % 4], colour, width, cv2.LINE_AA)
    done, encoded = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return encoded.tobytes() if done else b""


def _pixel(place: Float[np.ndarray, "2"], factor: float) -> tuple[int, int]:
    return round(float(place[0]) * factor), round(float(place[1]) * factor)
