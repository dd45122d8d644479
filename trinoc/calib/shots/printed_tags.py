"""How the tags of an AprilGrid are turned on the print: programs differ, by quarters of a turn."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.motions import chained
from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.shots.lens_start import places_px
from trinoc.calib.targets import AprilGrid, marker_cells, opencv_dictionary

_MOST_VIEWS = 5


def quarters_of_tags(
    problem: Problem, board: AprilGrid, grey_of: Callable[..., Float[np.ndarray, "h w"]]
) -> int:
    """By how many quarters of a turn the tags lie elsewhere than `trinoc pattern` draws them.

    The turn in which cells of ink are darkest against the others, in the first pictures.
    """
    dictionary = opencv_dictionary(board.dictionary)
    cells = np.stack(
        [
            marker_cells(dictionary, number, border=board.border)
            for number in range(board.first, board.first + len(board.tags_mm))
        ]
    )
    middles = (np.arange(cells.shape[1]) + 0.5) / cells.shape[1] - 0.5
    x, y = np.meshgrid(middles, -middles)
    places = board.tags_mm[:, None] + board.tag_mm * np.stack([x, y], axis=-1).reshape(1, -1, 2)
    contrast = np.zeros(4)
    for view in [view for view in problem.views if view.used.any()][:_MOST_VIEWS]:
        lens = lens_number(problem, int(problem.chart.lens_of_camera[view.camera]))
        board_pose = np.asarray(problem.state.rig_from_board)[view.shot]
        pose = chained(np.asarray(problem.state.cam_from_rig)[view.camera], board_pose)
        column, row = np.rint(places_px(lens, pose, places.reshape(-1, 2))).astype(int).T
        grey = grey_of(view)
        seen = (column >= 0) & (row >= 0) & (column < grey.shape[1]) & (row < grey.shape[0])
        levels = grey[row[seen], column[seen]]
        for quarters in range(4):
            ink = np.rot90(cells, quarters, axes=(1, 2)).ravel()[seen]
            if ink.any() and not ink.all():
                contrast[quarters] += levels[~ink].mean() - levels[ink].mean()
    return int(np.argmax(contrast))
