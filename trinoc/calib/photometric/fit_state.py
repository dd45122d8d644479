"""Intermediate state of the fit of one image."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.equations import Prediction
from trinoc.calib.photometric.noise import clipped_moments, is_clear
from trinoc.calib.photometric.scene import PixelScene
from trinoc.calib.photometric.unknowns import ImageState
from trinoc.calib.problem.solver import ArrowEquations


class ImageFitState(eqx.Module):
    """Values of the unknowns of one image during its fit, the predicted pixels, and their noise.

    Attributes
    ----------
    state : values of all unknowns.
    free : (p + k,) mask of the estimated unknowns: p of the pose, then k of the image.
    prediction : predicted pixels and derivatives at `state`.
    level : (n,) predicted grey levels before saturation.
    sigma : (n,) standard deviation of the noise of each pixel before saturation, grey levels.
    inliers : (n,) mask of the pixels that show the sheet.
    equations : normal equations of all unknowns from the inliers; None until they are needed.
    predicted_gain : decrease of chi-square by the next step, predicted by the linearised model.
    """

    state: ImageState
    free: Bool[np.ndarray, "k"]
    prediction: Prediction
    level: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]
    inliers: Bool[np.ndarray, "n"]
    equations: ArrowEquations | None = None
    predicted_gain: float = np.inf

    def with_pixels(
        self, *, sigma: Float[np.ndarray, "n"], inliers: Bool[np.ndarray, "n"] | None = None
    ) -> "ImageFitState":
        """Copy with another noise of the pixels, and with other inliers if they are given."""
        inliers = self.inliers if inliers is None else inliers
        return dataclasses.replace(
            self, sigma=sigma, inliers=inliers, equations=None, predicted_gain=np.inf
        )

    def with_free(self, free: Bool[np.ndarray, "k"]) -> "ImageFitState":
        """Copy with another mask of estimated unknowns."""
        return dataclasses.replace(self, free=free, predicted_gain=np.inf)

    def residual(self, scene: PixelScene) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Residuals of all pixels and their standard deviations, grey levels.

        A residual is the predicted level after saturation minus the observed level.
        """
        if np.isinf(scene.top):
            return self.level - scene.grey, self.sigma
        clipped = clipped_moments(self.level, self.sigma, scene.saturation)
        return np.asarray(clipped.mean) - scene.grey, np.asarray(clipped.sigma)

    def is_clear(self, scene: PixelScene) -> Bool[np.ndarray, "n"]:
        """Mask of the inliers whose noise is not changed by saturation."""
        clear_sigmas = scene.tuning.clear_sigmas
        return self.inliers & is_clear(self.level, self.sigma, scene.top, clear_sigmas)

    def rows(self, scene: PixelScene) -> Float[np.ndarray, "k n"]:
        """Derivatives of the grey levels of all pixels after saturation, (9 + k, n).

        The first 9 rows are with respect to the elements of the homography, the other k with
        respect to the unknowns of the image.
        """
        rows = scene.join((self.prediction.near_circles.rows, self.prediction.near_lines.rows))
        return rows * self._slope(scene)

    def rows_by_local(self, scene: PixelScene) -> Float[np.ndarray, "2 n"]:
        """Derivatives of all grey levels after saturation, (2, n).

        They are with respect to the light and the veil (additional light on paper and ink alike)
        of each pixel's block.
        """
        near_circles, near_lines = self.prediction.near_circles, self.prediction.near_lines
        rows = scene.join((near_circles.by_local, near_lines.by_local))
        return rows * self._slope(scene)

    def _slope(self, scene: PixelScene) -> Float[np.ndarray, "n"] | np.float32:
        """Derivative of each mean grey level after saturation with respect to that before, (n,).

        It is the scalar 1 for an ideal camera and for an image without saturation.
        """
        if self.state.unknowns.is_ideal or np.isinf(scene.top):
            return np.float32(1.0)
        return np.asarray(
            clipped_moments(self.level, self.sigma, scene.saturation).slope, np.float32
        )

    def normal_equations(
        self,
    ) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k"], Float[np.ndarray, "b 6 k"]]:
        """Normal equations of the pose and the image's unknowns, with all local levels eliminated.

        The local levels describe the light and the veil of each block of the sheet.

        Returns
        -------
        Matrix (k, k) and gradient (k,) of the unknowns, and derivative (b, 6, k) of the optimal six
        local levels of each block with respect to the unknowns.
        """
        assert self.equations is not None
        arrow, (of_head, of_blocks) = self.equations.information, self.equations.gradient
        coupling = np.swapaxes(np.asarray(arrow.coupling), 1, 2)
        follow = -np.linalg.solve(np.asarray(arrow.blocks), coupling)
        matrix = np.asarray(arrow.head) + np.einsum("bik,bil->kl", coupling, follow)
        return matrix, np.asarray(of_head) + np.einsum("bik,bi->k", follow, of_blocks), follow
