"""What was found of a board in one picture."""

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

_PLACE = ("u_px", "v_px")


class Detection(Table):
    """Labelled places of a board in one picture, in pixels of the picture.

    Fields
    ------
    circle_index : (m,) index into the board's places of each circle or corner found.
    centres_px : (m, 2) the corner, or the centre of the ellipse fitted to the circle's outer edge.
    covariance_px2 : (m, 2, 2) of the centres.
    shape_px2 : (m, 2, 2) S of the ellipse (x - c)^T S^-1 (x - c) = 1; NaN of corners.
    lines_px : (2, 3) the images of the sheet's lines along X and along Y, unit normal; NaN where
        not seen.
    image_size_px : (width, height) of the picture.
    ambiguity : (k, m) the other labellings, in the order of `circle_index`, that the board's
        own symmetry leaves open (a plain grid of discs looks the same turned); None when
        `circle_index` is the only one.
    remarks : sentences without a full stop on places that were found and left out.
    """

    KIND: ClassVar[str] = "detection"
    IN_WORDS: ClassVar[str] = "a detection"
    SIDES: ClassVar[Mapping[str, str]] = {"m": "places", "k": "labellings"}

    circle_index: Annotated[Int[np.ndarray, "m"], Column(NOT_NEGATIVE)]
    centres_px: Annotated[Float[np.ndarray, "m 2"], Column(IN_PICTURE, parts=_PLACE)]
    covariance_px2: Annotated[Float[np.ndarray, "m 2 2"], Column(COVARIANCE, parts=_PLACE)]
    shape_px2: Float[np.ndarray, "m 2 2"]
    lines_px: Float[np.ndarray, "2 3"]
    image_size_px: Annotated[tuple[int, int], Column(PICTURE_SIZE)] = eqx.field(static=True)
    ambiguity: Annotated[Int[np.ndarray, "k m"] | None, Column(NOT_NEGATIVE)] = None
    remarks: tuple[str, ...] = eqx.field(static=True, default=())

    def with_larger_sigmas(self, factor: float) -> "Detection":
        """The same circles, their centres' standard deviations `factor` times as large."""
        covariance_px2 = factor**2 * self.covariance_px2
        return eqx.tree_at(lambda detection: detection.covariance_px2, self, covariance_px2)

    @property
    def labellings(self) -> Int[np.ndarray, "l m"]:
        """All that are left open, `circle_index` first."""
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
    """A detection whose first labelling is the one to use; of corners unless shapes are given."""
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


def rightward_share(
    centres_px: Float[np.ndarray, "m 2"], on_board_mm: Float[np.ndarray, "m 2"]
) -> float:
    """The share of X's direction in the picture that points to the right."""
    affine, *_ = np.linalg.lstsq(
        on_board_mm - on_board_mm.mean(axis=0), centres_px - centres_px.mean(axis=0), rcond=None
    )
    return float(affine[0, 0] / np.linalg.norm(affine[0]))


def split_by_board(detection: Detection, target: AbstractTarget) -> dict[int, Detection]:
    """What was found of each board, by its number; a place keeps its index in the whole set."""
    if not isinstance(target, BoardSet):
        return {0: detection}
    board_of = target.board_of_point[detection.circle_index]
    return {int(k): _select_places(detection, board_of == k) for k in np.unique(board_of)}


def _select_places(detection: Detection, mask: np.ndarray) -> Detection:
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
