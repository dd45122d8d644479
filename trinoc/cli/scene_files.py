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
    from trinoc.io import expect_inside, expect_size, load_segments, read_views

    tables = {n: f for n, f in files.items() if f.suffix.lower() in SEGMENT_SUFFIXES}
    images = read_views({name: file for name, file in files.items() if name not in tables})
    for name, image in images.items():
        expect_size(name, image, rig)
    segments = {
        name: load_segments(tables[name]) if name in tables else find(images[name])
        for name in each(tuple(files), "segments", quiet=quiet)
    }
    for name, found in segments.items():
        if len(found) == 0:
            _warn_of_nothing(name, images.get(name), files[name])
        elif name in tables:
            expect_inside(name, found, rig, tables[name])
    return images, segments


def _warn_of_nothing(name: str, image: "np.ndarray | None", file: Path) -> None:
    from trinoc.segments import why_nothing

    why = "The table is empty." if image is None else why_nothing(image)
    LOGGER.warning('no segment in %s, the picture of "%s": %s', file, name, why)


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
