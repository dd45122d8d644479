"""The state of the fit of one picture, from its first look at the pixels to its last."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.equations import Prediction
from trinoc.calib.photometric.noise import clipped_moments, is_clear
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.unknowns import PictureState
from trinoc.calib.problem.solver import ArrowEquations


class PictureFitState(eqx.Module):
    """Unknowns of one picture, its predicted pixels, and the noise that weighs them.

    Fields
    ------
    state : value of every unknown.
    free : (p + k,) which of (pose, values) are estimated.
    prediction : pixels and their derivatives at the state.
    level : (n,) predicted grey levels before saturation.
    sigma : (n,) noise of each pixel before saturation.
    kept : (n,) pixels that show the sheet.
    equations : of all unknowns by these pixels, as plain least squares; None until they are
        needed.
    promised : gain of chi-square that the next step promises.
    """

    state: PictureState
    free: Bool[np.ndarray, "k"]
    prediction: Prediction
    level: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]
    kept: Bool[np.ndarray, "n"]
    equations: ArrowEquations | None = None
    promised: float = np.inf

    def with_pixels(
        self, *, sigma: Float[np.ndarray, "n"], kept: Bool[np.ndarray, "n"] | None = None
    ) -> "PictureFitState":
        """The same unknowns with another noise, and other pixels if they are given."""
        kept = self.kept if kept is None else kept
        return dataclasses.replace(self, sigma=sigma, kept=kept, equations=None, promised=np.inf)

    def with_free(self, free: Bool[np.ndarray, "k"]) -> "PictureFitState":
        """The same with other unknowns that are estimated."""
        return dataclasses.replace(self, free=free, promised=np.inf)

    def residual(self, scene: PixelScene) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Predicted minus observed grey levels after saturation, and their standard deviation."""
        if np.isinf(scene.top):
            return self.level - scene.grey, self.sigma
        cut = clipped_moments(self.level, self.sigma, scene.saturation)
        return np.asarray(cut.mean) - scene.grey, np.asarray(cut.sigma)

    def is_clear(self, scene: PixelScene) -> Bool[np.ndarray, "n"]:
        """Kept pixels whose noise saturation leaves as it is."""
        clear_sigmas = scene.tuning.clear_sigmas
        return self.kept & is_clear(self.level, self.sigma, scene.top, clear_sigmas)

    def rows(self, scene: PixelScene) -> Float[np.ndarray, "k n"]:
        """Derivatives of every pixel after saturation by the homography and by the values."""
        rows = scene.join((self.prediction.near_circles.rows, self.prediction.near_lines.rows))
        return rows * self._slope(scene)

    def rows_by_local(self, scene: PixelScene) -> Float[np.ndarray, "2 n"]:
        """Derivatives of every pixel after saturation by the light's and the veil's local level."""
        near_circles, near_lines = self.prediction.near_circles, self.prediction.near_lines
        rows = scene.join((near_circles.by_local, near_lines.by_local))
        return rows * self._slope(scene)

    def _slope(self, scene: PixelScene) -> Float[np.ndarray, "n"] | np.float32:
        if self.state.unknowns.is_ideal or np.isinf(scene.top):
            return np.float32(1.0)
        return np.asarray(
            clipped_moments(self.level, self.sigma, scene.saturation).slope, np.float32
        )

    def normal_equations(
        self,
    ) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k"], Float[np.ndarray, "b 6 k"]]:
        """(matrix, gradient) of pose and values, all local levels eliminated, and how these follow
        a step."""
        assert self.equations is not None
        arrow, (of_head, of_blocks) = self.equations.information, self.equations.gradient
        coupling = np.swapaxes(np.asarray(arrow.coupling), 1, 2)
        follow = -np.linalg.solve(np.asarray(arrow.blocks), coupling)
        matrix = np.asarray(arrow.head) + np.einsum("bik,bil->kl", coupling, follow)
        return matrix, np.asarray(of_head) + np.einsum("bik,bi->k", follow, of_blocks), follow
