"""Cylinder files: every field of `Cylinders` as an npz."""

import os

import numpy as np

from trinoc.io.array_checks import LARGEST_MM, ArrayFields, is_covariance
from trinoc.io.arrays_npz import read_arrays, write_arrays
from trinoc.match import Cylinders

FORMAT, VERSION = "trinoc-cylinders", 1
_ARRAYS = (
    *("axis_mm", "radius_mm", "covariance_mm2", "posterior", "rival_posterior", "chi_square"),
    *("degrees", "cylinder", "view", "segment", "side", "silhouette"),
)


def save_cylinders(cylinders: Cylinders, path: str | os.PathLike[str]) -> None:
    """Write cylinders as npz, whole or not at all."""
    arrays = {name: getattr(cylinders, name) for name in _ARRAYS}
    arrays["views"] = np.array(cylinders.views, dtype=np.str_)
    arrays["count_names"] = np.array(list(cylinders.counts), dtype=np.str_)
    arrays["count_values"] = np.array(list(cylinders.counts.values()), dtype=np.int64)
    write_arrays(path, FORMAT, VERSION, arrays)


def load_cylinders(path: str | os.PathLike[str]) -> Cylinders:
    """Read cylinders that `save` wrote.

    Raises InputError for another file, and, with the field and the first row, for what no
    cylinders can have: axes that are not finite, radii that are not positive, covariances that are
    none, probabilities outside [0, 1], outlines of what is not there.
    """
    fields = ArrayFields(read_arrays(path, FORMAT, VERSION), path)
    views = tuple(map(str, fields.take("views", "U", (None,), "views")))
    radius = fields.take("radius_mm", "f", (None,), "cylinders")
    fields.expect("radius_mm", (radius > 0) & (radius < LARGEST_MM), "is no radius")
    count = len(radius)

    def take(name: str, kind: str, *more: int) -> np.ndarray:
        return fields.take(name, kind, (count, *more), f"{count} cylinders")

    axis = take("axis_mm", "f", 2, 3)
    fields.expect("axis_mm", np.abs(axis) < LARGEST_MM, "is not finite or beyond all scenes")
    covariance = take("covariance_mm2", "f", 7, 7)
    fields.expect("covariance_mm2", is_covariance(covariance), "is no covariance")
    silhouette = fields.take("silhouette", "f", (None,), "tracks")
    probabilities = {name: take(name, "f") for name in ("posterior", "rival_posterior")}
    for name, values in {**probabilities, "silhouette": silhouette}.items():
        fields.expect(name, (values >= 0) & (values <= 1 + 1e-9), "is no probability")
    cylinder = fields.take("cylinder", "i", (None,), "outlines")
    fields.expect("cylinder", (cylinder >= 0) & (cylinder < count), "is no cylinder")
    outlines = {
        name: fields.take(name, "i", cylinder.shape, f"{len(cylinder)} outlines")
        for name in ("view", "segment", "side")
    }
    fields.expect("view", (outlines["view"] >= 0) & (outlines["view"] < len(views)), "is no view")
    fields.expect("segment", outlines["segment"] >= 0, "is no segment")
    fields.expect("side", np.abs(outlines["side"]) == 1, "is no side")
    names = fields.take("count_names", "U", (None,), "counts")
    counts = fields.take("count_values", "i", names.shape, f"{len(names)} names")
    return Cylinders(
        views=views,
        axis_mm=axis,
        radius_mm=radius,
        covariance_mm2=covariance,
        chi_square=take("chi_square", "f"),
        degrees=take("degrees", "i"),
        cylinder=cylinder,
        silhouette=silhouette,
        counts={str(name): int(value) for name, value in zip(names, counts, strict=True)},
        **probabilities,
        **outlines,
    )
