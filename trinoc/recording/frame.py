"""One moment of a recording: its files, and what was found in them."""

from collections.abc import Mapping
from typing import NamedTuple

from trinoc.match.tracks.matches import Matches

OK = "ok"


class Frame(NamedTuple):
    """A name, and for each camera that has one its file, relative to the recording's folder."""

    name: str
    files: Mapping[str, str]


class FrameMatches(NamedTuple):
    """What became of a frame: matches and the status "ok", or None and the sentence why not."""

    name: str
    status: str
    matches: Matches | None
