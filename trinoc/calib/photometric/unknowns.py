"""Unknowns of one image: names, bounds and weak priors.

The unknowns are (pose, appearance, light, veil, levels). The appearance is blur, ink and response.
Light and veil are polynomials over the image; levels are local light and veil of each block of the
sheet. The ideal camera has a subset of the unknowns of the full model. The others have priors, so
that they stay near zero if the image does not determine them. The standard deviations of the priors
are several times the values of real cameras.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.image.response import PowerResponse
from trinoc.numerics.precision import ArrayLike, ScalarLike

# numerical: terms of polynomials of degree 4 and 2.
LIGHT_TERMS, QUADRATIC_TERMS = 15, 6
# numerical: local terms of each block: light and veil with their slopes, (1, x, y) each.
LOCAL_TERMS = 6
# numerical: smallest relative light of a block, which keeps the model valid.
_LEAST_LIGHT = 0.05
_BEND = PowerResponse.PARAMETERS["bend"]
# Unknowns of the appearance: lower and upper bound, and value of the ideal camera.
# numerical: the bounds keep steps in the range where the model is valid.
_APPEARANCE = {
    # Blur of lens, motion and pixel: rms width along one axis (mean of all directions), and its
    # fourth and sixth cumulants over powers of the width; 0 for a Gaussian.
    "sigma_px": (0.1, 8.0, 0.0),
    "kurtosis": (-1.5, 3.0, 0.0),
    "sixth": (-6.0, 15.0, 0.0),
    # Anisotropy of the blur, px^2: (variance along u - along v) / 2; covariance of u and v; half
    # the variance along the image's axes minus that along the diagonals.
    "along_u": (-20.0, 20.0, 0.0),
    "diagonal": (-20.0, 20.0, 0.0),
    "along_axes": (-2.0, 2.0, 0.0),
    # Shape of the anisotropic part: 1 for a straight motion, 0 for a Gaussian.
    "line": (-0.5, 1.6, 0.0),
    # Sharpening: weight of the subtracted Gaussian (lobe), its additional blur, px, and the
    # additional spread of its ink, mm.
    "lobe": (-0.9, 4.0, 0.0),
    "lobe_px": (0.4, 3.0, 1.0),  # no effect if the weight is 0
    "lobe_mm": (-0.5, 0.5, 0.0),
    # Spread of ink beyond the edges of the drawing.
    "spread_mm": (-2.0, 2.0, 0.0),
    # Grey level of ink over that of paper, minus one, in the centre of the image.
    "ratio": (-0.999, -0.02, 0.0),
    # Response: its curvature (0 linear, 1 sRGB), and coefficients of c (1 - c) and
    # c (1 - c) (1 - 2 c), with c the share of ink.
    "bend": _BEND[:3],
    "lift": (-1.0, 1.0, 0.0),
    "contrast": (-1.0, 1.0, 0.0),
}


class ImagePrior(NamedTuple):
    """Independent Gaussian priors of the unknowns of an image other than the pose.

    Attributes
    ----------
    mean : (k,) prior means.
    weight : (k,) reciprocal prior variances; 0 for an unknown without a prior.
    local_weight : (6,) reciprocal prior variances of the six local levels of a block, whose prior
        means are 0.
    """

    mean: Float[ArrayLike, "k"]
    weight: Float[ArrayLike, "k"]
    local_weight: Float[ArrayLike, "6"]


class Unknowns(NamedTuple):
    """Set of the unknowns of an image other than the pose; a constant of the compiled programs.

    An unknown that is not in the set has its value for an ideal camera.

    Attributes
    ----------
    appearance : names of the unknowns of blur, ink and response.
    light_terms, veil_terms : numbers of coefficients of the polynomials of light and of veil
        (additional light on paper and ink alike), lower degrees first.
    """

    appearance: tuple[str, ...]
    light_terms: int
    veil_terms: int

    @property
    def size(self) -> int:
        """Number of unknowns other than the pose."""
        return len(self.appearance) + self.light_terms + self.veil_terms

    @property
    def is_ideal(self) -> bool:
        """True for the set of an ideal camera: linear response, Gaussian blur, quadratic light."""
        return self == IDEAL

    def indices(self, *names: str) -> list[int]:
        """Indices of unknowns of blur, ink and response by their names."""
        return [self.appearance.index(name) for name in names]

    @property
    def light(self) -> range:
        """Indices of the coefficients of the light, which is the grey level of the paper."""
        return range(len(self.appearance), len(self.appearance) + self.light_terms)

    @property
    def veil(self) -> range:
        """Indices of the coefficients of the veil (additional light on paper and ink alike)."""
        return range(len(self.appearance) + self.light_terms, self.size)

    @property
    def ideal_camera_indices(self) -> list[int]:
        """Indices of the unknowns of the ideal camera."""
        return [*self.indices(*IDEAL.appearance), *self.light[:QUADRATIC_TERMS]]

    @property
    def uneven_light_indices(self) -> list[int]:
        """Indices of the unknowns that describe uneven light.

        These are the terms of the light beyond a quadratic polynomial, and the slopes of the veil.
        The constant of the veil is excluded, because it is equivalent to a change of light and of
        ink reflectance.
        """
        return [*self.light[QUADRATIC_TERMS:], *self.veil[1:]]

    def bounds(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """Lower and upper bounds of all unknowns, each (k,)."""
        lower, upper = np.full((2, self.size), [[-np.inf], [np.inf]])
        for index, name in enumerate(self.appearance):
            lower[index], upper[index] = _APPEARANCE[name][:2]
        return lower, upper

    def prior(self, tuning: PhotometricTuning, *, local: bool) -> ImagePrior:
        """Prior of all unknowns other than the pose.

        Parameters
        ----------
        tuning : constants of the fit, with the widths of the priors.
        local : True if each block has its own light. Then the polynomials have a prior too, because
            an image hardly separates them from the local light.
        """
        priors = _appearance_priors(tuning)
        mean, sigma = np.zeros(self.size), np.full(self.size, np.inf)
        for index, name in enumerate(self.appearance):
            mean[index], sigma[index] = priors.get(name, (_APPEARANCE[name][2], np.inf))
        if local:
            # At the edge of the image, a term may be as large as the veil of a block.
            sigma[self.light[1:]] = sigma[self.veil] = tuning.local_widths[3]
        return ImagePrior(mean, sigma**-2.0, np.array(tuning.local_widths) ** -2.0)


def _appearance_priors(tuning: PhotometricTuning) -> dict[str, tuple[float, float]]:
    """Prior mean and standard deviation of unknowns of blur, ink and response, by name."""
    return {
        "kurtosis": (0.0, tuning.kurtosis_width),
        "sixth": (0.0, tuning.sixth_width),
        "along_u": (0.0, tuning.motion_width_px2),
        "diagonal": (0.0, tuning.motion_width_px2),
        "along_axes": (0.0, tuning.axes_width_px2),
        "line": (0.0, tuning.line_width),
        "lobe": (0.0, tuning.lobe_width),
        "lobe_px": tuning.lobe_px,
        "lobe_mm": (0.0, tuning.lobe_width_mm),
        "bend": _BEND[2:],
        "lift": (0.0, tuning.lift_width),
        "contrast": (0.0, tuning.contrast_width),
    }


# numerical: an ideal camera has no veil.
IDEAL = Unknowns(("sigma_px", "spread_mm", "ratio"), QUADRATIC_TERMS, 0)
FULL = Unknowns(tuple(_APPEARANCE), LIGHT_TERMS, QUADRATIC_TERMS)


class ImageState(eqx.Module):
    """Values of all unknowns of one image.

    Attributes
    ----------
    pose : pose of the camera.
    values : (k,) values of the unknowns other than the pose: blur, ink and response, light, veil.
    levels : (6, blocks) local levels of each block: coefficients of 1, x, y of the light, as a
        fraction of the polynomial light, and of the veil, grey levels. No blocks if the light is
        not local.
    unknowns : set of the unknowns in `values`.
    """

    pose: Pose
    values: Float[ArrayLike, "k"]
    levels: Float[ArrayLike, "6 blocks"]
    unknowns: Unknowns = eqx.field(static=True)

    def __getitem__(self, name: str) -> Float[ArrayLike, ""]:
        """Value of an unknown of blur, ink or response, by its name.

        An unknown that is not in the set has its value for an ideal camera.
        """
        if name not in self.unknowns.appearance:
            return np.asarray(_APPEARANCE[name][2], self.values.dtype)
        return self.values[self.unknowns.appearance.index(name)]

    @property
    def light(self) -> Float[ArrayLike, "m"]:
        """Coefficients of the polynomial that gives the grey level of the paper."""
        return self.values[np.array(self.unknowns.light)]

    @property
    def veil(self) -> Float[ArrayLike, "m"]:
        """Coefficients of the polynomial of the veil (additional light on paper and ink alike)."""
        return self.values[np.array(self.unknowns.veil, dtype=int)]

    @property
    def contrast(self) -> float:
        """Grey level of the paper minus that of the ink, in the centre of the image."""
        return float(-self["ratio"] * self.light[0])

    def move(
        self,
        step: Float[ArrayLike, "k"],
        levels: Float[ArrayLike, "6 blocks"],
        model: PoseModel,
    ) -> "ImageState":
        """State after a step, clipped to the bounds of the unknowns.

        Parameters
        ----------
        step : (p + k,) step of the pose and of `values`.
        levels : (6, blocks) new local levels.
        model : parameters of the pose that the step changes.
        """
        pose = self.pose.retract(step[: model.size], model, step_unit_mm(self.pose, model))
        lower, upper = self.unknowns.bounds()
        values = jnp.clip(self.values + step[model.size :], lower, upper)
        if levels.size:
            levels = jnp.asarray(levels).at[0].set(jnp.maximum(levels[0], _LEAST_LIGHT - 1))
        return ImageState(pose, values, levels, self.unknowns)


def ideal_state(
    pose: Pose, sigma_px: float, ratio: float, light: Float[np.ndarray, "_n"]
) -> ImageState:
    """State of an ideal camera for a print whose ink has not spread.

    Parameters
    ----------
    pose : pose of the camera.
    sigma_px : width of the blur.
    ratio : grey level of ink divided by that of paper, minus 1.
    light : first coefficients of the light.
    """
    values = np.zeros(IDEAL.size)
    values[IDEAL.indices("sigma_px", "ratio")] = sigma_px, ratio
    values[IDEAL.light[0] : IDEAL.light[0] + len(light)] = light
    return ImageState(pose, values, np.zeros((LOCAL_TERMS, 0)), IDEAL)


def full_state(ideal: ImageState, tuning: PhotometricTuning) -> ImageState:
    """State of the full model with the values of an ideal camera.

    Unknowns that the ideal camera does not have are at their prior means.

    Parameters
    ----------
    ideal : state of an ideal camera.
    tuning : constants of the fit, with the priors.
    """
    values = np.array(FULL.prior(tuning, local=False).mean)
    values[FULL.ideal_camera_indices] = ideal.values
    return ImageState(ideal.pose, values, ideal.levels, FULL)


def step_unit_mm(pose: Pose, model: PoseModel) -> ScalarLike:
    """Unit of length in steps of a pose, mm.

    The unit is the distance from the camera to the sheet along the optical axis. For
    `PoseModel.RIGID`, where this axis may miss the sheet, the unit is the distance from the camera
    to the sheet's origin.
    """
    if model is PoseModel.RIGID:
        return jnp.sqrt(pose.translation_mm @ pose.translation_mm)
    return pose.distance_mm
