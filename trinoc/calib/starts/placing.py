"""From what each camera saw to cameras in one frame and a board in every shot; or why not."""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.views import View
from trinoc.calib.starts.camera_start import CameraStart, start_poses
from trinoc.calib.starts.connected import ConnectedShots, connect, in_set
from trinoc.calib.starts.links import Poses, link_cameras, place_board
from trinoc.calib.starts.sightings import Sighting, label_sighting
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import board_names
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import CalibrationError, list_names
from trinoc.geometry.pose import Pose

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


def place_rig(
    starts: Mapping[str, CameraStart],
    detections: Mapping[str, Mapping[ShotBoard, Detection]],
    shots: Sequence[str],
    target: AbstractTarget,
    known: Collection[str] = (),
    *,
    tuning: CalibTuning = TUNING,
) -> PlacedRig:
    """Chain the cameras and place the board of every shot. `known` : cameras with a given lens.

    detections : of each camera, by the shot's name and the number of the board.

    A picture that shows the board elsewhere than the other cameras of its shot keeps a board of
    its own: it still speaks of its lens. Raises CalibrationError where cameras are not connected,
    naming the groups, or out of step, and where boards are not.
    """
    names, members = list(starts), board_names(target)
    sightings = {
        k: [
            label_sighting(k, shots.index(shot), start.lens, each, pose, target, board)
            for ((shot, board), each), pose in zip(
                detections[camera].items(), start.cam_from_board, strict=True
            )
        ]
        for k, (camera, start) in enumerate(starts.items())
    }
    found = connect(sightings, range(len(members)), target, tuning)
    _expect_all_boards(sightings, members)
    if len(found.cameras) > 1:
        raise CalibrationError(
            explain_cameras_apart(found, names, sightings, target, known, tuning)
        )
    if len(found.boards) > 1:
        raise CalibrationError(explain_boards_apart(found.boards, members))
    cam_from_rig, boards, shot_names = found.cameras[0], [], []
    views: list[View] = []
    refused: list[str] = []

    def place(own: Sequence[Sighting], shot: str) -> list[tuple[Sighting, float]]:
        """Adds a shot, and returns the sightings that do not fit."""
        placed = place_board(own, cam_from_rig, target, tuning)
        for each, labelling in placed.members:
            detection = each.detections[labelling]
            used = np.ones(len(detection), dtype=bool)
            views.append(View(each.camera, len(boards), detection, used, board=each.board))
        boards.append(placed.rig_from_board)
        shot_names.append(shot)
        return placed.stragglers

    for number, shot in enumerate(shots):
        own = [in_set(s, found.boards) for each in sightings.values() for s in each]
        own = [each for each in own if each.shot == number]
        if not own:
            continue
        stragglers = place(own, shot)
        away = [each for each, _ in stragglers]
        if away and len({each.camera for each in own}) == len(own):
            pair = find_exchanged_pair(own, cam_from_rig, target, tuning)
            if pair:
                a, b = (names[camera] for camera in pair)
                refused.append(
                    f'{shot}: the pictures of "{a}" and "{b}" look exchanged: with each under the '
                    "other's name, all cameras show the board in one place."
                )
        agreeing = [each.camera for each in own if not any(each is other for other in away)]
        others = list_names(dict.fromkeys(names[camera] for camera in agreeing))
        for camera in dict.fromkeys(each.camera for each in away):
            left = [each for each in away if each.camera == camera]
            while left:
                left = [each for each, _ in place(left, f"{shot}{_ALONE.format(names[camera])}")]
        for straggler, miss in stragglers:
            which = f' "{members[straggler.board]}"' if len(members) > 1 else ""
            refused.append(
                f'{shot}: "{names[straggler.camera]}" shows the board{which} {miss:.0f} px from '
                f"where {others} show{'' if ',' in others else 's'} it, so it was not "
                "taken at the same moment, or shows another board that looks alike; it serves for "
                "its lens alone."
            )
    return PlacedRig(
        _stack(cam_from_rig),
        _stack(found.boards[0]),
        np.stack([pose.cam_from_world for pose in boards]),
        tuple(shot_names),
        tuple(views),
        tuple(refused),
    )


def take_out(
    placed: PlacedRig, problem: Problem, views: Sequence[int], cameras: Sequence[str]
) -> PlacedRig:
    """The placed rig with these views in shots of their own, and a sentence on each."""
    names, refused = list(placed.shots), list(placed.refused)
    misses = errors_px(problem)
    for k in views:
        view = problem.views[k]
        camera, shot = cameras[view.camera], placed.shots[view.shot]
        # The board lies between where two cameras show it, or where one of them does.
        miss_px = max(
            float(np.median(np.linalg.norm(errors, axis=1)))
            for each, errors in zip(problem.views, misses, strict=True)
            if each.shot == view.shot
        )
        names.append(f"{shot}{_ALONE.format(camera)}")
        refused.append(
            f'{shot}: "{camera}" shows the board {miss_px:.1f} px from where the other cameras of '
            "the shot show it, so it was not taken at the same moment; it serves for its lens "
            "alone."
        )
    return placed._replace(shots=tuple(names), refused=tuple(refused))


def of_one_moment(shot: str, camera: str) -> str:
    """The shot as it was given, from its name in a `PlacedRig`."""
    return shot.removesuffix(_ALONE.format(camera))


def find_exchanged_pair(
    sightings: Sequence[Sighting],
    cam_from_rig: Poses,
    target: AbstractTarget,
    tuning: CalibTuning,
) -> tuple[int, int] | None:
    """Two cameras that agree with all others of a shot once their pictures change places.

    None where no pair does, or more than one: with few cameras chance could choose.
    """
    found = []
    for a, b in combinations(range(len(sightings)), 2):
        one, other = sightings[a], sightings[b]
        if one.detections[0].image_size_px != other.detections[0].image_size_px:
            continue
        trial = list(sightings)
        try:
            for k, owner, giver in ((a, one, other), (b, other, one)):
                poses = start_poses(owner.lens, giver.detections, target).cam_from_board
                trial[k] = owner._replace(detections=giver.detections, cam_from_board=poses)
        except CalibrationError:
            continue
        if not place_board(trial, cam_from_rig, target, tuning).stragglers:
            found.append((one.camera, other.camera))
    return found[0] if len(found) == 1 else None


def _stack(poses: Poses) -> Float[np.ndarray, "k 3 4"]:
    return np.stack([poses[k].cam_from_world for k in range(len(poses))])


def _expect_all_boards(sightings: Mapping[int, Sequence[Sighting]], names: Sequence[str]) -> None:
    shown = {each.board for own in sightings.values() for each in own}
    for board, name in enumerate(names):
        if board not in shown:
            raise CalibrationError(
                f'The board "{name}" is found in no picture, so that nothing tells where it is '
                "fixed: leave it out of the set, or show it."
            )


def boards_are_parallel(poses: Sequence[Pose], *, tuning: CalibTuning = TUNING) -> bool:
    """Whether boards at these poses are parallel to each other, of which there are several."""
    facing = np.array([pose.rotation[:, 2] for pose in poses])
    between = np.degrees(np.arccos(np.clip(np.abs(facing @ facing[0]), 0.0, 1.0)))
    return len(facing) > 1 and bool(between.max() < tuning.starts.parallel_deg)


def explain_cameras_apart(
    found: ConnectedShots,
    names: Sequence[str],
    sightings: Mapping[int, Sequence[Sighting]],
    target: AbstractTarget,
    known: Collection[str],
    tuning: CalibTuning,
) -> str:
    """Why the cameras are not in one frame. `known` : cameras with a given lens."""
    groups = found.cameras
    broken = [(pair, link) for pair, link in found.links.items() if not link.holds]
    for (a, b), _ in broken:
        shift = _find_shift(sightings[a], sightings[b], target, tuning)
        if shift:
            earlier = "earlier" if shift > 0 else "later"
            return (
                f'The pictures of "{names[b]}" fit those of "{names[a]}" that were taken '
                f"{abs(shift)} shot{'' if abs(shift) == 1 else 's'} {earlier}: the cameras are out "
                "of step; leave out the pictures that only one of them has, or name them alike."
            )
    parts = "; ".join(list_names(names[k] for k in sorted(group)) for group in groups)
    if broken:
        (a, b), link = broken[0]
        for number in (a, b):
            camera = names[number]
            poses = [each.cam_from_board[0] for each in sightings[number]]
            if camera not in known and boards_are_parallel(poses, tuning=tuning):
                return (
                    f'The board is parallel in all shots of "{camera}", which tells no lens, and '
                    "without its lens not how it stands. Tilt the board by 30 to 50 degrees, "
                    "another way each time, or give the lenses."
                )
        return (
            f'"{names[a]}" and "{names[b]}" share {link.shared} shots, but only {link.agreeing} of '
            f"them agree on how the cameras stand (the groups are {parts}): see that pictures of "
            "equal names are of one moment, that no picture is mirrored, and that the cameras "
            "did not move."
        )
    return (
        f"No shot connects the cameras: the groups are {parts}. Show the board to cameras of two "
        "groups at once, in two shots at least."
        + (
            " Where they see different boards, these must turn about two axes at least from shot "
            "to shot."
            if len(found.boards) > 1
            else ""
        )
    )


def explain_boards_apart(groups: Sequence[Mapping[int, Pose]], names: Sequence[str]) -> str:
    """Which boards nothing connects, and what to do."""
    parts = "; ".join(list_names(names[k] for k in sorted(group)) for group in groups)
    return (
        f"No shot tells how the boards are fixed to each other: the groups are {parts}. Show "
        "boards of two groups in one shot, to one camera or to cameras that other shots connect, "
        "and see that the boards stay fixed."
    )


def _find_shift(
    one: Sequence[Sighting],
    other: Sequence[Sighting],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> int:
    """By how many shots the second camera's pictures come too late; 0 where no shift helps."""
    first, second = ({(each.shot, each.board): each for each in own} for own in (one, other))
    for size in range(1, tuning.starts.most_shift + 1):
        for shift in (size, -size):
            shared = sorted(key for key in first if (key[0] + shift, key[1]) in second)
            if len(shared) < 3:
                continue
            pairs = [(first[shot, board], second[shot + shift, board]) for shot, board in shared]
            link = link_cameras(pairs, target, tuning)
            if 2 * link.agreeing > link.shared:
                return shift
    return 0
