"""File names to frames, by a template such as "{frame}_{camera}.png"."""

import re
from collections.abc import Iterable, Sequence

from trinoc.errors import InputError, list_names
from trinoc.recording.camera_words import camera_words
from trinoc.recording.frame_table import ENOUGH_VIEWS, Frame

# How recorders name files, tried in this order where nobody says.
USUAL = (
    "{camera}/{frame}.*",
    "{frame}/{camera}.*",
    "{frame}_{camera}.*",
    "{camera}_{frame}.*",
    "{frame}-{camera}.*",
    "{camera}-{frame}.*",
    "{frame}.{camera}.*",
)


def frames_of_names(names: Iterable[str], template: str, cameras: Sequence[str]) -> list[Frame]:
    """The frames among file names, which are relative and parted by "/".

    `template` has {camera}, any of `camera_words`, and {frame}, once or more each, and may have *
    for any part of a name. Names that do not fit are left out. Frames come in the order of the
    numbers in their names: 2 before 10. Raises InputError for a template that lacks a field or has
    another, where nothing fits, and where two files are one camera's picture of one frame.
    """
    words = camera_words(cameras)
    pattern = _pattern(template, list(words))
    found: dict[str, dict[str, str]] = {}
    for name in names:
        fit = pattern.fullmatch(name)
        if fit is None:
            continue
        files = found.setdefault(fit["frame"], {})
        camera = words[fit["camera"]]
        other = files.setdefault(camera, name)
        if other != name:
            raise InputError(
                f'{other} and {name} are both the picture of "{camera}" in frame '
                f'"{fit["frame"]}": remove one, or give a template that only one fits.'
            )
    if not found:
        raise InputError(
            f'No file fits the template "{template}" with the cameras {list_names(cameras)}: check '
            "the folder, the template, and that files are named after the cameras of the rig."
        )
    return [
        Frame(name, {camera: found[name][camera] for camera in cameras if camera in found[name]})
        for name in sorted(found, key=_by_numbers)
    ]


def fitting_template(names: Sequence[str], cameras: Sequence[str]) -> str:
    """The usual template by which the fullest frames have most cameras, and are most frames.

    Raises InputError where they lack a camera and have fewer than three.
    """

    def fullest_frames(template: str) -> tuple[int, int]:
        """(cameras of the fullest frames, number of these)."""
        try:
            frames = frames_of_names(names, template, cameras)
        except InputError:
            return 0, 0
        counts = [len(frame.files) for frame in frames]
        return max(counts), counts.count(max(counts))

    best = max(USUAL, key=fullest_frames)
    if fullest_frames(best)[0] < min(ENOUGH_VIEWS, len(cameras)):
        raise InputError(
            f"No frame has files named after all cameras ({list_names(cameras)}): say how they are "
            'named by a template, such as "{frame}_{camera}.png" or "{camera}/{frame}.png".'
        )
    return best


def folder_depth(template: str) -> int:
    """How many folders deep the files of a template lie."""
    return template.count("/")


def _pattern(template: str, words: Sequence[str]) -> re.Pattern[str]:
    # Longer names first: "left" is no camera of "1_left_wide".
    either = "|".join(re.escape(name) for name in sorted(words, key=len, reverse=True))
    written = {"{frame}": "(?P<frame>[^/]+?)", "{camera}": f"(?P<camera>{either})", "*": "[^/]*"}
    pieces = re.split(r"(\{\w*\}|\*)", template)
    for field in pieces[1::2]:
        if field not in written:
            raise InputError(
                f'The template "{template}" has {field}: use {{frame}} and {{camera}}.'
            )
    for field in ("{frame}", "{camera}"):
        if field not in pieces:
            raise InputError(
                f'The template "{template}" lacks {field}: write both, such as '
                '"{frame}_{camera}.png".'
            )
    for k, piece in enumerate(pieces):
        pieces[k] = written[piece] if k % 2 else re.escape(piece)
        if k % 2 and piece != "*":
            written[piece] = f"(?P={piece[1:-1]})"
    return re.compile("".join(pieces))


def _by_numbers(name: str) -> tuple[list[tuple[int, str]], str]:
    """A key by which "a2" comes before "a10"; names that read alike keep a fixed order."""
    pieces = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(int(p[:4000]), "") if p[0] in "0123456789" else (-1, p) for p in pieces], name
