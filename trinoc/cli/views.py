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
    """File of each view, in the order of the arguments.

    Raises UsageError if an argument has the wrong form.

    guess : True to take the names from the file names if no argument has a name.
    words : camera of the rig for each word that may name it; None without a rig.
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
    """File of each camera. If no argument has a name, names are taken from the file names.

    Raises UsageError if there is no file.

    wanted : kind of file in the message. log : True to log the names.
    """
    if not arguments:
        raise UsageError(f"No {wanted} is given: write NAME=FILE for each camera.")
    files = files_of_views(arguments, guess=True)
    if log:
        _log_names(arguments, files)
    return files


def _log_names(arguments: Sequence[str], files: Mapping[str, Path]) -> None:
    """Log the names of cameras that were taken from their file names."""
    if not any("=" in argument for argument in arguments):
        names = " ".join(f"{name}={file}" for name, file in files.items())
        LOGGER.info("cameras are named after their files: %s", names)


def _name_and_file(argument: str, words: Mapping[str, str] | None) -> tuple[str, str, str]:
    """Split an argument NAME=FILE into name, "=" and file. The name itself may contain "=".

    words : camera of the rig for each word that may name it; None without a rig.
    """
    parts = argument.split("=")
    for k in range(1, len(parts)):
        name = "=".join(parts[:k])
        if name in (words or {}):
            return (words or {})[name], "=", "=".join(parts[k:])
    return argument.partition("=")


def _guess_names(files: Sequence[Path]) -> dict[str, Path]:
    """Name each camera by the part of its file name that differs, or of its folder if the names
    agree.
    """
    for candidates in ([file.stem for file in files], [file.parent.name for file in files]):
        names = _differing(candidates)
        if all(names) and len(set(names)) == len(names):
            return dict(zip(names, files, strict=True))
    raise UsageError(
        f"The file names do not distinguish the cameras: write NAME=FILE, such as upper={files[0]}."
    )


def _differing(names: Sequence[str]) -> list[str]:
    """Parts in which names differ: the names without their common beginning and end.

    Words are cut only at separators such as "_".
    """
    if len(names) == 1:
        return list(names)
    begin = _shared_parts(names)
    rest = [name[len(begin) :] for name in names]
    end = _shared_parts([name[::-1] for name in rest])
    return [name[: len(name) - len(end)] for name in rest]


def _shared_parts(names: Sequence[str]) -> str:
    """Common beginning of all names, up to the last separator between parts.

    For "sheet_left" and "sheet_low" it is "sheet_", not "sheet_l".
    """
    shared = os.path.commonprefix(names)  # noqa: RUF071, letter by letter
    return shared[: max(shared.rfind(sign) for sign in _BETWEEN) + 1]


def files_of_rig(arguments: Sequence[str], names: Collection[str]) -> dict[str, Path]:
    """File of each camera of a rig. Cameras may have any name of `camera_aliases`.

    Without NAME=, the camera is found in the path of the file. Raises UsageError.
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
    """Camera that the end of a path names, or else a part of the file name.

    None if it is no camera or several. A word that is a part of a longer word in the file name is
    ignored.

    words : camera for each word that may name it.
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
    """Create the folder of --out if it does not exist. Raises InputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder} cannot be made a folder ({error.strerror}): give another one with --out."
        ) from error


def read_rig(file: str | os.PathLike[str]) -> "trinoc.Rig":
    """Read a rig, and log warnings.

    The warnings name lenses that fold in the corners of the image, and cameras whose calibration
    was suspect.
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
    """Log a warning for each lens that folds in the corners of the image. file : source of the
    lenses.
    """
    from trinoc.io.intrinsics_json import fold_notes

    for note in fold_notes(value):
        LOGGER.warning("%s: %s", file, note)


def find_doubts(file: str | os.PathLike[str]) -> dict[str, str]:
    """Reason for each camera of a rig file whose calibration was suspect."""
    from trinoc.io.rig_json import load_rig_status

    return load_rig_status(file).doubts


def doubts_table(file: str | os.PathLike[str]) -> "list[ExtraTable]":
    """Table for the report with the cameras whose calibration was suspect; empty without any."""
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
    """Return the pictures among the files, and the segments of all views.

    Segments are read from files of segments, or detected in pictures.

    find : function that detects segments in a picture.
    """
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

    reason = "The table is empty." if image is None else why_nothing(image)
    LOGGER.warning('no segment in %s, the picture of "%s": %s', file, name, reason)


def expect_names(files: Mapping[str, Path], rig: "trinoc.Rig", rig_file: Path) -> None:
    """Raise InputError if a view is not a camera of the rig."""
    for name in files:
        if name not in rig.names:
            raise InputError(
                f'{rig_file} has no camera "{name}", but {list_names(rig)}: use these names.'
            )


def check_views(files: Mapping[str, Path], rig: "trinoc.Rig", rig_file: Path) -> None:
    """Raise InputError if a view is not a camera of the rig, or if two views are not the whole rig.

    If three or more views are given, missing cameras are only logged.
    """
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
    """Matches of a scene, and functions that match again with another rig.

    Attributes
    ----------
    matches : Matches
        Matches that were made with the given rig.
    tolerant, strict : callable, optional
        Functions that match the segments with a rig. `tolerant` assumes a large sigma of the
        segments, `strict` the stated one. None if the matches were read from a file.
    files : dict of Path
        Input files by name.
    """

    matches: "trinoc.Matches"
    tolerant: "Callable[[trinoc.Rig], trinoc.Matches] | None"
    strict: "Callable[[trinoc.Rig], trinoc.Matches] | None"
    files: dict[str, Path]


def read_scene(
    pictures: Sequence[str], matches: Path | None, rig: "trinoc.Rig", rig_file: Path, job: Job
) -> SceneInput:
    """Read the matches of a scene, or match its pictures or segments. Raises UsageError or
    InputError.
    """
    if bool(pictures) == (matches is not None):
        raise UsageError(
            "Give either NAME=FILE for each camera, with its picture of the scene or its segments, "
            "or --matches FILE."
        )
    if matches is not None:
        tracks = trinoc.load_matches(matches)
        cameras_without_view = [name for name in rig if name not in tracks.views]
        if cameras_without_view:
            LOGGER.warning(
                "%s has no view of %s: left out", matches, list_names(cameras_without_view)
            )
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
