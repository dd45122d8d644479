"""From what each camera saw to cameras in one frame and a board in every shot."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.problem.views import View
from trinoc.calib.shots.apart import boards_apart, cameras_apart
from trinoc.calib.shots.chain import placed_shot
from trinoc.calib.shots.connected import connected, in_set
from trinoc.calib.shots.exchanged import exchanged_pair
from trinoc.calib.shots.lens_start import CameraStart
from trinoc.calib.shots.sightings import Sighting, sighting
from trinoc.calib.targets import AbstractTarget, board_names
from trinoc.errors import CalibrationError

# A shot by its name, and a board by its number.
ShotBoard = tuple[str, int]
# What the name of a shot goes on with where one camera's picture of it stands for itself.
_ALONE = " of {} alone"


class PlacedRig(NamedTuple):
    """A start for the joint fit.

    Fields
    ------
    cam_from_rig : (c, 3, 4).
    set_from_board : (b, 3, 4) of each of several boards; of one no motion.
    rig_from_board : (s, 3, 4) of each shot, those included that were split off.
    shots : the name of each.
    views : what was seen, labelled.
    refused : sentences on pictures that show the board elsewhere than the others of their shot.
    """

    cam_from_rig: Float[np.ndarray, "c 3 4"]
    set_from_board: Float[np.ndarray, "b 3 4"]
    rig_from_board: Float[np.ndarray, "s 3 4"]
    shots: tuple[str, ...]
    views: tuple[View, ...]
    refused: tuple[str, ...]


def placed_rig(
    starts: Mapping[str, CameraStart],
    detections: Mapping[str, Mapping[ShotBoard, Detection]],
    shots: Sequence[str],
    target: AbstractTarget,
    known: Collection[str] = (),
) -> PlacedRig:
    """Chain the cameras and place the board of every shot. `known` : cameras with a given lens.

    detections : of each camera, by the shot's name and the number of the board.

    A picture that shows the board elsewhere than the other cameras of its shot keeps a board of
    its own: it still speaks of its lens. Raises CalibrationError where cameras are not connected,
    naming the groups, or out of step, and where boards are not.
    """
    names = list(starts)
    seen = {
        k: [
            sighting(k, shots.index(shot), start.lens, each, pose, target, board)
            for ((shot, board), each), pose in zip(
                detections[camera].items(), start.cam_from_board, strict=True
            )
        ]
        for k, (camera, start) in enumerate(starts.items())
    }
    members = board_names(target)
    found = connected(seen, range(len(members)), target)
    _expect_boards_seen(seen, members)
    if len(found.cameras) > 1:
        raise CalibrationError(cameras_apart(found, names, seen, target, known))
    if len(found.boards) > 1:
        raise CalibrationError(boards_apart(found.boards, members))
    poses, fixed = found.cameras[0], found.boards
    boards, taken, views, refused = [], [], [], []
    for number, shot in enumerate(shots):
        own = [in_set(each, fixed) for k in seen for each in seen[k] if each.shot == number]
        if not own:
            continue
        placed = placed_shot(own, poses, target)
        views += [_view(each, labelling, len(boards)) for each, labelling in placed.members]
        boards.append(placed.rig_from_board)
        taken.append(shot)
        several = len({each.camera for each in own}) < len(own)
        pair = None
        if placed.stragglers and not several:
            pair = exchanged_pair(own, poses, target)
        if pair:
            a, b = (names[camera] for camera in pair)
            refused.append(
                f'{shot}: the pictures of "{a}" and "{b}" look exchanged: with each under the '
                "other's name, all cameras show the board in one place."
            )
        others = ", ".join(dict.fromkeys(names[each.camera] for each, _ in placed.members))
        for camera in dict.fromkeys(each.camera for each, _ in placed.stragglers):
            left = [each for each, _ in placed.stragglers if each.camera == camera]
            while left:
                alone = placed_shot(left, poses, target)
                views += [_view(each, turn, len(boards)) for each, turn in alone.members]
                boards.append(alone.rig_from_board)
                taken.append(f"{shot}{_ALONE.format(names[camera])}")
                left = [each for each, _ in alone.stragglers]
        for straggler, miss in placed.stragglers:
            which = f' "{members[straggler.board]}"' if len(members) > 1 else ""
            refused.append(
                f'{shot}: "{names[straggler.camera]}" shows the board{which} {miss:.0f} px from '
                f"where {others} show{'' if ',' in others else 's'} it, so it was not "
                "taken at the same moment, or shows another board that looks alike; it serves for "
                "its lens alone."
            )
    stacked = np.stack([poses[k] for k in range(len(names))])
    in_one = np.stack([fixed[0][board] for board in range(len(members))])
    return PlacedRig(stacked, in_one, np.stack(boards), tuple(taken), tuple(views), tuple(refused))


def of_one_moment(shot: str, camera: str) -> str:
    """The shot as it was given, from its name in a `PlacedRig`."""
    return shot.removesuffix(_ALONE.format(camera))


def _view(seen: Sighting, labelling: int, shot: int) -> View:
    detection = seen.detections[labelling]
    used = np.ones(len(detection), dtype=bool)
    return View(seen.camera, shot, detection, used, board=seen.board)


def _expect_boards_seen(seen: Mapping[int, Sequence[Sighting]], names: Sequence[str]) -> None:
    shown = {each.board for own in seen.values() for each in own}
    for board, name in enumerate(names):
        if board not in shown:
            raise CalibrationError(
                f'The board "{name}" is found in no picture, so that nothing tells where it is '
                "fixed: leave it out of the set, or show it."
            )
