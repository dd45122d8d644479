"""Support of circles by chords, and the test whether a rim in two views is ambiguous."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array

from trinoc.match.rims.circles import (
    MIDDLE,
    ON_ARC,
    Chords,
    CircleOffsets,
    Circles,
    are_touching,
    circle_offsets,
    image_circles,
)
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.tables import take_rows

# numerical: number of pairs (chord, circle) in memory, about 800 bytes each.
ENTRIES_AT_A_TIME = 1 << 16
# numerical: side of a cell in median radii. Circles with centres in one cell share a block.
_CELL_RADII = 2.0


def support_matrix(
    chords: Chords, circles: Circles, limit_px: float, tuning: RimTuning
) -> csr_array:
    """Return the weighted length of each chord on each circle, px, as a sparse matrix (h, s).

    Chords that do not lie on the circle have the value 0. Circles are processed in blocks to limit
    the memory.
    """
    shape = len(circles.radius_mm), len(chords.view)
    entries = [(np.zeros(0), (np.zeros(0, np.int64), np.zeros(0, np.int64)))]
    cell = _CELL_RADII * np.median(circles.radius_mm) if shape[0] else 1.0
    order = np.lexsort(np.floor(circles.centre_mm / cell).T)
    for part in blocks(shape[0], max(ENTRIES_AT_A_TIME // max(shape[1], 1), 1)):
        block = take_rows(circles, order[part])
        near_chords = np.flatnonzero(are_near_images(chords, block, limit_px).any(axis=0))
        block_chords = take_rows(chords, near_chords)
        support = sum_support(block_chords, circle_offsets(block_chords, block), limit_px, tuning)
        row, column = np.nonzero(support)
        entries.append((support[row, column], (order[part][row], near_chords[column])))
    values = np.concatenate([value for value, _ in entries])
    index = np.concatenate([np.stack(positions) for _, positions in entries], axis=1)
    return coo_array((values, (index[0], index[1])), shape=shape).tocsr()


def sum_support(
    chords: Chords, offsets: CircleOffsets, limit_px: float, tuning: RimTuning
) -> Float[np.ndarray, "h s"]:
    """Return the weighted length of each chord on each circle, px, (h, s).

    The weight decreases with the distance from the circle, so that the best of several similar
    circles has the largest sum.
    """
    relative_offset = np.abs(offsets.offset_px[..., ON_ARC]).max(axis=2) / limit_px
    weight = np.sqrt(np.clip(1 - relative_offset, 0.0, 1.0)) * chords.length_px
    return np.where(are_touching(offsets, limit_px, tuning), weight, 0.0)


def are_near_images(chords: Chords, circles: Circles, margin_px: float) -> Bool[np.ndarray, "h s"]:
    """Return the mask of the chords with their midpoint inside each circle's image or near it, (h,
    s).
    """
    is_near = np.zeros((len(circles.radius_mm), len(chords.view)), dtype=bool)
    for view in np.unique(chords.view):
        chord_rows = np.flatnonzero(chords.view == view)
        image = image_circles(circles, chords.matrix_px[chord_rows[0]])
        offset = chords.points_px[chord_rows, MIDDLE] - image.middle_px[:, None]
        # In perspective, the nearer half of a circle has the larger image.
        radius = 1.5 * image.axes_px[:, :1] + margin_px
        is_near[:, chord_rows] = (offset**2).sum(axis=2) < radius**2
    return is_near


# numerical: largest inverse depth of the search, relative to the circle's, and largest number of
# steps.
_MAX_INVERSE_DEPTH, _MOST_STEPS = 3.0, 2000


def has_rival(
    chords: Chords, circle: Circles, chord_rows: Int[np.ndarray, "k"], tuning: RimTuning
) -> bool:
    """True if another circle has the same chords in one view and other chords in the second view.

    A rim with such a rival is ambiguous, because only two views show it.

    Notes
    -----
    If a circle is moved along the viewing rays of one camera and scaled, its image in this camera
    stays the same. An arc of this view may therefore belong to any arc of the second view on such a
    circle.
    """
    first_view, second_view = np.unique(chords.view[chord_rows]).tolist()
    return any(
        _has_other_chords(chords, circle, chord_rows, first, second, tuning)
        for first, second in ((first_view, second_view), (second_view, first_view))
    )


def _has_other_chords(
    chords: Chords,
    circle: Circles,
    chord_rows: Int[np.ndarray, "k"],
    first: int,
    second: int,
    tuning: RimTuning,
) -> bool:
    """True if a circle with the same image in view `first` has other chords in view `second`.

    Other chords are segments on that circle that are not in `chord_rows`, the chords of `circle`.
    Their total length must exceed half of that of the chords of `circle` in view `second`.
    """
    in_second = chords.view == second
    rows = np.setdiff1d(np.flatnonzero(in_second), chord_rows)
    if len(rows) == 0:
        return False
    eye = chords.centre_mm[(chords.view == first).argmax()]
    circles = _circles_with_equal_image(circle, eye, chords.matrix_px[in_second.argmax()], tuning)
    other_chords = take_rows(chords, rows)
    support_length = (
        support_matrix(other_chords, circles, 2 * tuning.touch_px, tuning) > 0
    ) @ other_chords.length_px
    return bool(
        support_length.max() > 0.5 * chords.length_px[chord_rows[in_second[chord_rows]]].sum()
    )


def _circles_with_equal_image(
    circle: Circles,
    eye_mm: Float[np.ndarray, "3"],
    other_px: Float[np.ndarray, "3 4"],
    tuning: RimTuning,
) -> Circles:
    """Return circles with the same image as `circle` for a camera at `eye_mm`.

    In the image of the other camera, consecutive circles are displaced by about twice the tolerance
    `touch_px`.
    """
    from_eye = circle.centre_mm[0] - eye_mm
    image = other_px @ np.append(circle.centre_mm[0], 1.0)
    image_at_infinity = other_px[:, :3] @ from_eye
    # Image path from infinity to the circle. If it leaves the view sideways, the steps are limited.
    image_path = np.linalg.norm(
        image[:2] / image[2]
        - image_at_infinity[:2] / max(image_at_infinity[2], 1e-9 * abs(image[2]))
    )
    steps = int(np.clip(_MAX_INVERSE_DEPTH * image_path / (2 * tuning.touch_px), 1, _MOST_STEPS))
    scale = steps / (_MAX_INVERSE_DEPTH * np.arange(1, steps + 1))
    return Circles(
        eye_mm + scale[:, None] * from_eye,
        np.tile(circle.normal, (steps, 1)),
        scale * circle.radius_mm,
    )
