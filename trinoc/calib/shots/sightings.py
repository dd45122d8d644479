"""The board in one picture, with every labelling that the board's symmetry leaves open."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.problem.motions import chained, inverse, motion_in_plane
from trinoc.calib.shots.lens_start import miss_px
from trinoc.calib.targets import AbstractTarget
from trinoc.geometry import AbstractLens

# Where one board stands in the frame of all, which is its own.
IN_PLACE = np.eye(3, 4)
# A first lens is a few percent off, and so is where it expects the board, in extents of it.
_AGREEMENT = 0.06
_SMALLEST_AGREEMENT_PX = 3.0


class Sighting(NamedTuple):
    """What one camera saw in one shot, and where the board then stood before it.

    Fields
    ------
    camera, shot : which; indices.
    lens : the camera's first lens.
    detections : the detection, in each labelling.
    cam_from_board : (3, 4) for each labelling.
    board : which of several boards it is.
    set_from_board : (3, 4) where this one is fixed among them, as far as that is known.
    """

    camera: int
    shot: int
    lens: AbstractLens
    detections: tuple[Detection, ...]
    cam_from_board: tuple[Float[np.ndarray, "3 4"], ...]
    board: int = 0
    set_from_board: Float[np.ndarray, "3 4"] = IN_PLACE

    @property
    def cam_from_set(self) -> tuple[Float[np.ndarray, "3 4"], ...]:
        """Where this board says that the set stands, for each labelling."""
        back = inverse(self.set_from_board)
        return tuple(chained(pose, back) for pose in self.cam_from_board)

    @property
    def agreement_px(self) -> float:
        """By how much the board may lie elsewhere and still be the same."""
        extent = float(np.ptp(self.detections[0].centres_px, axis=0).max())
        return max(_SMALLEST_AGREEMENT_PX, _AGREEMENT * extent)

    def nearest(
        self, cam_from_set: Float[np.ndarray, "3 4"], target: AbstractTarget
    ) -> tuple[int, float]:
        """The labelling that a given pose of the set fits best, and by how many pixels not."""
        cam_from_board = chained(cam_from_set, self.set_from_board)
        misses = [
            miss_px(self.lens, cam_from_board, each, target.centres_mm[each.circle_index])
            for each in self.detections
        ]
        best = int(np.argmin(misses))
        return best, misses[best]


def sighting(
    camera: int,
    shot: int,
    lens: AbstractLens,
    detection: Detection,
    cam_from_board: Float[np.ndarray, "3 4"],
    target: AbstractTarget,
    board: int = 0,
) -> Sighting:
    """All labellings of a detection, with the pose of the board in each."""
    index = [detection.circle_index]
    index += [] if detection.ambiguity is None else list(detection.ambiguity)
    places = [target.centres_mm[each] for each in index]
    return Sighting(
        camera,
        shot,
        lens,
        tuple(
            eqx.tree_at(
                lambda d: (d.circle_index, d.ambiguity),
                detection,
                (each, None),
                is_leaf=lambda leaf: leaf is None,
            )
            for each in index
        ),
        tuple(chained(cam_from_board, motion_in_plane(places[0], place)) for place in places),
        board,
    )
