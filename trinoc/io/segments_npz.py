"""Segment files: trinoc's own npz, and the plain tables that other detectors write."""

import os
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry import Segments
from trinoc.io.array_checks import LARGEST_PX, ArrayFields, is_covariance
from trinoc.io.arrays_npz import read_arrays, write_arrays
from trinoc.io.junctions_npz import junction_arrays, junctions_of_arrays
from trinoc.io.segment_table import read_table

FORMAT, VERSION = "trinoc-segments", 1
TABLE_SUFFIXES = (".npy", ".csv", ".txt")


def save_segments(segments: Segments, path: str | os.PathLike[str]) -> None:
    """Write segments as npz, whole or not at all; fields that are None are left out."""
    size = segments.image_size_px
    arrays = {
        "endpoints_px": np.asarray(segments.endpoints_px),
        "covariance_px2": np.asarray(segments.covariance_px2),
        "polarity": np.asarray(segments.polarity),
        "contrast": np.asarray(segments.contrast),
        "support": np.asarray(segments.support),
        "image_size_px": np.array([] if size is None else size, dtype=np.int64),
    }
    if segments.reasons is not None:
        arrays["reasons"] = np.asarray(segments.reasons, dtype=np.str_)
    if segments.chain is not None:
        arrays["chain"] = np.asarray(segments.chain)
    if segments.side_levels is not None:
        arrays["side_levels"] = np.asarray(segments.side_levels)
    if segments.junctions is not None:
        arrays.update(junction_arrays(segments.junctions))
    write_arrays(path, FORMAT, VERSION, arrays)


def load_segments(path: str | os.PathLike[str]) -> Segments:
    """Read segments: an npz of `save_segments`, or a table with rows x1 y1 x2 y2 in pixels.

    A table is npy, csv or txt (separated by commas, semicolons or blanks; a first line of column
    names and lines that start with # are skipped). Its segments get the sigmas of
    `Segments.from_endpoints`. Raises InputError for other files, and, with the field and the first
    row, for values that no segment has: other shapes, coordinates that are not finite or beyond
    all pictures, covariances that are none.
    """
    file = Path(path)
    if file.suffix.lower() in TABLE_SUFFIXES:
        try:
            segments = Segments.from_endpoints(read_table(file))
        except InputError as error:
            raise _in_file(file, error) from error
        _expect_places(np.asarray(segments.endpoints_px), file)
        return segments
    fields = ArrayFields(read_arrays(file, FORMAT, VERSION), file)
    size = fields.take("image_size_px", "i", (None,), "a picture")
    if size.size and not (size.shape == (2,) and (size >= 1).all() and (size < LARGEST_PX).all()):
        raise fields.error("image_size_px", "must be a width and a height in pixels, or empty")
    try:
        # Checks the ends; everything else is then taken from the file.
        ends = fields.take("endpoints_px", "f", (None, 2, 2), "segments")
        count = len(Segments.from_endpoints(ends))
    except InputError as error:
        raise _in_file(file, error) from error
    _expect_places(ends, file)

    def take(name: str, *more: int, kind: str = "f") -> np.ndarray:
        return fields.take(name, kind, (count, *more), f"{count} segments")

    covariance = take("covariance_px2", 4, 4)
    fields.expect("covariance_px2", is_covariance(covariance), "is no covariance")
    polarity, support = take("polarity", kind="i"), take("support", kind="i")
    fields.expect("polarity", np.isin(polarity, (-1, 0, 1)), "is not -1, 0 or 1")
    fields.expect("support", support >= 0, "is a negative number of points")
    contrast = take("contrast")
    fields.expect("contrast", ~np.isinf(contrast), "is infinite")
    levels = take("side_levels", 2) if "side_levels" in fields else None
    if levels is not None:
        fields.expect("side_levels", ~np.isinf(levels), "is infinite")
    return Segments(
        ends,
        covariance,
        polarity,
        contrast,
        support,
        (int(size[0]), int(size[1])) if size.size else None,
        take("reasons", kind="U") if "reasons" in fields else None,
        take("chain", kind="i") if "chain" in fields else None,
        junctions_of_arrays(fields, count),
        levels,
    )


def _expect_places(ends_px: np.ndarray, file: Path) -> None:
    far = np.flatnonzero((np.abs(ends_px) > LARGEST_PX).any(axis=(1, 2)))
    if len(far):
        raise InputError(
            f"{file}: segment {far[0]} has a coordinate of {np.abs(ends_px[far[0]]).max():g} px, "
            "beyond all pictures: give ends in pixels of the picture."
        )


def _in_file(file: Path, error: InputError) -> InputError:
    text = str(error)
    return error if text.startswith(str(file)) else InputError(f"{file}: {text}")
