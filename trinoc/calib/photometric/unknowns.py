"""The unknowns of one picture: names, bounds and weak priors; which of them an ideal camera has.

(pose, look, light, veil, levels): light and veil are polynomials over the picture, levels the
light about each block of the sheet. The unknowns that tell a delivered picture from an ideal
camera's have priors, so that what a picture does not show stays near nothing; their widths are
several times what cameras do.
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
# numerical: light and veil about each block of the sheet, with their slopes: (1, x, y) each.
LOCAL_TERMS = 6
# numerical: light that is left in the darkest shade: only this keeps the model from failing.
_LEAST_LIGHT = 0.05
_BEND = PowerResponse.PARAMETERS["bend"]
# Per unknown of the look: its bounds, and its value for an ideal camera.
# numerical: bounds keep steps where the model means something.
_LOOK = {
    # Blur of lens, motion and pixel: rms width along one axis, the mean over all directions, and
    # cumulants over powers of it, 0 for a Gaussian.
    "sigma_px": (0.1, 8.0, 0.0),
    "kurtosis": (-1.5, 3.0, 0.0),
    "sixth": (-6.0, 15.0, 0.0),
    # (variance along u - along v) / 2, covariance of u and v, and the variance across edges along
    # the picture's axes less that across diagonal ones, halved, px^2.
    "along_u": (-20.0, 20.0, 0.0),
    "diagonal": (-20.0, 20.0, 0.0),
    "along_axes": (-2.0, 2.0, 0.0),
    # 1 where the anisotropy is that of a straight motion, 0 where it is a Gaussian's.
    "line": (-0.5, 1.6, 0.0),
    # Sharpening: weight of a Gaussian that is taken away, by how much it is wider than the blur,
    # and how much further its ink reaches.
    "lobe": (-0.9, 4.0, 0.0),
    "lobe_px": (0.4, 3.0, 1.0),  # of a lobe of no weight it has no effect
    "lobe_mm": (-0.5, 0.5, 0.0),
    # By which ink reaches beyond the drawing.
    "spread_mm": (-2.0, 2.0, 0.0),
    # Grey level of ink over that of paper less one, in the middle of the picture.
    "ratio": (-0.999, -0.02, 0.0),
    # Response: its bend (0 linear, 1 sRGB), and further terms between ink and paper, c (1 - c) and
    # c (1 - c) (1 - 2 c) of the share c of ink.
    "bend": _BEND[:3],
    "lift": (-1.0, 1.0, 0.0),
    "contrast": (-1.0, 1.0, 0.0),
}


class PicturePrior(NamedTuple):
    """Independent Gaussian priors on the unknowns beside the pose.

    Fields
    ------
    mean : (k,) of each unknown.
    weight : (k,) one over the variance; 0 for an unknown without a prior.
    local_weight : (6,) the same of a block's levels, whose mean is 0.
    """

    mean: Float[ArrayLike, "k"]
    weight: Float[ArrayLike, "k"]
    local_weight: Float[ArrayLike, "6"]


class Unknowns(NamedTuple):
    """Which unknowns beside the pose a compiled program has; the others are an ideal camera's.

    Fields
    ------
    look : names, of blur, ink and response.
    light_terms, veil_terms : lowest terms of the two polynomials.
    """

    look: tuple[str, ...]
    light_terms: int
    veil_terms: int

    @property
    def size(self) -> int:
        """Number of unknowns beside the pose."""
        return len(self.look) + self.light_terms + self.veil_terms

    @property
    def is_ideal(self) -> bool:
        """Whether the camera is linear, its blur a Gaussian and its light a quadratic."""
        return self == IDEAL

    def places(self, *names: str) -> list[int]:
        """Places of unknowns of the look."""
        return [self.look.index(name) for name in names]

    @property
    def light(self) -> range:
        """Places of the light's terms."""
        return range(len(self.look), len(self.look) + self.light_terms)

    @property
    def veil(self) -> range:
        """Places of the veil's terms."""
        return range(len(self.look) + self.light_terms, self.size)

    @property
    def of_ideal_camera(self) -> list[int]:
        """Places of what an ideal camera has too."""
        return [*self.places(*IDEAL.look), *self.light[:QUADRATIC_TERMS]]

    @property
    def of_uneven_light(self) -> list[int]:
        """Places of light beyond a quadratic, and of a veil; its constant light and ratio hold."""
        return [*self.light[QUADRATIC_TERMS:], *self.veil[1:]]

    def bounds(self) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
        """The least and the largest value of each."""
        least, most = np.full((2, self.size), [[-np.inf], [np.inf]])
        for place, name in enumerate(self.look):
            least[place], most[place] = _LOOK[name][:2]
        return least, most

    def prior(self, tuning: PhotometricTuning, *, local: bool) -> PicturePrior:
        """Prior of every unknown beside the pose.

        local : if blocks have their own light, the polynomials have a prior too, because the images
            hardly separate the two.
        """
        priors = _look_priors(tuning)
        mean, sigma = np.zeros(self.size), np.full(self.size, np.inf)
        for index, name in enumerate(self.look):
            mean[index], sigma[index] = priors.get(name, (_LOOK[name][2], np.inf))
        if local:
            # A term of a polynomial is as large at the image's edge as a block's veil.
            sigma[self.light[1:]] = sigma[self.veil] = tuning.local_widths[3]
        return PicturePrior(mean, sigma**-2.0, np.array(tuning.local_widths) ** -2.0)


def _look_priors(tuning: PhotometricTuning) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of the unknowns of the look that have a prior."""
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
DELIVERED = Unknowns(tuple(_LOOK), LIGHT_TERMS, QUADRATIC_TERMS)


class PictureState(eqx.Module):
    """A value of every unknown of one picture.

    Fields
    ------
    pose : of the camera.
    values : look, light and veil.
    levels : (6, blocks) of light and of veil about each block of the sheet, (1, x, y) each, as
        shares of the light and as grey levels; no blocks where light is a polynomial alone.
    unknowns : which there are.
    """

    pose: Pose
    values: Float[ArrayLike, "k"]
    levels: Float[ArrayLike, "6 blocks"]
    unknowns: Unknowns = eqx.field(static=True)

    def __getitem__(self, name: str) -> Float[ArrayLike, ""]:
        """One number of the look; of an ideal camera where it is no unknown."""
        if name not in self.unknowns.look:
            return np.asarray(_LOOK[name][2], self.values.dtype)
        return self.values[self.unknowns.look.index(name)]

    @property
    def light(self) -> Float[ArrayLike, "m"]:
        """Coefficients of the paper's grey level."""
        return self.values[np.array(self.unknowns.light)]

    @property
    def veil(self) -> Float[ArrayLike, "m"]:
        """Coefficients of the light that is added to paper and ink alike."""
        return self.values[np.array(self.unknowns.veil, dtype=int)]

    @property
    def contrast(self) -> float:
        """Grey levels between paper and ink, in the middle of the picture."""
        return float(-self["ratio"] * self.light[0])

    def move(
        self,
        step: Float[ArrayLike, "k"],
        levels: Float[ArrayLike, "6 blocks"],
        model: PoseModel,
    ) -> "PictureState":
        """After a step of (pose, values), with other levels; all kept within bounds."""
        pose = self.pose.retract(step[: model.size], model, step_unit_mm(self.pose, model))
        least, most = self.unknowns.bounds()
        values = jnp.clip(self.values + step[model.size :], least, most)
        if levels.size:
            levels = jnp.asarray(levels).at[0].set(jnp.maximum(levels[0], _LEAST_LIGHT - 1))
        return PictureState(pose, values, levels, self.unknowns)


def ideal_state(
    pose: Pose, sigma_px: float, ratio: float, light: Float[np.ndarray, "_n"]
) -> PictureState:
    """Of an ideal camera whose ink does not spread."""
    values = np.zeros(IDEAL.size)
    values[IDEAL.places("sigma_px", "ratio")] = sigma_px, ratio
    values[IDEAL.light[0] : IDEAL.light[0] + len(light)] = light
    return PictureState(pose, values, np.zeros((LOCAL_TERMS, 0)), IDEAL)


def delivered_state(ideal: PictureState, tuning: PhotometricTuning) -> PictureState:
    """The same image, with the unknowns that an ideal camera lacks at the means of their priors."""
    values = np.array(DELIVERED.prior(tuning, local=False).mean)
    values[DELIVERED.of_ideal_camera] = ideal.values
    return PictureState(ideal.pose, values, ideal.levels, DELIVERED)


def step_unit_mm(pose: Pose, model: PoseModel) -> ScalarLike:
    """The unit of lengths in steps of a pose: its distance along the axis, or from the sheet's
    middle where the axis need not meet the sheet."""
    if model is PoseModel.RIGID:
        return jnp.sqrt(pose.translation_mm @ pose.translation_mm)
    return pose.distance_mm
