"""Junctions as arrays of a segment file."""

from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry import BODY, Junctions
from trinoc.io.arrays_npz import take

_PREFIX = "junctions/"
_KINDS = ("L", "T", "X", "Y")


def junction_arrays(junctions: Junctions) -> dict[str, np.ndarray]:
    """The arrays that stand for junctions in a file, by name."""
    return {
        _PREFIX + "uv_px": np.asarray(junctions.uv_px),
        _PREFIX + "covariance_px2": np.asarray(junctions.covariance_px2),
        _PREFIX + "kind": np.asarray(junctions.kind, dtype=np.str_),
        _PREFIX + "junction": np.asarray(junctions.junction),
        _PREFIX + "segment": np.asarray(junctions.segment),
        _PREFIX + "end": np.asarray(junctions.end),
    }


def junctions_of_arrays(
    arrays: dict[str, np.ndarray], file: Path, segments: int
) -> Junctions | None:
    """The junctions among so many segments, None where the file has none of their arrays.

    Raises InputError where an array is missing, does not fit the others, is not finite, or
    speaks of segments, ends or kinds that there are not.
    """
    if not any(name.startswith(_PREFIX) for name in arrays):
        return None
    fields = {
        name: take(arrays, _PREFIX + name, file)
        for name in ("uv_px", "covariance_px2", "kind", "junction", "segment", "end")
    }
    count, rows = len(np.atleast_1d(fields["uv_px"])), fields["junction"].size
    shapes = {
        "uv_px": (count, 2),
        "covariance_px2": (count, 2, 2),
        "kind": (count,),
        "junction": (rows,),
        "segment": (rows,),
        "end": (rows,),
    }
    for name, shape in shapes.items():
        if fields[name].shape != shape:
            raise InputError(
                f'{file}: "{_PREFIX}{name}" has shape {fields[name].shape}, but {count} junctions '
                f"in {rows} rows need {shape}: write the file again."
            )
    allowed = {
        "uv_px": np.isfinite,
        "covariance_px2": np.isfinite,
        "kind": lambda kind: np.isin(kind, _KINDS),
        "junction": lambda junction: (junction >= 0) & (junction < count),
        "segment": lambda segment: (segment >= 0) & (segment < segments),
        "end": lambda end: np.isin(end, (BODY, 0, 1)),
    }
    for name, is_allowed in allowed.items():
        if not is_allowed(fields[name]).all():
            raise InputError(
                f'{file}: "{_PREFIX}{name}" holds values that no junction of {segments} segments '
                "can have: write the file again."
            )
    return Junctions(
        fields["uv_px"].astype(np.float64),
        fields["covariance_px2"].astype(np.float64),
        fields["kind"],
        fields["junction"].astype(np.int64),
        fields["segment"].astype(np.int64),
        fields["end"].astype(np.int64),
    )
