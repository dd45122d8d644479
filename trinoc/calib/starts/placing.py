"""Initial poses of all cameras in one frame and of the board in every shot, or the reason of a
failure.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.views import BoardObservation
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
# Suffix of a shot's name for a camera whose image has a pose of its own.
_ALONE = " of {} alone"


class InitialRig(NamedTuple):
    """Initial poses for the fit of a rig to many shots.

    Attributes
    ----------
    cam_from_rig : (c, 3, 4) pose of each camera.
    set_from_board : (b, 3, 4) pose of each board in a set of boards that are fixed to each other;
        the identity for one board.
    rig_from_board : (s, 3, 4) pose of the board in each shot. An image that shows the board at
        another pose than the rest of its shot is a shot of its own.
    shots : name of each shot.
    views : observations, each with one assignment of detected points to board points.
    refused : sentences on images that show the board at another pose than the rest of their shot.
    """

    cam_from_rig: Float[np.ndarray, "c 3 4"]
    set_from_board: Float[np.ndarray, "b 3 4"]
    rig_from_board: Float[np.ndarray, "s 3 4"]
    shots: tuple[str, ...]
    views: tuple[BoardObservation, ...]
    refused: tuple[str, ...]


def place_rig(
    starts: Mapping[str, CameraStart],
    detections: Mapping[str, Mapping[ShotBoard, Detection]],
    shots: Sequence[str],
    target: AbstractTarget,
    cameras_with_lens: Collection[str] = (),
    *,
    tuning: CalibTuning = TUNING,
) -> InitialRig:
    """Compute initial poses of all cameras in one frame, and of the board in every shot.

    Parameters
    ----------
    starts : initial lens and board poses of each camera.
    detections : detections of each camera; the key is the name of the shot and the index of the
        board.
    shots : names of all shots.
    target : the board, or the set of boards.
    cameras_with_lens : names of the cameras whose lens is given.
    tuning : constants of the method.

    Notes
    -----
    An image that shows the board at another pose than the other images of its shot gets its own
    pose. It then contributes to its lens, but not to the relative poses of the cameras.

    Raises
    ------
    CalibrationError : the shots do not connect all cameras or all boards, or the shots of two
        cameras are shifted against each other. The sentence names the groups.
    """
    names, members = list(starts), board_names(target)
    sightings = {
        k: [
            label_sighting(k, shots.index(shot), start.lens, sighting, pose, target, board)
            for ((shot, board), sighting), pose in zip(
                detections[camera].items(), start.cam_from_board, strict=True
            )
        ]
        for k, (camera, start) in enumerate(starts.items())
    }
    connected = connect(sightings, range(len(members)), target, tuning)
    _expect_all_boards(sightings, members)
    if len(connected.cameras) > 1:
        raise CalibrationError(
            explain_cameras_apart(connected, names, sightings, target, cameras_with_lens, tuning)
        )
    if len(connected.boards) > 1:
        raise CalibrationError(explain_boards_apart(connected.boards, members))
    cam_from_rig, boards, shot_names = connected.cameras[0], [], []
    views: list[BoardObservation] = []
    refused: list[str] = []

    def add_shot(members: Sequence[Sighting], shot: str) -> list[tuple[Sighting, float]]:
        """Add a shot with the detections that agree on its board pose.

        Returns the other detections, each with its error in px.
        """
        agreed = place_board(members, cam_from_rig, target, tuning)
        for sighting, labelling in agreed.members:
            detection = sighting.detections[labelling]
            used = np.ones(len(detection), dtype=bool)
            views.append(
                BoardObservation(
                    sighting.camera, len(boards), detection, used, board=sighting.board
                )
            )
        boards.append(agreed.rig_from_board)
        shot_names.append(shot)
        return agreed.outliers

    all_sightings = [
        in_set(sighting, connected.boards)
        for camera_sightings in sightings.values()
        for sighting in camera_sightings
    ]
    for shot_index, shot in enumerate(shots):
        in_shot = [sighting for sighting in all_sightings if sighting.shot == shot_index]
        if not in_shot:
            continue
        outliers = add_shot(in_shot, shot)
        disagreeing = [sighting for sighting, _ in outliers]
        if disagreeing and len({sighting.camera for sighting in in_shot}) == len(in_shot):
            pair = find_exchanged_pair(in_shot, cam_from_rig, target, tuning)
            if pair:
                first, second = (names[camera] for camera in pair)
                refused.append(
                    f'{shot}: the images of "{first}" and "{second}" seem to be exchanged: with '
                    "exchanged names, all cameras show the board at one pose."
                )
        agreeing = [
            sighting.camera
            for sighting in in_shot
            if not any(sighting is other for other in disagreeing)
        ]
        others = list_names(dict.fromkeys(names[camera] for camera in agreeing))
        for camera in dict.fromkeys(sighting.camera for sighting in disagreeing):
            remaining = [sighting for sighting in disagreeing if sighting.camera == camera]
            own_shot = f"{shot}{_ALONE.format(names[camera])}"
            while remaining:
                remaining = [sighting for sighting, _ in add_shot(remaining, own_shot)]
        for outlier, error_px in outliers:
            board_name = f' "{members[outlier.board]}"' if len(members) > 1 else ""
            refused.append(
                f'{shot}: "{names[outlier.camera]}" shows the board{board_name} {error_px:.0f} px '
                f"from the position that {others} give{'' if ',' in others else 's'}, so the "
                "image was not taken at the same moment, or shows another board that looks the "
                "same. The image is used for the lens only."
            )
    return InitialRig(
        _stack(cam_from_rig),
        _stack(connected.boards[0]),
        np.stack([pose.cam_from_world for pose in boards]),
        tuple(shot_names),
        tuple(views),
        tuple(refused),
    )


def move_to_own_shots(
    initial_rig: InitialRig, problem: Problem, views: Sequence[int], cameras: Sequence[str]
) -> InitialRig:
    """Copy of an initial rig with one additional shot for each of the given observations.

    It has the names of the additional shots, and in `refused` a sentence on each observation.

    views : indices of the observations in `problem.views`.
    """
    names, refused = list(initial_rig.shots), list(initial_rig.refused)
    residuals = errors_px(problem)
    for k in views:
        moved = problem.views[k]
        camera, shot = cameras[moved.camera], initial_rig.shots[moved.shot]
        # The fitted board lies between the poses of two images, or at one of them.
        largest_px = max(
            float(np.median(np.linalg.norm(errors, axis=1)))
            for view, errors in zip(problem.views, residuals, strict=True)
            if view.shot == moved.shot
        )
        names.append(f"{shot}{_ALONE.format(camera)}")
        refused.append(
            f'{shot}: "{camera}" shows the board {largest_px:.1f} px from the position that the '
            "other cameras of the shot give, so the image was not taken at the same moment. The "
            "image is used for the lens only."
        )
    return initial_rig._replace(shots=tuple(names), refused=tuple(refused))


def original_shot_name(shot: str, camera: str) -> str:
    """Name that the user gave to a shot, from its name in an `InitialRig`."""
    return shot.removesuffix(_ALONE.format(camera))


def find_exchanged_pair(
    sightings: Sequence[Sighting],
    cam_from_rig: Poses,
    target: AbstractTarget,
    tuning: CalibTuning,
) -> tuple[int, int] | None:
    """Find two cameras whose images of one shot were probably exchanged.

    After the exchange, all cameras of the shot agree on the board pose. Returns the indices of the
    cameras. None if no exchange has this effect, or more than one.

    sightings : detections of the shot, with the pose of the board relative to each camera.
    cam_from_rig : pose of each camera; the key is the index of the camera.
    """
    pairs = []
    for first, second in combinations(range(len(sightings)), 2):
        first_sighting, second_sighting = sightings[first], sightings[second]
        if (
            first_sighting.detections[0].image_size_px
            != second_sighting.detections[0].image_size_px
        ):
            continue
        trial = list(sightings)
        try:
            for row, owner, giver in (
                (first, first_sighting, second_sighting),
                (second, second_sighting, first_sighting),
            ):
                poses = start_poses(owner.lens, giver.detections, target).cam_from_board
                trial[row] = owner._replace(detections=giver.detections, cam_from_board=poses)
        except CalibrationError:
            continue
        if not place_board(trial, cam_from_rig, target, tuning).outliers:
            pairs.append((first_sighting.camera, second_sighting.camera))
    return pairs[0] if len(pairs) == 1 else None


def _stack(poses: Poses) -> Float[np.ndarray, "k 3 4"]:
    return np.stack([poses[k].cam_from_world for k in range(len(poses))])


def _expect_all_boards(sightings: Mapping[int, Sequence[Sighting]], names: Sequence[str]) -> None:
    detected = {
        sighting.board for camera_sightings in sightings.values() for sighting in camera_sightings
    }
    for board, name in enumerate(names):
        if board not in detected:
            raise CalibrationError(
                f'The board "{name}" was found in no image, so its pose in the set is unknown: '
                "omit this board from the set, or show this board."
            )


def boards_are_parallel(poses: Sequence[Pose], *, tuning: CalibTuning = TUNING) -> bool:
    """True if the boards at all of these poses are nearly parallel to each other."""
    normals = np.array([pose.rotation[:, 2] for pose in poses])
    angles_deg = np.degrees(np.arccos(np.clip(np.abs(normals @ normals[0]), 0.0, 1.0)))
    return len(normals) > 1 and bool(angles_deg.max() < tuning.starts.parallel_deg)


def explain_cameras_apart(
    connected: ConnectedShots,
    names: Sequence[str],
    sightings: Mapping[int, Sequence[Sighting]],
    target: AbstractTarget,
    cameras_with_lens: Collection[str],
    tuning: CalibTuning,
) -> str:
    """Return the sentence that explains why the shots do not connect all cameras, with the remedy.

    connected : groups of cameras and boards with known relative poses.
    names : names of the cameras.
    sightings : detections of each camera; the key is its index.
    cameras_with_lens : names of the cameras whose lens is given.
    """
    groups = connected.cameras
    broken = [(pair, link) for pair, link in connected.links.items() if not link.holds]
    for (a, b), _ in broken:
        shift = _find_shift(sightings[a], sightings[b], target, tuning)
        if shift:
            earlier = "earlier" if shift > 0 else "later"
            return (
                f'The images of "{names[b]}" fit the images of "{names[a]}" that were taken '
                f"{abs(shift)} shot{'' if abs(shift) == 1 else 's'} {earlier}, so the shots of "
                "the two cameras do not correspond. Omit images that only one camera has, or give "
                "the images of one shot the same name."
            )
    parts = "; ".join(list_names(names[k] for k in sorted(group)) for group in groups)
    if broken:
        (a, b), link = broken[0]
        for number in (a, b):
            camera = names[number]
            poses = [sighting.cam_from_board[0] for sighting in sightings[number]]
            if camera not in cameras_with_lens and boards_are_parallel(poses, tuning=tuning):
                return (
                    f'The board is parallel in all shots of "{camera}", which determines neither '
                    "the lens nor the pose of this camera. Tilt the board by 30 to 50 degrees, in "
                    "a different direction in each shot, or give the lenses."
                )
        return (
            f'"{names[a]}" and "{names[b]}" share {link.shared} shots, but only {link.agreeing} of '
            f"these shots agree on the relative pose of the two cameras (the groups are {parts}). "
            "Check that images of equal names were taken at one moment, that no image is mirrored, "
            "and that the cameras did not move."
        )
    return (
        f"No shot connects the cameras: the groups are {parts}. Show the board to cameras of two "
        "groups at the same time, in at least two shots."
        + (
            " If the cameras show different boards, rotate the boards about at least two axes from "
            "shot to shot."
            if len(connected.boards) > 1
            else ""
        )
    )


def explain_boards_apart(groups: Sequence[Mapping[int, Pose]], names: Sequence[str]) -> str:
    """Return the sentence that the shots do not connect all boards, with the remedy.

    groups : groups of boards with known relative poses. names : names of the boards.
    """
    parts = "; ".join(list_names(names[k] for k in sorted(group)) for group in groups)
    return (
        f"No shot connects the boards: the groups are {parts}. Show boards of two groups in one "
        "shot, to one camera or to cameras that other shots connect, and keep the boards fixed to "
        "each other."
    )


def _find_shift(
    one: Sequence[Sighting],
    other: Sequence[Sighting],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> int:
    """Number of shots by which the images of the second camera are late; negative if they are
    early.

    0 if no shift makes most shots agree on the relative pose of both cameras.

    one, other : detections of the first and of the second camera.
    """
    first, second = (
        {(each.shot, each.board): each for each in sightings} for sightings in (one, other)
    )
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
