"""File names to frames, by a template such as "{frame}_{camera}.png"."""

import re
from collections.abc import Iterable, Sequence

from trinoc.errors import InputError, list_names
from trinoc.recording.camera_aliases import camera_aliases
from trinoc.recording.frame_table import ENOUGH_VIEWS, Frame

# Usual file names of recorders, tried in this order if no template is given.
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
    """Group file names into frames.

    Parameters
    ----------
    names : iterable of str
        Relative names with "/" as separator. Names that do not match the template are ignored.
    template : str
        Template with {camera} and {frame}, each at least once. {camera} stands for any name of
        `camera_aliases`, and * for any part of a name.
    cameras : sequence of str
        Cameras of the rig.

    Returns
    -------
    list of Frame
        Frames, sorted by the numbers in their names: 2 before 10.

    Raises
    ------
    InputError
        If the template lacks a field or has an unknown one, if nothing matches, or if two files are
        the image of one camera in one frame.
    """
    aliases = camera_aliases(cameras)
    pattern = _pattern(template, list(aliases))
    files_by_frame: dict[str, dict[str, str]] = {}
    for name in names:
        match = pattern.fullmatch(name)
        if match is None:
            continue
        files = files_by_frame.setdefault(match["frame"], {})
        camera = aliases[match["camera"]]
        other = files.setdefault(camera, name)
        if other != name:
            raise InputError(
                f'{other} and {name} are both the picture of "{camera}" in frame '
                f'"{match["frame"]}". Remove one, or give a template that only one matches.'
            )
    if not files_by_frame:
        raise InputError(
            f'No file matches the template "{template}" with the cameras {list_names(cameras)}. '
            "Check the folder, the template, and the camera names in the file names."
        )
    return [
        Frame(
            name,
            {
                camera: files_by_frame[name][camera]
                for camera in cameras
                if camera in files_by_frame[name]
            },
        )
        for name in sorted(files_by_frame, key=_by_numbers)
    ]


def fitting_template(names: Sequence[str], cameras: Sequence[str]) -> str:
    """Return the usual template that fits the file names best.

    The best template finds the frames with the most cameras; of several, the one with the most such
    frames. Raises InputError if no frame has all cameras or at least three.
    """

    def fullest_frames(template: str) -> tuple[int, int]:
        """Return the largest number of cameras in a frame, and the number of such frames."""
        try:
            frames = frames_of_names(names, template, cameras)
        except InputError:
            return 0, 0
        counts = [len(frame.files) for frame in frames]
        return max(counts), counts.count(max(counts))

    best = max(USUAL, key=fullest_frames)
    if fullest_frames(best)[0] < min(ENOUGH_VIEWS, len(cameras)):
        raise InputError(
            f"No frame has files named after all cameras ({list_names(cameras)}). Give a template "
            'of the names, such as "{frame}_{camera}.png" or "{camera}/{frame}.png".'
        )
    return best


def folder_depth(template: str) -> int:
    """Number of folder levels in a template."""
    return template.count("/")


def _pattern(template: str, aliases: Sequence[str]) -> re.Pattern[str]:
    # Longer names first: "left" is no camera of "1_left_wide".
    alternatives = "|".join(re.escape(name) for name in sorted(aliases, key=len, reverse=True))
    expressions = {
        "{frame}": "(?P<frame>[^/]+?)",
        "{camera}": f"(?P<camera>{alternatives})",
        "*": "[^/]*",
    }
    pieces = re.split(r"(\{\w*\}|\*)", template)
    for field in pieces[1::2]:
        if field not in expressions:
            raise InputError(
                f'The template "{template}" has {field}. Use {{frame}} and {{camera}}.'
            )
    for field in ("{frame}", "{camera}"):
        if field not in pieces:
            raise InputError(
                f'The template "{template}" lacks {field}. Write both, such as '
                '"{frame}_{camera}.png".'
            )
    for k, piece in enumerate(pieces):
        pieces[k] = expressions[piece] if k % 2 else re.escape(piece)
        if k % 2 and piece != "*":
            expressions[piece] = f"(?P={piece[1:-1]})"
    return re.compile("".join(pieces))


def _by_numbers(name: str) -> tuple[list[tuple[int, str]], str]:
    """Sort key that puts "a2" before "a10"; names with equal numbers keep a fixed order."""
    pieces = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(int(p[:4000]), "") if p[0] in "0123456789" else (-1, p) for p in pieces], name
