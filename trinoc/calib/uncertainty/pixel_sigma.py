"""Standard deviation of the pixel of a fixed point, in two parts: without and with the board's
size.

The error of the board's size is a scale that no image shows. It changes all lengths in mm equally
and is far larger than all other errors. One number for both would hide the others.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.uncertainty.board_size import covariance_of_size
from trinoc.calib.uncertainty.propagation import projection_sigma
from trinoc.geometry.rig import Rig


class PixelSigma(NamedTuple):
    """Standard deviation per axis of the pixel at which a calibrated camera images a fixed point.

    The points are at the distance of the boards. They cover the images of all cameras.

    Attributes
    ----------
    median_px, worst_px : median and largest standard deviation, for a board of exact size.
    size_px : largest contribution of the error of the board's size, added in quadrature; 0 for a
        board of exact size.
    """

    median_px: float
    worst_px: float
    size_px: float

    @property
    def sentence(self) -> str:
        """Sentence that reports both contributions."""
        sentence = (
            f"a pixel has a sigma of {self.median_px:.2g} px (median over the images at the "
            f"distance of the boards; {self.worst_px:.2g} px at the worst position)"
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
    """Copy of a rig with the covariance for a board of exact size.

    Parameters
    ----------
    rig : rig with a covariance.
    parameters, covariance : names and joint covariance of the parameters of cameras and boards.
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
    """Standard deviation of a rig's pixels, with and without the error of the board's size.

    Positions at which a lens images no ray are ignored.

    Parameters
    ----------
    rig : the rig.
    parameters, covariance : names and joint covariance of the parameters of cameras and boards.
    distances_mm : distance of the boards from each camera, by camera name.

    Returns
    -------
    Standard deviations; None for a rig without a covariance.
    """
    if not rig.parameters:
        return None
    size_covariance = _size_part(rig, parameters, covariance)
    parts = (np.asarray(rig.covariance) - size_covariance, size_covariance)
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
    """Part of the rig's covariance that the error of the board's size causes, (k, k)."""
    rows = [parameters.index(name) for name in rig.parameters]
    return covariance_of_size(parameters, covariance)[np.ix_(rows, rows)]


def _with_covariance(rig: Rig, covariance: Float[np.ndarray, "k k"]) -> Rig:
    return Rig(dict(rig.items()), parameters=rig.parameters, covariance=covariance)
