"""`Detection`: the labelled points of a board in one image, which every detector returns."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import BoardSet
from trinoc.numerics.tables import (
    COVARIANCE,
    IN_PICTURE,
    NOT_NEGATIVE,
    PICTURE_SIZE,
    Column,
    Table,
)

_POSITION = ("u_px", "v_px")


class Detection(Table):
    """Labelled points (circles or corners) of a board or a set of boards, detected in one image.

    Attributes
    ----------
    circle_index : (m,) index of each detected circle or corner among the board's points.
    centres_px : (m, 2) position of the corner, or centre of the ellipse fitted to the outer edge of
        the circle.
    covariance_px2 : (m, 2, 2) covariance of `centres_px`.
    shape_px2 : (m, 2, 2) shape matrix S of the ellipse (x - c)^T S^-1 (x - c) = 1; NaN for corners.
    lines_px : (2, 3) homogeneous images of the sheet's lines along X and Y, with unit normals; NaN
        for a line that is not visible.
    image_size_px : (width, height) of the image.
    ambiguity : (k, m) other labellings that the symmetry of the board allows: the index of each
        point in the order of `circle_index`. For example, a plain grid of discs looks the same
        after a half turn. None if the labelling is unique.
    remarks : sentences without a full stop about detected points that were excluded.
    """

    KIND: ClassVar[str] = "detection"
    IN_WORDS: ClassVar[str] = "a detection"
    SIDES: ClassVar[Mapping[str, str]] = {"m": "points", "k": "labellings"}

    circle_index: Annotated[Int[np.ndarray, "m"], Column(NOT_NEGATIVE)]
    centres_px: Annotated[Float[np.ndarray, "m 2"], Column(IN_PICTURE, parts=_POSITION)]
    covariance_px2: Annotated[Float[np.ndarray, "m 2 2"], Column(COVARIANCE, parts=_POSITION)]
    shape_px2: Float[np.ndarray, "m 2 2"]
    lines_px: Float[np.ndarray, "2 3"]
    image_size_px: Annotated[tuple[int, int], Column(PICTURE_SIZE)] = eqx.field(static=True)
    ambiguity: Annotated[Int[np.ndarray, "k m"] | None, Column(NOT_NEGATIVE)] = None
    remarks: tuple[str, ...] = eqx.field(static=True, default=())

    def with_larger_sigmas(self, factor: float) -> "Detection":
        """Copy with the standard deviations of the positions multiplied by `factor`."""
        covariance_px2 = factor**2 * self.covariance_px2
        return eqx.tree_at(lambda detection: detection.covariance_px2, self, covariance_px2)

    @property
    def labellings(self) -> Int[np.ndarray, "l m"]:
        """All possible labellings, (l, m): point indices, `circle_index` first."""
        first = self.circle_index[None]
        return first if self.ambiguity is None else np.concatenate([first, self.ambiguity])


def build_detection(
    labellings: Int[np.ndarray, "l m"],
    centres_px: Float[np.ndarray, "m 2"],
    covariance_px2: Float[np.ndarray, "m 2 2"],
    image_size_px: tuple[int, int],
    shape_px2: Float[np.ndarray, "m 2 2"] | None = None,
    lines_px: Float[np.ndarray, "2 3"] | None = None,
    remarks: tuple[str, ...] = (),
) -> Detection:
    """Make a detection from all possible labellings; the first labelling becomes `circle_index`.

    Parameters
    ----------
    labellings : (l, m) point index of each detected point, one row per possible labelling.
    shape_px2 : shape matrices of ellipses; None if the points are corners.
    centres_px, covariance_px2, image_size_px, lines_px, remarks : see `Detection`.
    """
    return Detection(
        circle_index=labellings[0],
        centres_px=centres_px,
        covariance_px2=covariance_px2,
        shape_px2=np.full((len(centres_px), 2, 2), np.nan) if shape_px2 is None else shape_px2,
        lines_px=np.full((2, 3), np.nan) if lines_px is None else lines_px,
        image_size_px=image_size_px,
        ambiguity=labellings[1:] if len(labellings) > 1 else None,
        remarks=remarks,
    )


def rightward_cosine(
    centres_px: Float[np.ndarray, "m 2"], on_board_mm: Float[np.ndarray, "m 2"]
) -> float:
    """Cosine of the angle between the image of the board's X axis and the direction to the right.

    Parameters
    ----------
    centres_px : (m, 2) image positions.
    on_board_mm : (m, 2) positions of the same points on the board.
    """
    affine, *_ = np.linalg.lstsq(
        on_board_mm - on_board_mm.mean(axis=0), centres_px - centres_px.mean(axis=0), rcond=None
    )
    return float(affine[0, 0] / np.linalg.norm(affine[0]))


def split_by_board(detection: Detection, target: AbstractTarget) -> dict[int, Detection]:
    """Split a detection of a set of boards into one detection per visible board.

    Parameters
    ----------
    detection : points of all visible boards.
    target : the board or the set of boards.

    Returns
    -------
    Detections by index of the board. Points keep their indices in the whole set.
    """
    if not isinstance(target, BoardSet):
        return {0: detection}
    board_of = target.board_of_point[detection.circle_index]
    return {int(k): _select_points(detection, board_of == k) for k in np.unique(board_of)}


def _select_points(detection: Detection, mask: np.ndarray) -> Detection:
    labellings = detection.labellings[:, mask]
    _, first = np.unique(labellings, axis=0, return_index=True)
    return build_detection(
        labellings[np.sort(first)],
        detection.centres_px[mask],
        detection.covariance_px2[mask],
        detection.image_size_px,
        detection.shape_px2[mask],
        detection.lines_px,
        detection.remarks,
    )
