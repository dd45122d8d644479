"""The scene that a rig is refined or checked with: matches, or pictures that are matched here."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from trinoc.cli.command import UsageError
from trinoc.cli.progress import LOGGER
from trinoc.cli.scene_files import check_views, read_segments
from trinoc.cli.views import files_of_views, with_names

if TYPE_CHECKING:
    from trinoc.geometry import Rig
    from trinoc.match import Matches

# After a knock the matcher first takes the ends of segments to be this far off. With 8 px it finds
# nothing among clutter any more, whatever the resolution.
TOLERANT_SIGMA_PX = 4.0


class SceneInput(NamedTuple):
    """Matches made with the rig given, ways to match again (none for matches), and the files."""

    matches: "Matches"
    tolerant: "Callable[[Rig], Matches] | None"
    strict: "Callable[[Rig], Matches] | None"
    files: dict[str, Path]


def scene_of(
    pictures: Sequence[str], matches: Path | None, rig: "Rig", rig_file: Path, *, quiet: bool
) -> SceneInput:
    """Read the matches, or the pictures or segments. Raises UsageError, InputError."""
    if bool(pictures) == (matches is not None):
        raise UsageError(
            "Give either NAME=FILE for each camera, its picture or segments of the scene, or "
            "--matches FILE."
        )
    if matches is not None:
        from trinoc.io import load_matches

        return SceneInput(load_matches(matches), None, None, {"matches": matches})

    from trinoc.match import match_segments
    from trinoc.segments import find_segments

    files = with_names(files_of_views(pictures, guess=True), rig.names)
    check_views(files, rig, rig_file)
    segments = read_segments(files, rig, find_segments, quiet=quiet)[1]
    LOGGER.info("matching %s", ", ".join(f"{len(s)} ({n})" for n, s in segments.items()))
    return SceneInput(
        match_segments(segments, rig),
        lambda other: match_segments(segments, other, sigma_px=TOLERANT_SIGMA_PX),
        lambda other: match_segments(segments, other),
        files,
    )
