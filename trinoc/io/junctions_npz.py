"""Junctions as arrays of a segment file."""

import numpy as np

from trinoc.geometry import BODY, Junctions
from trinoc.io.array_checks import LARGEST_PX, ArrayFields, is_covariance

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


def junctions_of_arrays(fields: ArrayFields, segments: int) -> Junctions | None:
    """The junctions among so many segments, None where the file has none of their arrays.

    Raises InputError where an array is missing, does not fit the others, is not finite, or
    speaks of segments, ends or kinds that there are not.
    """
    if not any(name.startswith(_PREFIX) for name in fields.arrays):
        return None
    rows = fields.take(_PREFIX + "junction", "i", (None,), "junctions")
    uv_px = fields.take(_PREFIX + "uv_px", "f", (None, 2), "junctions")
    count = len(uv_px)
    what = f"{count} junctions in {len(rows)} rows"
    covariance = fields.take(_PREFIX + "covariance_px2", "f", (count, 2, 2), what)
    kind = fields.take(_PREFIX + "kind", "U", (count,), what)
    segment = fields.take(_PREFIX + "segment", "i", rows.shape, what)
    end = fields.take(_PREFIX + "end", "i", rows.shape, what)
    problem = f"is a value that no junction of {segments} segments can have"
    for name, good in (
        ("uv_px", np.abs(uv_px) < LARGEST_PX),
        ("covariance_px2", is_covariance(covariance)),
        ("kind", np.isin(kind, _KINDS)),
        ("junction", (rows >= 0) & (rows < count)),
        ("segment", (segment >= 0) & (segment < segments)),
        ("end", np.isin(end, (BODY, 0, 1))),
    ):
        fields.expect(_PREFIX + name, good, problem)
    return Junctions(uv_px, covariance, kind, rows, segment, end)
