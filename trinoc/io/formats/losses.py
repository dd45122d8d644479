"""What files of other tools leave out although projections stay the same."""

import numpy as np

from trinoc.geometry.features import Feature
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches

COVARIANCE = "covariance"
PIXEL_PITCH = "pixel pitch"
WORLD = "world"
LENSES = "lenses"
NAMES = "names"
TRACKS = "tracks"
DETAILS = "details"
LOSSES = {
    COVARIANCE: "the covariance",
    PIXEL_PITCH: "the size of a pixel, and with it the focal length in mm",
    WORLD: "where the world is: the first camera becomes its origin",
    LENSES: "the lenses",
    NAMES: "the names of the cameras",
    TRACKS: "the fragments in the pictures, and which segments they are of",
    DETAILS: "polarity, contrast, junctions and chains",
}


def say_losses(value: object, loses: tuple[str, ...]) -> tuple[str, ...]:
    """Of `loses`, in words, what this value really has."""
    return tuple(LOSSES[loss] for loss in loses if _has(value, loss))


def _has(value: object, loss: str) -> bool:
    match value:
        case Rig() if loss == COVARIANCE:
            return bool(value.parameters)
        case Rig() if loss == PIXEL_PITCH:
            return any(camera.intrinsics.pixel_pitch_mm is not None for camera in value.cameras)
        case Rig() if loss == WORLD:
            pose = np.asarray(value.cameras[0].cam_from_world)
            return not np.array_equal(pose, np.eye(3, 4))
        case Rig():
            return True
        case Intrinsics():
            return loss == PIXEL_PITCH and value.pixel_pitch_mm is not None
        case Matches() | Feature():
            return len(value) > 0
        case Segments() if loss == DETAILS:
            return value.junctions is not None or bool(np.any(np.asarray(value.polarity) != 0))
        case Segments():
            return len(value) > 0
    return False
