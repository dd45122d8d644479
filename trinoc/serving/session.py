"""One session of `trinoc watch`: evaluation, saving and display of images as they arrive."""

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
from trinoc.capture.goal import goal_outline_px, outline_mm
from trinoc.capture.image_quality import (
    ImageQuality,
    measure_quality,
    quality_line,
    unreadable_quality,
)
from trinoc.capture.shots import (
    Shot,
    advise_cameras,
    camera_qualities,
    is_new_shot,
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
# Number of a camera's images in which other readings of the board are tried before the first
# detection.
_SEARCHED = 20


class WatchSession:
    """Session in which the images of a board are evaluated as they arrive.

    Parameters
    ----------
    target : AbstractTarget
        The board.
    title : str
        Title of the page.
    cameras : sequence of str
        Camera names; ("",) for one unnamed camera.
    kept : KeptShots or None
        Folder of saved shots; None to save nothing.
    say : callable
        Function that receives lines of text for the user.
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
        """Evaluated shots, in order."""
        return self.watched.shots

    @property
    def informative_shots(self) -> tuple[Shot, ...]:
        """Shots that the calibration will use: the saved ones, or all with a good image if none is
        saved.
        """
        if self.kept is None:
            return tuple(shot for shot in self.shots if shot.good_cameras)
        return tuple(shot for shot in self.shots if shot.saved_name)

    def look(self, moment: Moment, *, is_kept: bool = False) -> None:
        """Evaluate the images of one moment, save them if they add information, and report the
        result.

        Raises InputError if the images cannot be saved.

        is_kept : True for a shot that an earlier run saved.
        """
        qualities = {camera: self._judge(moment, camera) for camera in moment.pictures}
        # A rewritten image replaces its earlier version.
        earlier = tuple(shot for shot in self.shots if shot.name != moment.name)
        self.watched = self.watched._replace(shots=earlier)
        informative = self.informative_shots
        shot = Shot(moment.name, qualities, moment.name if is_kept else "")
        if self.kept is not None and not is_kept and is_new_shot(informative, shot):
            shot = shot._replace(saved_name=self.kept.keep(moment, shot.good_cameras))
        advice = advise_cameras((*informative, shot), self.cameras)
        tone = "plain" if shot.good_cameras else "bad"
        self.watched = self.watched._replace(
            shots=(*earlier, shot), headline=advice.sentence, tone=tone
        )
        self._last |= moment.pictures
        outlines = {
            camera: goal_outline_px(goal, self._target.centres_mm, qualities[camera].size_px)
            for camera, goal in advice.goals.items()
            if camera in qualities and qualities[camera].size_px[0]
        }
        self._draw(outlines)
        line = shot_line(shot) if self.is_named else quality_line(qualities[""])
        # The line of a single camera already contains the fault.
        self._say(f"{line}\n  {advice.sentence}" if shot.good_cameras or self.is_named else line)

    def _draw(self, outlines: Mapping[str, Float[np.ndarray, "4 2"]]) -> None:
        """Update the thumbnails of the page. outlines : (4, 2) px, goal position of the board, by
        camera.
        """
        thumbnails = {}
        for camera, image in self._last.items():
            qualities = camera_qualities(self.shots, camera)
            if isinstance(image, InputError) or not (qualities and qualities[-1].size_px[0]):
                thumbnails[camera] = b""
            else:
                thumbnails[camera] = thumbnail(image, qualities[-1], outlines.get(camera))
        self.watched = self.watched._replace(thumbnails=thumbnails, wanted=frozenset(outlines))

    def draw_next_shot(
        self, rig: Rig, cameras: Sequence[str], world_from_board: Float[np.ndarray, "3 4"]
    ) -> None:
        """Draw the board at the pose of the recommended next shot into the last images of some
        cameras.

        world_from_board : (3, 4) pose of the board in the world of `rig`.
        """
        corners_mm = np.pad(outline_mm(self._target.centres_mm), ((0, 0), (0, 1)))
        corners_world_mm = Pose(world_from_board).transform_points(corners_mm)
        self._draw(
            {
                name: np.stack([rig[name].project(corner) for corner in corners_world_mm])
                for name in cameras
            }
        )

    def _judge(self, moment: Moment, camera: str) -> ImageQuality:
        image = moment.pictures[camera]
        try:
            if isinstance(image, InputError):
                raise image
            return measure_quality(moment.name, image, self._target, self._search, camera)
        except InputError as error:
            return unreadable_quality(moment.name, self._target, str(error))

    def announce(
        self,
        headline: str,
        details: Sequence[str] = (),
        *,
        tone: Literal["plain", "good", "bad"] = "plain",
        is_last: bool = False,
    ) -> None:
        """Show a headline and details on the page, where the advice was.

        tone : colour of the headline. is_last : True if the page will not change any more.
        """
        self.watched = self.watched._replace(
            headline=headline, details=tuple(details), tone=tone, is_last=is_last
        )

    @contextlib.contextmanager
    def serve(self, port: int) -> Iterator[str]:
        """Context manager that serves the page, and yields its address.

        Raises InputError if the port is in use.
        """
        pages: dict[str, Callable[[], PageContent]] = {"/": self._page}
        for number in range(len(self.cameras)):
            pages[f"/{number}.jpg"] = partial(self._picture, number)
        with serve_pages(pages, port=port) as url:
            yield url

    def _picture(self, number: int) -> PageContent:
        return picture_page(self.watched, number)

    def _page(self) -> PageContent:
        state = self.watched
        self._asked_at_s = time.monotonic()
        self._has_last = self._has_last or state.is_last
        return watch_page(state)

    def wait_for_reader(self) -> None:
        """Wait until the browser has loaded the last state of the page, or stopped refreshing."""
        with contextlib.suppress(KeyboardInterrupt):
            while not self._has_last and time.monotonic() < self._asked_at_s + 2 * REFRESH_S:
                time.sleep(_LOOK_EVERY_S)

    def summarise(self) -> str:
        """Return the summary of the session as text."""
        if self.is_named:
            return "\n".join(summarise_watch(self.shots, self.cameras))
        return "\n".join(summary_lines(camera_qualities(self.shots, "")))

    def record(self) -> dict[str, Any]:
        """Return the summary of the session as a JSON object."""
        advice = advise_cameras(self.shots, self.cameras).sentence
        if not self.is_named:
            qualities = camera_qualities(self.shots, "")
            pictures = [_record(quality) for quality in qualities]
            return {"pictures": pictures, "field": field_share(qualities), "next": advice}
        shots = [
            {
                "name": shot.name,
                "kept": shot.saved_name or None,
                "cameras": {name: _record(quality) for name, quality in shot.qualities.items()},
            }
            for shot in self.shots
        ]
        field = {name: field_share(camera_qualities(self.shots, name)) for name in self.cameras}
        return {"shots": shots, "field": field, "next": advice}


def _record(quality: ImageQuality) -> dict[str, Any]:
    return {
        "name": quality.name,
        "good": quality.is_good,
        "found": len(quality.points_px),
        "of": quality.point_count,
        "refusal": quality.refusal,
        "faults": list(quality.faults),
        "edges_px": _none_if_nan(quality.blur_px),
        "saturated": _none_if_nan(quality.exposure.saturated),
        "dark": _none_if_nan(quality.exposure.dark),
        "lean": list(quality.lean),
    }


def _none_if_nan(value: float) -> float | None:
    return value if value == value else None
