"""What a picture was found to be, in words."""

import numpy as np

from trinoc.calib.photometric.camera_covariance import CameraFit
from trinoc.calib.photometric.camera_scene import CameraScene
from trinoc.calib.photometric.correlated_noise import inflation
from trinoc.calib.photometric.unknowns import LOOK_NAMES
from trinoc.image import PowerResponse

# Said from so many standard deviations on, and from these amounts on.
_SIGMAS = 4.0
_LEAST_BEND, _LEAST_LOBE, _LEAST_MOTION_PX = 0.03, 0.03, 0.5
_LEAST_INFLATION = 1.2
_SATURATED_SHARE = 0.01


def found_in(scene: CameraScene, fit: CameraFit) -> tuple[str, ...]:
    """Sentences' halves such as "sharpened" or "saturated paper", the surest only."""
    said = []
    bend, sigma = fit.state.look_of("bend"), _sigma(fit, "bend")
    if scene.bend is None and abs(bend) > max(_SIGMAS * sigma, _LEAST_BEND):
        curve = f"{PowerResponse(bend).words} ({bend:.2f} +- {sigma:.2f}, 0 linear, 1 sRGB)"
        said.append(f"response {curve}")
    if _is_sure(fit, "contrast"):
        said.append("response with an s-curve")
    lobe = fit.state.look_of("lobe")
    if _is_sure(fit, "lobe") and lobe > _LEAST_LOBE:
        said.append(f"sharpened ({lobe:.2f})")
    elif _is_sure(fit, "lobe") and lobe < -_LEAST_LOBE:
        said.append("blur with wide tails")
    if _is_sure(fit, "kurtosis") and fit.state.look_of("kurtosis") < 0:
        said.append("blur with a flat top")
    said += _motion(fit)
    if np.mean(scene.grey >= scene.top - 0.5) > _SATURATED_SHARE:
        said.append("saturated paper")
    if fit.state.levels.shape[1]:
        said.append("uneven light")
    shared = inflation(fit.correlation)
    if shared > _LEAST_INFLATION:
        said.append(f"noise that neighbours share ({shared:.1f} times the variance)")
    return tuple(said)


def _motion(fit: CameraFit) -> list[str]:
    along, across = fit.state.look_of("along_u"), fit.state.look_of("diagonal")
    amount = float(np.hypot(along, across))
    sigma = max(_sigma(fit, "along_u"), _sigma(fit, "diagonal"))
    # A line of even light has length^2 / 12 of variance, half of it in the anisotropy.
    length = float(np.sqrt(24 * amount))
    if amount < _SIGMAS * sigma or length < _LEAST_MOTION_PX or amount == 0:
        return []
    angle = float(np.degrees(np.arctan2(across, along)) / 2) % 180
    return [f"moved by {length:.1f} px at {angle:.0f} degrees"]


def _sigma(fit: CameraFit, name: str) -> float:
    return float(fit.spread_of[LOOK_NAMES.index(name)])


def _is_sure(fit: CameraFit, name: str) -> bool:
    sigma = _sigma(fit, name)
    return sigma > 0 and abs(fit.state.look_of(name)) > _SIGMAS * sigma
