"""How well a rig knows where its cameras image a point: one statement, in two parts.

The error of the board's size is a scale that no image shows. It moves all lengths in mm alike, and
is far larger than everything that images do show, so that one number for both says little.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.uncertainty.board_size import covariance_of_size
from trinoc.calib.uncertainty.propagation import projection_sigma
from trinoc.geometry.rig import Rig


class PixelSigma(NamedTuple):
    """Standard deviation, per axis, of the pixel at which a camera images a point fixed in the
    world, at the distance of the boards, over the images of all cameras.

    Fields
    ------
    median_px, worst_px : for a board whose size is exact: what the images leave uncertain.
    size_px : the most that the error of the board's size adds in quadrature; 0 if the size is
        exact.
    """

    median_px: float
    worst_px: float
    size_px: float

    @property
    def sentence(self) -> str:
        """The two parts in words."""
        sentence = (
            f"a pixel is known to {self.median_px:.2g} px (one sigma, median over the images at "
            f"the distance of the boards; {self.worst_px:.2g} px at the worst place)"
        )
        if self.size_px > 0.0:
            sentence += (
                f"; the error of the board's size, a scale that no image shows, adds "
                f"up to {self.size_px:.2g} px"
            )
        return sentence


def rig_of_known_size(
    rig: Rig, parameters: tuple[str, ...], covariance: Float[np.ndarray, "p p"]
) -> Rig:
    """The rig with the covariance that it would have if the board's size were exact.

    parameters, covariance : joint covariance of the cameras and the boards; see
    `covariance_of_size`.
    """
    return _with_covariance(
        rig, np.asarray(rig.covariance) - _size_part(rig, parameters, covariance)
    )


def compute_pixel_sigma(
    rig: Rig,
    parameters: tuple[str, ...],
    covariance: Float[np.ndarray, "p p"],
    distances_mm: Mapping[str, float],
) -> PixelSigma | None:
    """The statement of a rig; None for a rig without a covariance. Places at which a lens images no
    ray do not count.

    distances_mm : of the boards from each camera.
    """
    if not rig.parameters:
        return None
    by_size = _size_part(rig, parameters, covariance)
    parts = (np.asarray(rig.covariance) - by_size, by_size)
    rest_px, size_px = (
        np.concatenate(
            [
                projection_sigma(_with_covariance(rig, part), name, distance).sigma_px
                for name, distance in distances_mm.items()
            ]
        )
        for part in parts
    )
    if not np.isfinite(rest_px).any():
        return None
    return PixelSigma(
        float(np.nanmedian(rest_px)), float(np.nanmax(rest_px)), float(np.nanmax(size_px))
    )


def _size_part(
    rig: Rig, parameters: tuple[str, ...], covariance: Float[np.ndarray, "p p"]
) -> Float[np.ndarray, "k k"]:
    """Part of the rig's own covariance that the error of the board's size makes."""
    rows = [parameters.index(name) for name in rig.parameters]
    return covariance_of_size(parameters, covariance)[np.ix_(rows, rows)]


def _with_covariance(rig: Rig, covariance: Float[np.ndarray, "k k"]) -> Rig:
    return Rig(dict(rig.items()), parameters=rig.parameters, covariance=covariance)
