"""What may be wrong with a set of segments, and the same set without it, to be matched again.

Pictures may be exchanged, turned, of another size than the rig states, or shifted. A shift is
estimated: where lines of the two other views should end in the picture, and where segments of it
that are parallel to them do end, differ by the shift more often than by anything else.
"""

from collections.abc import Callable, Iterator
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.geometry.projection import project_by_matrix
from trinoc.match.observations.match_input import FrameInput, order_ends
from trinoc.match.tracks.matches import Matches
from trinoc.match.tuning.tracks import DecoyTuning

# numerical: what a picture is turned by about its middle: along u, along v, by half a turn.
MIRRORED, UPSIDE_DOWN, TURNED = (np.diag(signs) for signs in ((-1.0, 1), (1, -1.0), (-1.0, -1.0)))
SAME = np.eye(2)  # numerical: neither turned nor of another size.

# numerical: fewer residuals than these show no shift.
FEWEST_RESIDUALS = 8


class Explanation(NamedTuple):
    """What is wrong with a frame, in words, and the frame without it."""

    words: str
    undone: FrameInput


def undo_mistakes(frame: FrameInput) -> Iterator[Iterator[Explanation]]:
    """Kinds of mistakes that can be undone as they are, the commonest first."""
    yield _exchange_views(frame)
    yield _turn_views(frame)
    yield _resize_views(frame)


def _exchange_views(frame: FrameInput) -> Iterator[Explanation]:
    for order in permutations(range(3)):
        moved = [k for k in range(3) if order[k] != k]
        if moved:
            which = " and ".join(f'"{frame.names[k]}"' for k in moved)
            cameras = frame.cameras.take(list(order))
            words = f"the pictures of {which} are exchanged"
            yield Explanation(words, frame._replace(cameras=cameras))


def _turn_views(frame: FrameInput) -> Iterator[Explanation]:
    for view, name in enumerate(frame.names):
        for change, word in ((TURNED, "upside down"), (MIRRORED, "mirrored")):
            words = f'the picture of "{name}" is {word}'
            yield Explanation(words, change_view(frame, view, change))


def _resize_views(frame: FrameInput) -> Iterator[Explanation]:
    """Segments of pictures, all of them or one, of half or twice the size that the rig states."""
    for scale, word in ((2.0, "half"), (0.5, "twice")):
        everywhere = frame
        for view in range(len(frame.names)):
            # About the corner of the picture, half a pixel before the first centre.
            corner = (scale - 1) * np.asarray(frame.cameras.size_px[view]) / 2
            everywhere = change_view(everywhere, view, scale * SAME, corner)
            one = change_view(frame, view, scale * SAME, corner)
            words = f'the segments of "{frame.names[view]}" are of a picture of {word} the size'
            yield Explanation(f"{words} of its camera's", one)
        words = f"the segments are of pictures of {word} the size of the cameras'"
        yield Explanation(words, everywhere)


def seems_shifted(frame: FrameInput, index: Int[np.ndarray, "t 3"], tuning: DecoyTuning) -> bool:
    """Whether a shift of one picture explains most of what its segments miss the lines of the two
    other views by: all of them are then off by n . s, with normals n and one shift s."""
    if len(index) < FEWEST_RESIDUALS:
        return False
    for view in range(3):
        normal, miss_px = _transfer(frame, index, view)
        shift, weight = np.zeros(2), np.ones(len(miss_px))
        for _ in range(tuning.shift_rounds):
            both = normal.T * weight
            shift = np.linalg.lstsq(both @ normal, both @ miss_px, rcond=None)[0]
            rest = np.abs(miss_px - normal @ shift)
            weight = 1 / (1 + (rest / max(np.median(rest), 1e-9)) ** 2)
        before, after = (np.median(np.abs(miss_px - normal @ s)) for s in (np.zeros(2), shift))
        if np.linalg.norm(shift) > tuning.least_shift_px and after < tuning.quieter * before:
            return True
    return False


def _transfer(
    frame: FrameInput, index: Int[np.ndarray, "t 3"], view: int
) -> tuple[Float[np.ndarray, "t 2"], Float[np.ndarray, "t"]]:
    """(unit normals of the lines in a view that the two other views predict, how far the middles
    of the segments lie from them, px)."""
    planes = []
    for other in {0, 1, 2} - {view}:
        ends = np.pad(
            frame.ends_px[other][index[:, other]], ((0, 0), (0, 0), (0, 1)), constant_values=1.0
        )
        planes.append(np.cross(ends[:, 0], ends[:, 1]) @ frame.cameras.matrix_px[other])
    matrix, centre = frame.cameras.matrix_px[view], np.append(frame.cameras.centre_mm[view], 1.0)
    # The plane of the pencil of both that holds this camera's centre is the line's image.
    first, second = planes
    through = (second @ centre)[:, None] * first - (first @ centre)[:, None] * second
    line = np.linalg.solve(matrix[:, :3].T, through[:, :3].T).T
    line = line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    middle = frame.ends_px[view][index[:, view]].mean(axis=1)
    return line[:, :2], (line[:, :2] * middle).sum(axis=1) + line[:, 2]


def find_shifts(
    frame: FrameInput, match: Callable[[FrameInput], Matches], tuning: DecoyTuning
) -> Iterator[Explanation]:
    """Each picture in turn shifted by what the lines of the two others say."""
    for others in combinations(range(3), 2):
        view = 3 - sum(others)
        lines_mm = match(take_views(frame, list(others))).lines_mm
        expected = project_by_matrix(frame.cameras.matrix_px[view], lines_mm)
        shift = estimate_shift(expected, frame.ends_px[view], tuning)
        if shift is not None and np.hypot(*shift) > tuning.least_shift_px:
            words = (
                f'the picture of "{frame.names[view]}" is shifted by about '
                f"({shift[0]:.0f}, {shift[1]:.0f}) px against its camera (it is cut, or its "
                "principal point or the camera has moved)"
            )
            yield Explanation(words, change_view(frame, view, SAME, -shift))


def estimate_shift(
    expected_px: Float[np.ndarray, "t 2 2"],
    segments_px: Float[np.ndarray, "n 2 2"],
    tuning: DecoyTuning,
) -> Float[np.ndarray, "2"] | None:
    """By how much segments lie beside where lines are expected, most often; None where none of
    them is parallel to any line within reach."""
    way, turn = (np.diff(each, axis=1)[:, 0] for each in (expected_px, segments_px))
    sizes = np.outer(*(np.linalg.norm(each, axis=1) for each in (way, turn)))
    area = way[:, :1] * turn[:, 1] - way[:, 1:] * turn[:, 0]
    parallel = np.abs(area) < np.sin(np.radians(tuning.parallel_deg)) * sizes
    i, j = np.nonzero(parallel)
    ends = np.where(
        (way[i] * turn[j]).sum(axis=1)[:, None, None] < 0, segments_px[j, ::-1], segments_px[j]
    )
    apart = (ends - expected_px[i]).reshape(-1, 2)
    apart = apart[(np.abs(apart) < tuning.reach_px).all(axis=1)]
    if len(apart) == 0:
        return None
    tree = KDTree(apart)
    number = tree.query_ball_point(apart, tuning.agree_px, return_length=True)
    shift = apart[np.argmax(number)]
    for _ in range(tuning.shift_rounds):
        shift = np.median(apart[tree.query_ball_point(shift, tuning.agree_px)], axis=0)
    return shift


def change_view(
    frame: FrameInput,
    view: int,
    change: Float[np.ndarray, "2 2"],
    shift_px: Float[np.ndarray, "2"] | float = 0.0,
) -> FrameInput:
    """The frame with the segments of a view changed about the picture's middle, then shifted."""
    middle = (np.asarray(frame.cameras.size_px[view]) - 1) / 2
    ends = (frame.ends_px[view] - middle) @ change.T + middle + shift_px
    both = np.kron(np.eye(2), change)
    # Tables hold ends from left to right, and segments in the order of their places.
    ends, covariance, swap = order_ends(ends, both @ frame.covariance_px2[view] @ both.T)
    # The darker side changes with the ends, and with the handedness of the picture.
    exchanged = swap ^ (np.linalg.det(change) < 0)
    polarity = np.where(exchanged, -1, 1) * frame.polarity[view]
    sides = np.where(
        exchanged[:, None], frame.sides[view][:, [1, 0, 3, 2, 4, 5, 6]], frame.sides[view]
    )
    changed = {
        "ends_px": ends,
        "covariance_px2": covariance,
        "polarity": polarity,
        "sides": sides,
    }
    columns = {
        name: [new if k == view else own for k, own in enumerate(getattr(frame, name))]
        for name, new in changed.items()
    }
    rows = [np.arange(len(own)) for own in frame.order]
    rows[view] = np.lexsort(ends.reshape(-1, 4).T[::-1])
    return _take_segments(frame._replace(**columns), rows)


def take_longest(frame: FrameInput, most: int) -> FrameInput:
    """The frame with the longest segments of each view, the likeliest to be seen by all."""
    length = [np.linalg.norm(np.diff(ends, axis=1)[:, 0], axis=1) for ends in frame.ends_px]
    rows = [np.sort(np.argsort(-own, kind="stable")[:most]) for own in length]
    # They are numbered anew: nobody asks what becomes of the others.
    order = [np.arange(len(own)) for own in rows]
    left_out = [np.full(len(own), "") for own in rows]
    return _take_segments(frame, rows)._replace(order=order, left_out=left_out)


def _take_segments(frame: FrameInput, rows: list[Int[np.ndarray, "_"]]) -> FrameInput:
    """The frame with some segments of each view, in the order of `rows`."""
    columns = {
        name: [own[of_view] for own, of_view in zip(getattr(frame, name), rows, strict=True)]
        for name in ("order", "ends_px", "covariance_px2", "polarity", "sides")
    }
    return frame._replace(**columns)


def take_views(frame: FrameInput, views: list[int]) -> FrameInput:
    """The frame with some of its views."""
    columns = {
        name: [column[view] for view in views]
        for name, column in frame._asdict().items()
        if isinstance(column, list)
    }
    names = tuple(frame.names[view] for view in views)
    return frame._replace(names=names, cameras=frame.cameras.take(views), **columns)
