"""3-D segments as LIMAP's folder of tracks: track_0.txt, track_1.txt, ...

Image ids are the indices of the views, and line ids those of the segments in each view. The pixel
origin is the corner of the top-left pixel, as in the COLMAP cameras that LIMAP uses.
"""

from pathlib import Path

import numpy as np

from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, NAMES, Format
from trinoc.io.formats.text_files import atomic_folder
from trinoc.match.tracks.matches import Matches

HALF_PX = 0.5


def write_limap(matches: Matches, path: Path, unit_mm: float) -> None:
    """Write one text file for each track into the folder `path`; lengths in units of `unit_mm`."""
    with atomic_folder(path) as folder:
        for track, ends in enumerate(matches.lines_mm / unit_mm):
            images = np.flatnonzero(matches.index[track] >= 0)
            fragments = matches.fragments_px[track, images].reshape(-1, 4) + HALF_PX
            lines = [
                _join_numbers(ends.ravel()),
                f"{len(images)} {len(images)}",
                f"image_id_list {_join_numbers(images)}",
                f"line_id_list {_join_numbers(matches.index[track, images])}",
                "line2d_list",
                *map(_join_numbers, fragments),
                "END",
            ]
            write_text(folder / f"track_{track}.txt", "\n".join(lines) + "\n")


def _join_numbers(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))


limap = Format(
    name="limap",
    title="LIMAP's track folder",
    holds=("matches",),
    place="folder",
    frames="the world of the rig; pixel (0, 0) is the corner of the top-left pixel",
    loses=(COVARIANCE, NAMES),
    write=write_limap,
)
