"""What was judged while pictures came, what of it is kept, and how it is said and shown."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.marker_readings import ReadingSearch
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.capture.advice import field_share, summary_lines
from trinoc.capture.goal import hold_outline, outline_mm
from trinoc.capture.judgement import Judgement, judge, judge_unread, judgement_line
from trinoc.capture.shots import (
    Shot,
    advise_cameras,
    is_new_shot,
    list_own,
    shot_line,
    summarise_watch,
)
from trinoc.errors import InputError
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.serving.kept_shots import KeptShots
from trinoc.serving.pages import PageContent, serve_pages
from trinoc.serving.sources import Moment
from trinoc.serving.watching import REFRESH_S, WatchState, picture_page, thumbnail, watch_page

_LOOK_EVERY_S = 0.05
# Pictures of a camera in which other readings of the board are searched, until it shows one.
_SEARCHED = 20


class WatchSession:
    """Judges moments as they come.

    target : the board. kept : where shots are kept; None where nothing is.
    cameras : their names; ("",) for one without a name. say : takes lines for people.
    watched : what the page shows now.
    """

    def __init__(
        self,
        target: AbstractTarget,
        title: str,
        cameras: Sequence[str],
        kept: KeptShots | None,
        say: Callable[[str], None],
    ) -> None:
        self._target, self._say, self.kept = target, say, kept
        self.cameras = tuple(cameras)
        self.is_named = self.cameras != ("",)
        self.watched = WatchState(f"trinoc watch {title}", self.cameras)
        self._asked_at_s, self._has_last = -math.inf, False
        self._last: dict[str, np.ndarray | InputError] = {}
        self._search = ReadingSearch(target, most_images=_SEARCHED)

    @property
    def shots(self) -> tuple[Shot, ...]:
        """What was judged, in order."""
        return self.watched.shots

    @property
    def telling_shots(self) -> tuple[Shot, ...]:
        """Those that are kept, where shots are: the others show nothing that these do not."""
        if self.kept is None:
            return tuple(shot for shot in self.shots if shot.good)
        return tuple(shot for shot in self.shots if shot.kept)

    def look(self, moment: Moment, *, is_kept: bool = False) -> None:
        """Judge what the cameras saw, keep it where it shows something new, and say so.

        is_kept : whether it is a shot that an earlier run kept, under its name. Raises InputError
        where it cannot be kept.
        """
        judgements = {camera: self._judge(moment, camera) for camera in moment.pictures}
        # A picture that is written again takes the place of its former self.
        earlier = tuple(shot for shot in self.shots if shot.name != moment.name)
        self.watched = self.watched._replace(shots=earlier)
        telling = self.telling_shots
        shot = Shot(moment.name, judgements, moment.name if is_kept else "")
        if self.kept is not None and not is_kept and is_new_shot(telling, shot):
            shot = shot._replace(kept=self.kept.keep(moment, shot.good))
        advice = advise_cameras((*telling, shot), self.cameras)
        tone = "plain" if shot.good else "bad"
        self.watched = self.watched._replace(
            shots=(*earlier, shot), headline=advice.sentence, tone=tone
        )
        self._last |= moment.pictures
        outlines = {
            camera: hold_outline(goal, self._target.centres_mm, judgements[camera].size_px)
            for camera, goal in advice.goals.items()
            if camera in judgements and judgements[camera].size_px[0]
        }
        self._draw(outlines)
        line = shot_line(shot) if self.is_named else judgement_line(judgements[""])
        # The line of a lone camera says itself why its picture is not good.
        self._say(f"{line}\n  {advice.sentence}" if shot.good or self.is_named else line)

    def _draw(self, outlines: Mapping[str, Float[np.ndarray, "4 2"]]) -> None:
        """The last pictures, with the corners of the board where it is wanted next."""
        drawn = {}
        for camera, image in self._last.items():
            own = list_own(self.shots, camera)
            if isinstance(image, InputError) or not (own and own[-1].size_px[0]):
                drawn[camera] = b""
            else:
                drawn[camera] = thumbnail(image, own[-1], outlines.get(camera))
        self.watched = self.watched._replace(thumbnails=drawn, wanted=frozenset(outlines))

    def draw_next_shot(
        self, rig: Rig, cameras: Sequence[str], world_from_board: Float[np.ndarray, "3 4"]
    ) -> None:
        """Have the page show where these cameras of a rig would see the board if it stood so."""
        corners_mm = np.pad(outline_mm(self._target.centres_mm), ((0, 0), (0, 1)))
        places = Pose(world_from_board).transform_points(corners_mm)
        self._draw({name: np.stack([rig[name].project(p) for p in places]) for name in cameras})

    def _judge(self, moment: Moment, camera: str) -> Judgement:
        image = moment.pictures[camera]
        try:
            if isinstance(image, InputError):
                raise image
            return judge(moment.name, image, self._target, self._search, camera)
        except InputError as error:
            return judge_unread(moment.name, self._target, str(error))

    def announce(
        self,
        headline: str,
        details: Sequence[str] = (),
        *,
        tone: Literal["plain", "good", "bad"] = "plain",
        is_last: bool = False,
    ) -> None:
        """Have the page say this in place of what to do next."""
        self.watched = self.watched._replace(
            headline=headline, details=tuple(details), tone=tone, is_last=is_last
        )

    @contextlib.contextmanager
    def serve(self, port: int) -> Iterator[str]:
        """The address of the page, as long as the block runs. Raises InputError."""
        pages: dict[str, Callable[[], PageContent]] = {"/": self._page}
        for number in range(len(self.cameras)):
            pages[f"/{number}.jpg"] = partial(self._picture, number)
        with serve_pages(pages, port=port) as url:
            yield url

    def _picture(self, number: int) -> PageContent:
        return picture_page(self.watched, number)

    def _page(self) -> PageContent:
        watched = self.watched
        self._asked_at_s = time.monotonic()
        self._has_last = self._has_last or watched.is_last
        return watch_page(watched)

    def wait_for_reader(self) -> None:
        """Return when a browser that shows the page has its last state, or is gone."""
        with contextlib.suppress(KeyboardInterrupt):
            while not self._has_last and time.monotonic() < self._asked_at_s + 2 * REFRESH_S:
                time.sleep(_LOOK_EVERY_S)

    def summarise(self) -> str:
        """How it stands, for people."""
        if self.is_named:
            return "\n".join(summarise_watch(self.shots, self.cameras))
        return "\n".join(summary_lines(list_own(self.shots, "")))

    def record(self) -> dict[str, Any]:
        """How it stands, as JSON can hold it."""
        advice = advise_cameras(self.shots, self.cameras).sentence
        if not self.is_named:
            own = list_own(self.shots, "")
            pictures = [_record(judgement) for judgement in own]
            return {"pictures": pictures, "field": field_share(own), "next": advice}
        shots = [
            {
                "name": shot.name,
                "kept": shot.kept or None,
                "cameras": {name: _record(each) for name, each in shot.judgements.items()},
            }
            for shot in self.shots
        ]
        field = {name: field_share(list_own(self.shots, name)) for name in self.cameras}
        return {"shots": shots, "field": field, "next": advice}


def _record(judgement: Judgement) -> dict[str, Any]:
    return {
        "name": judgement.name,
        "good": judgement.good,
        "found": len(judgement.places_px),
        "of": judgement.of_places,
        "refusal": judgement.refusal,
        "faults": list(judgement.faults),
        "edges_px": _none_if_nan(judgement.blur_px),
        "saturated": _none_if_nan(judgement.exposure.saturated),
        "dark": _none_if_nan(judgement.exposure.dark),
        "lean": list(judgement.lean),
    }


def _none_if_nan(value: float) -> float | None:
    return value if value == value else None
