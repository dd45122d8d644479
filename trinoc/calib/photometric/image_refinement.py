"""What the fit of one picture says: of an ideal camera, or of the extended model."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.model import SheetPoints
from trinoc.calib.photometric.appearance import LIGHT_TERMS, Appearance
from trinoc.calib.photometric.camera_covariance import CameraFit
from trinoc.calib.photometric.camera_scene import CameraScene
from trinoc.calib.photometric.found import found_in
from trinoc.calib.photometric.ideal_fit import IdealFit
from trinoc.geometry import Pose


class ImageRefinement(NamedTuple):
    """The fit of one picture, before anybody has judged it.

    Fields
    ------
    pose : where it ended.
    appearance : light, ink and blur of the picture.
    information : (p, p) of a step of the pose, lengths in units of its distance, for noise of one
        grey level, after the appearance has taken its share.
    noise : standard deviation of the residuals of the pixels that stayed, grey levels.
    noise_floor : the same of the picture's flat parts; `noise` itself of an extended model, whose
        noise depends on the grey level.
    pixels : number of pixels that stayed.
    pixels_cut : number of pixels near an edge that show something else than the sheet.
    converged : whether the last step was small against its own standard deviation.
    points : where the picture shows each circle and each piece of the crossed lines.
    found : what the picture shows of its camera and its light, in words; nothing where an ideal
        camera explains it.
    """

    pose: Pose
    appearance: Appearance
    information: Float[np.ndarray, "p p"]
    noise: float
    noise_floor: float
    pixels: int
    pixels_cut: int
    converged: bool
    points: SheetPoints
    found: tuple[str, ...] = ()


def of_ideal_camera(fit: IdealFit, noise_floor: float, points: SheetPoints) -> ImageRefinement:
    """The fit of an ideal camera, as its pixels were weighed."""
    return ImageRefinement(
        fit.state.pose,
        fit.state.appearance,
        fit.pose_information,
        fit.noise,
        noise_floor,
        int(fit.kept.sum()),
        int(np.sum(~fit.kept)),
        fit.converged,
        points,
    )


def of_extended_model(scene: CameraScene, fit: CameraFit, points: SheetPoints) -> ImageRefinement:
    """The extended fit in the words of the simple one.

    The information is that of the covariance for the noise at the middle grey level.
    """
    look = fit.state.look_of
    appearance = Appearance(
        np.asarray(look("sigma_px")),
        np.asarray(look("spread_mm")),
        np.asarray(look("ratio")),
        fit.state.light[:LIGHT_TERMS],
    )
    return ImageRefinement(
        fit.state.pose,
        appearance,
        np.linalg.inv(fit.covariance) * fit.sigma**2,
        fit.sigma,
        fit.sigma,
        int(fit.kept.sum()),
        int(np.sum(~fit.kept)),
        True,
        points,
        found_in(scene, fit),
    )
