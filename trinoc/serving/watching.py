"""The page of `trinoc watch`: the last picture, the field so far, what to do next."""

from typing import NamedTuple

import cv2
import jinja2
import numpy as np
from jaxtyping import Shaped

from trinoc.capture.advice import field, field_share, next_step
from trinoc.capture.judgement import Judgement
from trinoc.capture.measures import GRID
from trinoc.image.grey import grey_image
from trinoc.serving.pages import PageContent

_LONGEST_SIDE_PX = 720
_MOST_ROWS = 40
REFRESH_S = 2

_TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("trinoc.serving"), autoescape=True, trim_blocks=True
)


class WatchState(NamedTuple):
    """All that the page shows. `thumbnail` is a JPEG, empty before the first picture."""

    title: str
    judgements: tuple[Judgement, ...] = ()
    thumbnail: bytes = b""


def watch_page(watched: WatchState) -> PageContent:
    """The page as HTML."""
    cells = field(watched.judgements)
    rows, columns = GRID
    html = _TEMPLATES.get_template("watch.html.j2").render(
        title=watched.title,
        refresh_s=REFRESH_S,
        next_step=next_step(watched.judgements),
        last=watched.judgements[-1] if watched.judgements else None,
        judgements=watched.judgements[-_MOST_ROWS:][::-1],
        count=len(watched.judgements),
        good=sum(judgement.good for judgement in watched.judgements),
        share=field_share(watched.judgements),
        cells=[(r, c, bool(cells[r, c])) for r in range(rows) for c in range(columns)],
        grid=GRID,
    )
    return PageContent("text/html; charset=utf-8", html.encode("utf-8", errors="replace"))


def picture_page(watched: WatchState) -> PageContent:
    """The last picture."""
    return PageContent("image/jpeg", watched.thumbnail)


def thumbnail(image: Shaped[np.ndarray, "..."], judgement: Judgement) -> bytes:
    """The picture as a small JPEG, with what was found of the board marked."""
    picture = grey_image(image)
    factor = min(1.0, _LONGEST_SIDE_PX / max(picture.size_px))
    small = cv2.resize(picture.as_8_bit(), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    colours = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    mark = (115, 158, 0) if judgement.good else (0, 94, 213)
    for place in judgement.places_px:
        at = (round(float(place[0]) * factor), round(float(place[1]) * factor))
        cv2.circle(colours, at, 4, mark, 2, cv2.LINE_AA)
    done, encoded = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return encoded.tobytes() if done else b""
