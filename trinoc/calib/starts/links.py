"""Relative poses of cameras, and of boards, on which shots agree.

Each shot in which two cameras see one board gives a relative pose of both. A pose on which many
shots agree is accepted. Cameras that never see the board in the same shot are chained through
others.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from trinoc.calib.starts.sightings import IN_PLACE, Sighting
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.geometry.pose import Pose

# numerical: shots that propose a relative pose, and shots that test it; both bound the time.
_PROPOSALS, _TESTS = 8, 24

# cam_from_rig, or set_from_board, by index.
Poses = dict[int, Pose]


class Link(NamedTuple):
    """Relative pose of two cameras, or of two boards, and the number of shots that agree on it.

    Attributes
    ----------
    second_from_first : the relative pose.
    shared : number of tested shots that show both.
    agreeing : number of these shots that agree on the pose.
    """

    second_from_first: Pose
    shared: int
    agreeing: int

    @property
    def holds(self) -> bool:
        """True if enough shots agree: at least two (or the only one), and a third of
        those tested.
        """
        return self.agreeing >= min(2, self.shared) and 3 * self.agreeing >= self.shared


Links = dict[tuple[int, int], Link]


def link_cameras(
    pairs: Sequence[tuple[Sighting, Sighting]], target: AbstractTarget, tuning: CalibTuning
) -> Link:
    """Relative pose of two cameras on which most shots agree.

    pairs : for each shot, one detection by each camera. Both show the same board, or boards with a
        known relative pose.
    """

    def labellings(one: Sighting, other: Sighting) -> tuple[Pose, ...]:
        """Poses of the board, or set of boards, relative to the first camera that must be tried.

        If both cameras see the same board, one labelling of the first is enough, because all
        labellings of the second are tried.
        """
        return one.cam_from_set[:1] if one.board == other.board else one.cam_from_set

    return _most_agreed(
        [(labellings(one, other), other.cam_from_set, other) for one, other in pairs],
        lambda first, second: second @ first.inverse,
        lambda step, first: step @ first,
        target,
        tuning,
    )


def link_boards(
    pairs: Sequence[tuple[Sighting, Sighting, Poses]], target: AbstractTarget, tuning: CalibTuning
) -> Link:
    """Relative pose of two boards on which most shots agree.

    pairs : one detection of each board in the same shot, with cam_from_rig of the cameras.
    """

    def before_second(one: Sighting, other: Sighting, poses: Poses) -> list[Pose]:
        """Pose of the first board relative to the camera that sees the second board, for each
        labelling.
        """
        step = poses[other.camera] @ poses[one.camera].inverse
        return [step @ pose for pose in one.cam_from_board]

    link = _most_agreed(
        [(before_second(*pair), pair[1].cam_from_board, pair[1]) for pair in pairs],
        lambda first, second: first.inverse @ second,
        lambda first_from_second, first: first @ first_from_second,
        target,
        tuning,
    )
    return link._replace(second_from_first=link.second_from_first.inverse)


def _most_agreed(
    pairs: Sequence[tuple[Sequence[Pose], Sequence[Pose], Sighting]],
    between: Callable[[Pose, Pose], Pose],
    apply: Callable[[Pose, Pose], Pose],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> Link:
    """Relative motion of two poses on which most pairs agree.

    Parameters
    ----------
    pairs : possible first poses, possible second poses, and the detection that belongs to the
        second.
    between : function of (first, second) that returns the motion.
    apply : function of (motion, first) that returns the predicted second pose.
    target : the board.
    tuning : limits of agreement.
    """
    tests = [pairs[k] for k in _spread(len(pairs), _TESTS)]
    best, best_score = Link(IN_PLACE, len(tests), 0), (-1, 0.0)
    for k in _spread(len(pairs), _PROPOSALS):
        firsts, seconds, _ = pairs[k]
        for second, first in product(seconds, firsts):
            step = between(first, second)
            errors = [
                min(sighting.nearest(apply(step, start), target)[1] for start in starts)
                / sighting.agreement_px(tuning)
                for starts, _, sighting in tests
            ]
            agreeing = int(np.sum(np.array(errors) < 1.0))
            score = (agreeing, -float(np.median(errors)))
            if score > best_score:
                best, best_score = Link(step, len(tests), agreeing), score
    return best


def chain_links(links: Links, members: Iterable[int]) -> list[Poses]:
    """Groups of cameras (or of boards) that links connect.

    Each group maps a member to its pose member_from_first, relative to the first member of the
    group. Links on which more shots agree are preferred (maximum spanning tree, Prim's algorithm).
    """
    remaining, groups = list(members), []
    while remaining:
        poses = {remaining[0]: IN_PLACE}
        while True:
            edges = [
                (link.agreeing, inner, outer, step)
                for (a, b), link in links.items()
                if link.holds
                for inner, outer, step in (
                    (a, b, link.second_from_first),
                    (b, a, link.second_from_first.inverse),
                )
                if inner in poses and outer not in poses
            ]
            if not edges:
                break
            _, inner, outer, step = max(edges, key=lambda edge: edge[0])
            poses[outer] = step @ poses[inner]
        groups.append(poses)
        remaining = [member for member in remaining if member not in poses]
    return groups


class AgreedBoard(NamedTuple):
    """Pose of the board in one shot, and the detections that agree with it.

    Attributes
    ----------
    members : (detection, index of its labelling) of each detection that agrees.
    rig_from_board : the pose.
    outliers : (detection, error in px) of each detection of the shot that does not agree.
    """

    members: list[tuple[Sighting, int]]
    rig_from_board: Pose
    outliers: list[tuple[Sighting, float]]


def place_board(
    sightings: Sequence[Sighting],
    cam_from_rig: Mapping[int, Pose],
    target: AbstractTarget,
    tuning: CalibTuning,
) -> AgreedBoard:
    """Find the pose of the board in one shot on which most cameras agree.

    sightings : detections of the shot, with the pose of the board relative to each camera.
    cam_from_rig : pose of each camera; the key is the index of the camera.
    """
    # A single board may be turned wherever it looks the same; a board of a set may not.
    is_set = len({sighting.board for sighting in sightings}) > 1
    best: tuple[float, AgreedBoard] | None = None
    for proposer in sightings:
        for labelling, cam_from_set in enumerate(
            proposer.cam_from_set if is_set else proposer.cam_from_set[:1]
        ):
            board = cam_from_rig[proposer.camera].inverse @ cam_from_set
            members, outliers, total = [], [], 0.0
            for sighting in sightings:
                turn, error_px = labelling, 0.0
                if sighting is not proposer:
                    turn, error_px = sighting.nearest(cam_from_rig[sighting.camera] @ board, target)
                agreement_px = sighting.agreement_px(tuning)
                total += min(error_px / agreement_px, 1.0)
                if error_px < agreement_px:
                    members.append((sighting, turn))
                else:
                    outliers.append((sighting, error_px))
            if best is None or total < best[0]:
                best = total, AgreedBoard(members, board, outliers)
    assert best is not None
    return best[1]


def _spread(count: int, largest: int) -> list[int]:
    """At most `largest` of the integers 0 to `count` - 1, evenly spaced."""
    return sorted({int(k) for k in np.linspace(0, count - 1, min(count, largest)).round()})
