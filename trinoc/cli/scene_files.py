"""The pictures of a scene, or their segments, given for the cameras of a rig."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from trinoc.cli.progress import LOGGER, each
from trinoc.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.geometry import Rig, Segments

SEGMENT_SUFFIXES = (".npz", ".npy", ".csv", ".txt")


def read_segments(
    files: Mapping[str, Path],
    rig: "Rig",
    find: "Callable[[np.ndarray], Segments]",
    *,
    quiet: bool,
) -> "tuple[dict[str, np.ndarray], dict[str, Segments]]":
    """(the pictures among the files, the segments of all): read, or found in the pictures."""
    from trinoc.io import load_segments, read_views

    tables = {n: f for n, f in files.items() if f.suffix.lower() in SEGMENT_SUFFIXES}
    images = read_views({name: file for name, file in files.items() if name not in tables})
    for name, image in images.items():
        check_size(name, image, rig)
    segments = {
        name: load_segments(tables[name]) if name in tables else find(images[name])
        for name in each(tuple(files), "segments", quiet=quiet)
    }
    for name, found in segments.items():
        if len(found) == 0:
            _warn_of_nothing(name, images.get(name), files[name])
        elif name in tables:
            check_inside(name, found, rig, tables[name])
    return images, segments


def _warn_of_nothing(name: str, image: "np.ndarray | None", file: Path) -> None:
    from trinoc.segments import why_nothing

    why = "The table is empty." if image is None else why_nothing(image)
    LOGGER.warning('no segment in %s, the picture of "%s": %s', file, name, why)


def check_inside(name: str, segments: "Segments", rig: "Rig", file: Path) -> None:
    """Raise InputError for segments more than a picture's width beyond the picture."""
    import numpy as np

    size = np.array(rig[name].image_size_px)
    ends = np.asarray(segments.endpoints_px)
    outside = np.flatnonzero(((ends < -size) | (ends > 2 * size)).any(axis=(1, 2)))
    if len(outside):
        raise InputError(
            f'{file}: segment {outside[0]} lies far outside the pictures of "{name}", which are '
            f"{size[0]} x {size[1]} px: give ends in pixels of that camera."
        )


def check_views(files: Mapping[str, Path], rig: "Rig", rig_file: Path) -> None:
    """Raise InputError where the views given are not the cameras of the rig."""
    for name in files:
        if name not in rig.names:
            raise InputError(
                f'{rig_file} has no camera "{name}", but {", ".join(rig.names)}: use these names.'
            )
    missing = [name for name in rig.names if name not in files]
    if missing and len(files) < 3:
        raise InputError(
            f'{rig_file} has the camera "{missing[0]}", for which no picture is given: '
            f"add {missing[0]}=FILE."
        )
    if missing:
        LOGGER.warning("no picture of %s: matching without", ", ".join(missing))


def check_size(name: str, image: "np.ndarray", rig: "Rig") -> None:
    """Raise InputError where a picture has not the size that the rig was calibrated for."""
    size = (image.shape[1], image.shape[0])
    if size != rig[name].image_size_px:
        raise InputError(
            f'The picture of "{name}" is {size[0]} x {size[1]} px, but the rig was calibrated for '
            f"{rig[name].image_size_px[0]} x {rig[name].image_size_px[1]} px: give a picture of "
            "that size."
        )
