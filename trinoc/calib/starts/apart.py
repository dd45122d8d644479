"""Why cameras, or boards, are not in one frame, in sentences."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from trinoc.calib.starts.connected import Connected
from trinoc.calib.starts.links import link_cameras
from trinoc.calib.starts.sightings import Sighting
from trinoc.calib.targets import AbstractTarget
from trinoc.geometry import Pose

# Boards whose planes differ by less look parallel: focal length and distance look alike then.
PARALLEL_DEG = 8.0
# Cameras whose pictures were counted differently are tried this many shots apart.
_MOST_SHIFT = 3
# The sightings of one camera, by the numbers of shot and board.
_Seen = Mapping[tuple[int, int], Sighting]


def boards_are_parallel(poses: Sequence[Pose]) -> bool:
    """Whether boards at these poses are parallel to each other, of which there are several."""
    facing = np.array([pose.rotation[:, 2] for pose in poses])
    between = np.degrees(np.arccos(np.clip(np.abs(facing @ facing[0]), 0.0, 1.0)))
    return len(facing) > 1 and bool(between.max() < PARALLEL_DEG)


def explain_cameras_apart(
    found: Connected,
    names: Sequence[str],
    sightings: Mapping[int, Sequence[Sighting]],
    target: AbstractTarget,
    known: Collection[str],
) -> str:
    """Why the cameras are not in one frame. `known` : cameras with a given lens."""
    groups = found.cameras
    broken = [(pair, link) for pair, link in found.links.items() if not link.holds]
    for (a, b), _ in broken:
        shift = _shift_between(_by_shot(sightings[a]), _by_shot(sightings[b]), target)
        if shift:
            earlier = "earlier" if shift > 0 else "later"
            return (
                f'The pictures of "{names[b]}" fit those of "{names[a]}" that were taken '
                f"{abs(shift)} shot{'' if abs(shift) == 1 else 's'} {earlier}: the cameras are out "
                "of step; leave out the pictures that only one of them has, or name them alike."
            )
    parts = "; ".join(", ".join(names[k] for k in sorted(group)) for group in groups)
    if broken:
        (a, b), link = broken[0]
        for number in (a, b):
            camera = names[number]
            poses = [each.cam_from_board[0] for each in sightings[number]]
            if camera not in known and boards_are_parallel(poses):
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
    parts = "; ".join(", ".join(names[k] for k in sorted(group)) for group in groups)
    return (
        f"No shot tells how the boards are fixed to each other: the groups are {parts}. Show "
        "boards of two groups in one shot, to one camera or to cameras that other shots connect, "
        "and see that the boards stay fixed."
    )


def _by_shot(own: Sequence[Sighting]) -> _Seen:
    return {(each.shot, each.board): each for each in own}


def _shift_between(first: _Seen, second: _Seen, target: AbstractTarget) -> int:
    """By how many shots the second camera's pictures come too late; 0 where no shift helps."""
    for size in range(1, _MOST_SHIFT + 1):
        for shift in (size, -size):
            shared = sorted(key for key in first if (key[0] + shift, key[1]) in second)
            if len(shared) < 3:
                continue
            pairs = [(first[shot, board], second[shot + shift, board]) for shot, board in shared]
            link = link_cameras(pairs, target)
            if 2 * link.agreeing > link.shared:
                return shift
    return 0
