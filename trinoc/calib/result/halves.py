"""What halves of the shots say of a rig: by how much fits to them differ, and what they miss."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class CrossValidation(NamedTuple):
    """How far lenses and cameras from one half of the shots miss the places of the other half.

    Of a shot that is held out only the board's pose is fitted, to what one camera saw of it.

    Fields
    ------
    shots : how many were held out in turn.
    own_px : for each camera root mean square length of its errors, the board placed by itself:
        what its lens does not explain.
    across_px : the same, the board placed by each other camera of the shot in turn, which errs by
        that camera's noise, too: what the rig does not explain. Empty for one camera.
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
    """By how much two halves of the shots have a camera image the same points elsewhere.

    Fields
    ------
    camera : its name.
    distance_mm : (2,) of the points: where the boards were, and `farther` times as far.
    uv_px : (n, 2) places in the picture, along whose rays the points lie.
    difference_px : (2, n, 2) first half less second at each distance, along u and v; NaN where the
        lens has no ray.
    sigma_px : (2, n) standard deviation claimed for it, per axis.
    """

    camera: str
    distance_mm: Float[np.ndarray, "2"]
    uv_px: Float[np.ndarray, "n 2"]
    difference_px: Float[np.ndarray, "2 n 2"]
    sigma_px: Float[np.ndarray, "2 n"]

    @property
    def over_sigma(self) -> Float[np.ndarray, "2 n"]:
        """Length of the difference over that claimed: its mean square is 1 for a right model."""
        return np.linalg.norm(self.difference_px, axis=-1) / (np.sqrt(2.0) * self.sigma_px)

    @property
    def rms_px(self) -> Float[np.ndarray, "2"]:
        """Root mean square length of the difference over the field."""
        return np.sqrt(np.nanmean(np.sum(self.difference_px**2, axis=-1), axis=-1))

    @property
    def rms_over_sigma(self) -> Float[np.ndarray, "2"]:
        """Root mean square of `over_sigma` over the field."""
        return np.sqrt(np.nanmean(self.over_sigma**2, axis=-1))


class HalvesCheck(NamedTuple):
    """The rig from one half of the shots against that from the other.

    Fields
    ------
    ratio : difference over claimed sigma, root mean square over everything determined: 1 where
        the model is right, more where something is not in it.
    worst : name of the parameter with the largest difference in sigmas, as "camera 1" has them.
    worst_ratio : that difference.
    parameters : how many were compared.
    over_field : for each camera how far apart both image the same points, in px and beside what
        is claimed.
    """

    ratio: float
    worst: str
    worst_ratio: float
    parameters: int
    over_field: tuple[FieldDifference, ...] = ()
