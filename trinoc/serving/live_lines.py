"""Lines of the scene that cameras of a rig see now, matched and drawn over their pictures."""

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import cv2
import numpy as np

from trinoc.errors import MatchError
from trinoc.geometry.rig import Rig
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import MatchStatus
from trinoc.report.space_content import PALETTE, distinct_neighbours
from trinoc.segments.find import find_segments
from trinoc.serving.sources import Moment, watch_cameras
from trinoc.serving.watching import encode_jpeg, shrink_picture

# The cameras' own waiting frames are let go in this time, before each match.
LIVE_S = 0.1
# numerical: where a fraction of a pixel counts in OpenCV's drawing, as 1 / 2**4.
_SHIFT = 4


class LiveLines(NamedTuple):
    """What was matched at one moment.

    Fields
    ------
    thumbnails : each camera's picture as a JPEG, lines of one track in one colour.
    captions : for each camera how many of its segments are matched.
    sentence : how many lines in space; or why there are none, or are not to be trusted.
    """

    thumbnails: Mapping[str, bytes]
    captions: Mapping[str, str]
    sentence: str


def watch_lines(
    numbers: Mapping[str, int],
    rig: Rig,
    show: Callable[[Mapping[str, bytes], Mapping[str, str], str], None],
) -> None:
    """Match what cameras of this machine see now, over and over, until interrupted.

    numbers : of each camera of the rig. show : takes thumbnails, captions, and a sentence with the
    rate. Raises InputError for a camera that does not open or sends nothing any more.
    """
    begin = time.monotonic()
    for moment in watch_cameras(numbers, LIVE_S):
        lines = match_moment(moment, rig)
        now = time.monotonic()
        said = f"{lines.sentence} {1.0 / (now - begin):.1f} pictures a second."
        show(lines.thumbnails, lines.captions, said)
        begin = now


def match_moment(moment: Moment, rig: Rig) -> LiveLines:
    """The lines of what the cameras of a rig see at one moment."""
    pictures = {n: each for n, each in moment.pictures.items() if isinstance(each, np.ndarray)}
    segments = {name: find_segments(image) for name, image in pictures.items()}
    fragments = np.zeros((0, len(rig.names), 2, 2))
    try:
        matches = match_segments(segments, rig)
    except MatchError as error:
        sentence = str(error)
    else:
        fragments = np.asarray(matches.fragments_px)
        sentence = f"{len(fragments)} lines of the scene are matched."
        if matches.status is MatchStatus.SUSPECT:
            sentence += f" {matches.notes[0]}"
    colours = [PALETTE[c] for c in distinct_neighbours(fragments.mean(axis=2)).tolist()]
    thumbnails, captions = {}, {}
    for view, (name, image) in enumerate(pictures.items()):
        canvas, factor = shrink_picture(image)
        seen = np.isfinite(fragments[:, view]).all(axis=(1, 2))
        for track in np.flatnonzero(seen):
            ends = np.round(fragments[track, view] * factor * 2**_SHIFT).astype(int).tolist()
            red, green, blue = (int(colours[track][k : k + 2], 16) for k in (1, 3, 5))
            cv2.line(canvas, ends[0], ends[1], (blue, green, red), 2, cv2.LINE_AA, _SHIFT)
        thumbnails[name] = encode_jpeg(canvas)
        captions[name] = f"{int(seen.sum())} lines matched, {len(segments[name])} segments found"
    return LiveLines(thumbnails, captions, sentence)
