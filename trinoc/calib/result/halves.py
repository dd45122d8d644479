"""Comparison of two halves of the shots: their difference, and the residuals of each
in the other.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class CrossValidation(NamedTuple):
    """Two-fold cross-validation: residuals in shots that were not used to fit lenses and cameras.

    In such a held-out shot only the board pose is fitted, to the image of one camera.

    Attributes
    ----------
    shots : number of shots; each was held out once.
    own_px : root mean square residual of each camera, px, with the board pose fitted to the image
        of the same camera. It shows the error of the lens model.
    across_px : root mean square residual of each camera, px, with the board pose fitted to the
        image of another camera. It also shows the error of the relative poses, and the noise of the
        other camera. Empty for a single camera.
    """

    shots: int
    own_px: Mapping[str, float]
    across_px: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """Sentence for the user with the held-out residuals of each camera."""
        sentence = (
            f"held-out residual (rms of shots that were not fitted): {_list_errors(self.own_px)} "
            "with the board placed by the camera itself"
        )
        if self.across_px:
            sentence += f", {_list_errors(self.across_px)} with it placed by another camera"
        return sentence


def _list_errors(errors_px: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3f} px ({name})" for name, value in errors_px.items())


class FieldDifference(NamedTuple):
    """Difference between the pixels that two rigs predict for the same 3-D points in one camera.

    The rigs were fitted to two halves of the shots.

    Attributes
    ----------
    camera : name of the camera.
    distance_mm : (2,) distances of the points from the camera: that of the boards, and a multiple
        of it.
    uv_px : (n, 2) pixels on whose rays the points lie.
    difference_px : (2, n, 2) pixel predicted by the first half minus that of the second half, at
        each distance; NaN where the lens has no ray.
    sigma_px : (2, n) standard deviation per axis of the difference, from the covariances of both
        halves.
    """

    camera: str
    distance_mm: Float[np.ndarray, "2"]
    uv_px: Float[np.ndarray, "n 2"]
    difference_px: Float[np.ndarray, "2 n 2"]
    sigma_px: Float[np.ndarray, "2 n"]

    @property
    def over_sigma(self) -> Float[np.ndarray, "2 n"]:
        """Length of `difference_px` in sigmas, divided by sqrt(2), (2, n).

        Its mean square is 1 for a correct model.
        """
        return np.linalg.norm(self.difference_px, axis=-1) / (np.sqrt(2.0) * self.sigma_px)

    @property
    def rms_px(self) -> Float[np.ndarray, "2"]:
        """Root mean square length of `difference_px` over the image, at each distance."""
        return np.sqrt(np.nanmean(np.sum(self.difference_px**2, axis=-1), axis=-1))

    @property
    def rms_over_sigma(self) -> Float[np.ndarray, "2"]:
        """Root mean square of `over_sigma` over the image, at each distance."""
        return np.sqrt(np.nanmean(self.over_sigma**2, axis=-1))


class HalvesCheck(NamedTuple):
    """Comparison of two rigs that were fitted to two halves of the shots.

    Attributes
    ----------
    ratio : root mean square of the difference in sigmas, over all determined parameters. It is
        about 1 for a correct model, and larger if the model omits an error.
    worst : name of the parameter with the largest difference in sigmas.
    worst_ratio : difference of this parameter in sigmas.
    parameters : number of compared directions in the space of parameters.
    over_field : difference of the predicted pixels over the image of each camera.
    """

    ratio: float
    worst: str
    worst_ratio: float
    parameters: int
    over_field: tuple[FieldDifference, ...] = ()
