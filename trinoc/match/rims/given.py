"""What a search for rims is given."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry import Rig, Segments, project_by_matrix
from trinoc.match.observations import as_segments
from trinoc.numerics import ArrayLike


def segments_of_views(
    segments: Mapping[str, Segments | ArrayLike], views: tuple[str, ...]
) -> dict[str, Segments]:
    """The segments of every view. Raises InputError where a view has none."""
    missing = [name for name in views if name not in segments]
    if missing:
        raise InputError(
            f'Rims need the segments of every view, but "{missing[0]}" has none: give what was '
            f"matched of {', '.join(views)}."
        )
    return {name: as_segments(segments[name]) for name in views}


def mm_per_px_of(lines_mm: Float[np.ndarray, "t 2 3"], rig: Rig, views: tuple[str, ...]) -> float:
    """Usual size of a pixel at the lines; 1 where there are none."""
    length = np.linalg.norm(lines_mm[:, 1] - lines_mm[:, 0], axis=1)
    shares = []
    for name in views:
        image = project_by_matrix(np.asarray(rig[name].matrix_px), lines_mm)
        shares.append(length / np.linalg.norm(image[:, 1] - image[:, 0], axis=1))
    return float(np.median(shares)) if len(lines_mm) else 1.0
