"""Agreement of two halves of the shots: their difference, and the errors of each on the other."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class CrossValidation(NamedTuple):
    """Two-fold cross-validation: errors of lenses and cameras on shots not used in their fit.

    For a held-out shot only the pose of the board is fitted, to the image of one camera.

    Attributes
    ----------
    shots : number of shots, each held out once.
    own_px : for each camera, the root mean square error with the board placed by the same camera,
        px. Includes the error of the lens model.
    across_px : for each camera, the root mean square error with the board placed by each other
        camera, px. Includes the error of the rig, and the noise of the other camera. Empty for one
        camera.
    """

    shots: int
    own_px: Mapping[str, float]
    across_px: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """Sentence with the held-out residual of each camera."""
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
    """Difference between the pixels of the same points by the rigs of two halves of the shots.

    Attributes
    ----------
    camera : name of the camera.
    distance_mm : (2,) distances of the points: that of the boards, and `AdviceTuning.farther` times
        that.
    uv_px : (n, 2) pixels whose rays contain the points.
    difference_px : (2, n, 2) first half minus second half at each distance, along u and v; NaN
        where the lens has no ray.
    sigma_px : (2, n) standard deviation of the difference by the covariances of both halves, per
        axis.
    """

    camera: str
    distance_mm: Float[np.ndarray, "2"]
    uv_px: Float[np.ndarray, "n 2"]
    difference_px: Float[np.ndarray, "2 n 2"]
    sigma_px: Float[np.ndarray, "2 n"]

    @property
    def over_sigma(self) -> Float[np.ndarray, "2 n"]:
        """Length of the difference over its sigma, (2, n). The mean square is 1 for a correct
        model.
        """
        return np.linalg.norm(self.difference_px, axis=-1) / (np.sqrt(2.0) * self.sigma_px)

    @property
    def rms_px(self) -> Float[np.ndarray, "2"]:
        """Root mean square length of the difference over the field, px, at each distance."""
        return np.sqrt(np.nanmean(np.sum(self.difference_px**2, axis=-1), axis=-1))

    @property
    def rms_over_sigma(self) -> Float[np.ndarray, "2"]:
        """Root mean square of `over_sigma` over the field, at each distance."""
        return np.sqrt(np.nanmean(self.over_sigma**2, axis=-1))


class HalvesCheck(NamedTuple):
    """Difference between the rigs of two halves of the shots.

    Attributes
    ----------
    ratio : root mean square normalised difference over all determined parameters. 1 for a correct
        model, larger if the model omits something.
    worst : name of the parameter with the largest normalised difference.
    worst_ratio : that normalised difference.
    parameters : number of compared directions.
    over_field : difference in pixels over the field of each camera.
    """

    ratio: float
    worst: str
    worst_ratio: float
    parameters: int
    over_field: tuple[FieldDifference, ...] = ()
