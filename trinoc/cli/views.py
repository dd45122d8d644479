"""Arguments NAME=FILE, or FILE alone: one file for each camera."""

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import trinoc
from trinoc.cli.command import LOGGER, Job, UsageError
from trinoc.errors import InputError, list_names

if TYPE_CHECKING:
    import numpy as np

    from trinoc.report.html import ExtraTable

# What stands between the words of a file's name.
_BETWEEN = "_-. "


def files_of_views(
    arguments: Sequence[str], *, guess: bool = False, words: Mapping[str, str] | None = None
) -> dict[str, Path]:
    """The file of each view, in the order of the arguments.

    guess : where no argument has a name, take the names from those of the files.
    words : the camera of a rig that each word names, where there is a rig.

    Raises UsageError.
    """
    named = [_name_and_file(argument, words) for argument in arguments]
    if guess and arguments and all(not separator for _, separator, _ in named):
        return _guess_names([Path(argument) for argument in arguments])
    files: dict[str, Path] = {}
    for argument, (name, separator, file) in zip(arguments, named, strict=True):
        if not (name and separator and file):
            raise UsageError(
                f'"{argument}" names no view: write NAME=FILE, such as upper=upper.png.'
            )
        if name in files:
            raise UsageError(f'The view "{name}" is given twice: name each camera once.')
        files[name] = Path(file)
    return files


def named_files(
    arguments: Sequence[str], *, wanted: str = "picture", log: bool = True
) -> dict[str, Path]:
    """`files_of_views` with guessed names, which the log repeats. UsageError for no file."""
    if not arguments:
        raise UsageError(f"No {wanted} is given: write NAME=FILE for each camera.")
    files = files_of_views(arguments, guess=True)
    if log:
        _log_names(arguments, files)
    return files


def _log_names(arguments: Sequence[str], files: Mapping[str, Path]) -> None:
    """Log the names that cameras have from their files."""
    if not any("=" in argument for argument in arguments):
        names = " ".join(f"{name}={file}" for name, file in files.items())
        LOGGER.info("cameras are named after their files: %s", names)


def _name_and_file(argument: str, words: Mapping[str, str] | None) -> tuple[str, str, str]:
    """NAME, = and FILE of an argument; the name of a camera may hold an = itself."""
    parts = argument.split("=")
    for k in range(1, len(parts)):
        name = "=".join(parts[:k])
        if name in (words or {}):
            return (words or {})[name], "=", "=".join(parts[k:])
    return argument.partition("=")


def _guess_names(files: Sequence[Path]) -> dict[str, Path]:
    """Named after what differs between the files' names, or the folders' where the names agree."""
    for candidates in ([file.stem for file in files], [file.parent.name for file in files]):
        names = _differing(candidates)
        if all(names) and len(set(names)) == len(names):
            return dict(zip(names, files, strict=True))
    raise UsageError(
        f"The file names do not distinguish the cameras: write NAME=FILE, such as upper={files[0]}."
    )


def _differing(words: Sequence[str]) -> list[str]:
    """The words without what all begin and end with, cut where a part of a name ends."""
    if len(words) == 1:
        return list(words)
    begin = _shared_parts(words)
    rest = [word[len(begin) :] for word in words]
    end = _shared_parts([word[::-1] for word in rest])
    return [word[: len(word) - len(end)] for word in rest]


def _shared_parts(words: Sequence[str]) -> str:
    """The beginning of all words, as far as the last sign between parts.

    Of sheet_left and sheet_low it is "sheet_", not "sheet_l".
    """
    shared = os.path.commonprefix(words)  # noqa: RUF071, letter by letter
    return shared[: max(shared.rfind(sign) for sign in _BETWEEN) + 1]


def files_of_rig(arguments: Sequence[str], names: Collection[str]) -> dict[str, Path]:
    """Files for the cameras of a rig, named by any of `camera_aliases`.

    Where no name is given, it is in the path of the file, or the file's name holds it.
    Raises UsageError.
    """
    from trinoc.recording.camera_aliases import camera_aliases

    aliases = camera_aliases(tuple(names))
    files = files_of_views(arguments, guess=True, words=aliases)
    if any("=" in argument for argument in arguments):
        return files
    for cameras in (
        list(files),
        [aliases.get(name) for name in files],
        [_camera_of_file(file, aliases) for file in files.values()],
    ):
        if set(cameras) <= set(names) and len(set(cameras)) == len(cameras):
            files = dict(zip(map(str, cameras), files.values(), strict=True))
            break
    _log_names(arguments, files)
    return files


def _camera_of_file(file: Path, words: Mapping[str, str]) -> str | None:
    """The only camera that the end of a path names, or a part of the file's name; None for none.

    Of words in the name, one that is a part of a longer one does not count.
    """
    path, stem = f"/{file.as_posix()}", file.stem.lower()
    ends = (path, path.removesuffix(file.suffix))
    whole = [word for word in words if any(end.endswith(f"/{word}") for end in ends)]
    inside = [word for word in words if word.lower() in stem]
    longest = [
        word for word in inside if not any(word in other and word != other for other in inside)
    ]
    cameras = {words[max(whole, key=len)]} if whole else {words[word] for word in longest}
    return cameras.pop() if len(cameras) == 1 else None


def make_folder(folder: Path) -> None:
    """The folder that --out names, where it is not there. Raises InputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder} cannot be made a folder ({error.strerror}): give another one with --out."
        ) from error


def read_rig(file: str | os.PathLike[str]) -> "trinoc.Rig":
    """The rig of a file; warnings on stderr name lenses that fold in the corners of the picture.

    They also repeat what the calibration doubted.
    """
    rig = trinoc.load_rig(file)
    warn_of_folds(rig, file)
    doubts = find_doubts(file)
    if doubts:
        cameras = ", ".join(f"{name} ({doubt.removesuffix('.')})" for name, doubt in doubts.items())
        LOGGER.warning("the calibration in %s is SUSPECT: %s", file, cameras)
    return rig


def warn_of_folds(
    value: "trinoc.Rig | trinoc.Intrinsics | Mapping[str, trinoc.Intrinsics]",
    file: str | os.PathLike[str],
) -> None:
    """Log a warning for each lens of a file that folds in the corners of the picture."""
    from trinoc.io.intrinsics_json import fold_notes

    for note in fold_notes(value):
        LOGGER.warning("%s: %s", file, note)


def find_doubts(file: str | os.PathLike[str]) -> dict[str, str]:
    """For each camera whose calibration was suspect, why."""
    from trinoc.io.rig_json import load_rig_status

    return load_rig_status(file).doubts


def doubts_table(file: str | os.PathLike[str]) -> "list[ExtraTable]":
    """The same for a report: a table, or none where nothing was doubted."""
    rows = list(find_doubts(file).items())
    if not rows:
        return []

    from trinoc.report.html import ExtraTable

    caption = "The sigmas of the 3-D segments do not include the resulting errors."
    return [ExtraTable("SUSPECT cameras", ("camera", "why"), rows, caption)]


SEGMENT_SUFFIXES = (".npz", ".npy", ".csv", ".txt")


def read_segments(
    files: Mapping[str, Path],
    rig: "trinoc.Rig",
    find: "Callable[[np.ndarray], trinoc.Segments]",
    job: Job,
) -> "tuple[dict[str, np.ndarray], dict[str, trinoc.Segments]]":
    """(the pictures among the files, the segments of all): read, or found in the pictures."""
    from trinoc.image.grey import describe_mixed_pixels, grey_image
    from trinoc.io.images import expect_inside, expect_size

    tables = {n: f for n, f in files.items() if f.suffix.lower() in SEGMENT_SUFFIXES}
    images = trinoc.io.read_views(
        {name: file for name, file in files.items() if name not in tables}
    )
    for name, image in images.items():
        expect_size(name, image, rig)
    segments = {
        name: trinoc.load_segments(tables[name]) if name in tables else find(images[name])
        for name in job.each(tuple(files), "segments")
    }
    for name, image in images.items():
        mixed = describe_mixed_pixels(grey_image(image))
        if mixed is not None:
            LOGGER.warning('%s, the picture of "%s": %s', files[name], name, mixed)
    for name, segments_of_view in segments.items():
        if len(segments_of_view) == 0:
            _warn_of_nothing(name, images.get(name), files[name])
        elif name in tables:
            expect_inside(name, segments_of_view, rig, tables[name])
    return images, segments


def _warn_of_nothing(name: str, image: "np.ndarray | None", file: Path) -> None:
    from trinoc.segments.nothing_found import why_nothing

    why = "The table is empty." if image is None else why_nothing(image)
    LOGGER.warning('no segment in %s, the picture of "%s": %s', file, name, why)


def expect_names(files: Mapping[str, Path], rig: "trinoc.Rig", rig_file: Path) -> None:
    """Raise InputError for a view that is no camera of the rig."""
    for name in files:
        if name not in rig.names:
            raise InputError(
                f'{rig_file} has no camera "{name}", but {list_names(rig)}: use these names.'
            )


def check_views(files: Mapping[str, Path], rig: "trinoc.Rig", rig_file: Path) -> None:
    """Raise InputError where the views given are not the cameras of the rig."""
    expect_names(files, rig, rig_file)
    missing = [name for name in rig.names if name not in files]
    if missing and len(files) < 3:
        raise InputError(
            f'{rig_file} has the camera "{missing[0]}", for which no picture is given: '
            f"add {missing[0]}=FILE."
        )
    if missing:
        LOGGER.warning("no picture of %s: matching uses the other cameras", list_names(missing))


# After a knock the matcher first takes the ends of segments to be this far off. With 8 px it finds
# nothing among clutter any more, whatever the resolution.
TOLERANT_SIGMA_PX = 4.0


class SceneInput(NamedTuple):
    """Matches made with the rig given, ways to match again (none for matches), and the files."""

    matches: "trinoc.Matches"
    tolerant: "Callable[[trinoc.Rig], trinoc.Matches] | None"
    strict: "Callable[[trinoc.Rig], trinoc.Matches] | None"
    files: dict[str, Path]


def read_scene(
    pictures: Sequence[str], matches: Path | None, rig: "trinoc.Rig", rig_file: Path, job: Job
) -> SceneInput:
    """Read the matches, or the pictures or segments. Raises UsageError, InputError."""
    if bool(pictures) == (matches is not None):
        raise UsageError(
            "Give either NAME=FILE for each camera, with its picture of the scene or its segments, "
            "or --matches FILE."
        )
    if matches is not None:
        tracks = trinoc.load_matches(matches)
        others = [name for name in rig if name not in tracks.views]
        if others:
            LOGGER.warning("%s has no view of %s: left out", matches, list_names(others))
        return SceneInput(tracks, None, None, {"matches": matches})
    files = files_of_rig(pictures, rig.names)
    check_views(files, rig, rig_file)
    segments = read_segments(files, rig, trinoc.find_segments, job)[1]
    LOGGER.info("matching %s", ", ".join(f"{len(s)} ({n})" for n, s in segments.items()))
    # Whether the pictures belong together is asked once, of the rig given.
    matcher = partial(trinoc.match_segments, segments, verify="off")
    return SceneInput(
        trinoc.match_segments(segments, rig),
        partial(matcher, sigma_px=TOLERANT_SIGMA_PX),
        matcher,
        files,
    )
