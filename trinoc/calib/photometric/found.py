"""What a picture was found to be, in words."""

import numpy as np

from trinoc.calib.photometric.covariance import PoseCovariance, spread_of_values
from trinoc.calib.photometric.noise import inflation
from trinoc.calib.photometric.point import Point
from trinoc.calib.photometric.scene import Scene
from trinoc.image import PowerResponse

# Said from so many standard deviations on, and from these amounts on.
_SIGMAS = 4.0
_LEAST_BEND, _LEAST_LOBE, _LEAST_MOTION_PX = 0.03, 0.03, 0.5
_LEAST_INFLATION = 1.2
_SATURATED_SHARE = 0.01


def found_in(scene: Scene, point: Point, covariance: PoseCovariance) -> tuple[str, ...]:
    """Sentences' halves such as "sharpened" or "saturated paper", the surest only."""
    look = point.state.unknowns.look
    value = dict(zip(look, map(float, point.state.values), strict=False))
    sigma = dict(zip(look, map(float, spread_of_values(scene, point)), strict=False))
    sure = {name for name in look if 0 < _SIGMAS * sigma[name] < abs(value[name])}
    said, bend = [], value["bend"]
    if scene.bend is None and abs(bend) > max(_SIGMAS * sigma["bend"], _LEAST_BEND):
        curve = f"{PowerResponse(bend).words} ({bend:.2f} +- {sigma['bend']:.2f}, 0 linear, 1 sRGB)"
        said.append(f"response {curve}")
    if "contrast" in sure:
        said.append("response with an s-curve")
    if "lobe" in sure and value["lobe"] > _LEAST_LOBE:
        said.append(f"sharpened ({value['lobe']:.2f})")
    elif "lobe" in sure and value["lobe"] < -_LEAST_LOBE:
        said.append("blur with wide tails")
    if "kurtosis" in sure and value["kurtosis"] < 0:
        said.append("blur with a flat top")
    along, across = value["along_u"], value["diagonal"]
    said += _motion(along, across, max(sigma["along_u"], sigma["diagonal"]))
    if np.mean(scene.grey >= scene.top - 0.5) > _SATURATED_SHARE:
        said.append("saturated paper")
    if scene.local:
        said.append("uneven light")
    if covariance.correlation is not None:
        shared = inflation(covariance.correlation)
        if shared > _LEAST_INFLATION:
            said.append(f"noise that neighbours share ({shared:.1f} times the variance)")
    return tuple(said)


def _motion(along: float, across: float, sigma: float) -> list[str]:
    amount = float(np.hypot(along, across))
    # A line of even light has length^2 / 12 of variance, half of it in the anisotropy.
    length = float(np.sqrt(24 * amount))
    if amount < _SIGMAS * sigma or length < _LEAST_MOTION_PX or amount == 0:
        return []
    angle = float(np.degrees(np.arctan2(across, along)) / 2) % 180
    return [f"moved by {length:.1f} px at {angle:.0f} degrees"]
