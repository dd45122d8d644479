"""Rim files: every field of `Rims` as an npz, its matches among them."""

import os

import numpy as np

from trinoc.io.array_checks import LARGEST_MM, ArrayFields, is_covariance
from trinoc.io.arrays_npz import read_arrays, write_arrays
from trinoc.io.matches_npz import arrays_of_matches, matches_of_fields
from trinoc.match import Rims

FORMAT, VERSION = "trinoc-rims", 1
_MATCHES = "matches/"
_ARRAYS = (
    *("centre_mm", "normal", "radius_mm", "covariance_mm2", "covered"),
    *("rim", "view", "segment", "kept"),
)
# Of the length of a normal: what rounding leaves.
_ROUNDING = 1e-6


def save_rims(rims: Rims, path: str | os.PathLike[str]) -> None:
    """Write rims as npz, whole or not at all."""
    arrays = {name: getattr(rims, name) for name in _ARRAYS}
    arrays["views"] = np.array(rims.views, dtype=np.str_)
    arrays["count_names"] = np.array(list(rims.counts), dtype=np.str_)
    arrays["count_values"] = np.array(list(rims.counts.values()), dtype=np.int64)
    matches = arrays_of_matches(rims.matches)
    arrays.update({_MATCHES + name: array for name, array in matches.items()})
    write_arrays(path, FORMAT, VERSION, arrays)


def load_rims(path: str | os.PathLike[str]) -> Rims:
    """Read rims that `save` wrote.

    Raises InputError for another file, and, with the field and the first row, for what no rims can
    have: centres that are not finite, normals that are no unit vectors, radii that are not
    positive, covariances that are none, chords of what is not there, and for matches as
    `load_matches` does.
    """
    fields = ArrayFields(read_arrays(path, FORMAT, VERSION), path)
    views = tuple(map(str, fields.take("views", "U", (None,), "views")))
    radius = fields.take("radius_mm", "f", (None,), "rims")
    fields.expect("radius_mm", (radius > 0) & (radius < LARGEST_MM), "is no radius")
    count = len(radius)

    def take(name: str, *more: int) -> np.ndarray:
        return fields.take(name, "f", (count, *more), f"{count} rims")

    centre = take("centre_mm", 3)
    fields.expect("centre_mm", np.abs(centre) < LARGEST_MM, "is not finite or beyond all scenes")
    normal = take("normal", 3)
    off = np.abs(np.linalg.norm(normal, axis=1) - 1)
    fields.expect("normal", off < _ROUNDING, "is no unit vector")
    covariance = take("covariance_mm2", 7, 7)
    fields.expect("covariance_mm2", is_covariance(covariance), "is no covariance")
    covered = take("covered")
    fields.expect("covered", (covered >= 0) & (covered <= 1 + 1e-9), "is no share")
    rim = fields.take("rim", "i", (None,), "chords")
    fields.expect("rim", (rim >= 0) & (rim < count), "is no rim")
    view, segment = (
        fields.take(name, "i", rim.shape, f"{len(rim)} chords") for name in ("view", "segment")
    )
    fields.expect("view", (view >= 0) & (view < len(views)), "is no view")
    fields.expect("segment", segment >= 0, "is no segment")
    below = {
        name.removeprefix(_MATCHES): array
        for name, array in fields.arrays.items()
        if name.startswith(_MATCHES)
    }
    matches = matches_of_fields(ArrayFields(below, path))
    if matches.views != views:
        raise fields.error("views", "are not those of the matches")
    kept = fields.take("kept", "i", (None,), "tracks")
    fields.expect("kept", (kept >= 0) & (len(kept) <= len(matches)), "is no track")
    names = fields.take("count_names", "U", (None,), "counts")
    counts = fields.take("count_values", "i", names.shape, f"{len(names)} names")
    return Rims(
        views=views,
        centre_mm=centre,
        normal=normal,
        radius_mm=radius,
        covariance_mm2=covariance,
        covered=covered,
        rim=rim,
        view=view,
        segment=segment,
        matches=matches,
        kept=kept,
        counts={str(name): int(value) for name, value in zip(names, counts, strict=True)},
    )
