"""What the fit of a rig from many shots tells its user, in sentences."""

from collections.abc import Sequence

import numpy as np

from trinoc.calib.problem.motions import PARALLEL_DEG, boards_parallel
from trinoc.calib.problem.problem import Problem, cam_from_board
from trinoc.calib.problem.robust_fit import RobustFit
from trinoc.calib.shots.placing import PlacedRig
from trinoc.calib.targets import board_names, boards_of

# A scale or a warp beyond this many sigmas of what was known of it before is told.
_SURPRISING = 3.0


def undetermined_sentence(problem: Problem, gauge: tuple[str, ...]) -> str:
    """Which parameters the shots cannot determine, and why where that is plain."""
    few = ", ".join(gauge[:8]) + (f" and {len(gauge) - 8} more" if len(gauge) > 8 else "")
    return f"The shots do not determine {few}{_reason(problem)}."


def _reason(problem: Problem) -> str:
    used = [view for view in problem.views if view.used.any()]
    shots = {view.shot for view in used}
    if len(shots) == 1:
        return (
            ": there is one shot, and a plane tells two numbers of a lens and no more. Take more, "
            "the board tilted another way in each, or give the lenses"
        )
    tilts = []
    for view in used:
        pose = cam_from_board(problem.state, view)
        tilts.append(np.degrees(np.arccos(np.clip(abs(pose[2, 2]), 0.0, 1.0))))
    if max(tilts) < PARALLEL_DEG:
        return (
            ": all pictures show the board square to the camera, where a longer focal length and a "
            "larger distance look the same. Tilt the board by 30 to 50 degrees, another way each "
            "time"
        )
    if not len(problem.state.set_from_board) and boards_parallel(
        [np.asarray(problem.state.rig_from_board)[shot] for shot in shots]
    ):
        return (
            ": the board is parallel in all shots. Tilt it by 30 to 50 degrees, another way each "
            "time"
        )
    return ": take more shots, the board tilted another way in each"


def refused_sentences(
    fit: RobustFit, placed: PlacedRig, cameras: tuple[str, ...]
) -> tuple[str, ...]:
    """Pictures that show the board elsewhere, and how many places were located wrongly."""
    sentences = [
        f'{placed.shots[shot]}: "{cameras[camera]}" shows the board {miss:.1f} px from where the '
        "rig has it, so the board moved or the picture is of another moment; it was left out."
        for camera, shot, miss in fit.moved
    ]
    moved = {(camera, shot) for camera, shot, _ in fit.moved}
    for view in fit.problem.views:
        wrong = int((~view.used).sum())
        if wrong and (view.camera, view.shot) not in moved:
            sentences.append(
                f'{placed.shots[view.shot]}: "{cameras[view.camera]}": {wrong} of '
                f"{len(view.used)} places {'was' if wrong == 1 else 'were'} located wrongly and "
                "left out."
            )
    return tuple(sentences)


def silent_sentences(
    silent: Sequence[tuple[int, int, str]], placed: PlacedRig, cameras: tuple[str, ...]
) -> tuple[str, ...]:
    """Pictures whose grey levels say nothing; (camera, shot, why) of each."""
    return tuple(
        f'{placed.shots[shot]}: "{cameras[camera]}": {why} Its places count as they were detected.'
        for camera, shot, why in silent
    )


def notes_of_rig(
    fit: RobustFit, cameras: tuple[str, ...], given_up: tuple[str, ...], variance_factor: float
) -> tuple[str, ...]:
    """Sentences on lens, board and shots."""
    notes = []
    if variance_factor > 1.0:
        notes.append(
            f"The shots disagree {np.sqrt(variance_factor):.1f} times as much as their places "
            "scatter, and all sigmas are enlarged by that: the board bends, or the cameras do not "
            "look at the same moment, or the lens is of another model."
        )
    if given_up:
        notes.append(f"The shots cannot determine {', '.join(given_up)}, held at 0.")
    problem = fit.problem
    if problem.chart.has_circles:
        for camera, factor in zip(cameras, problem.sigma_factor, strict=True):
            if factor > np.sqrt(2.0):
                notes.append(
                    f"The circles of {camera} scatter {factor:.1f} times as much as their own "
                    "sigmas say; all sigmas are enlarged by that. See that the board is flat and "
                    "does not move, and that focus and zoom stay."
                )
    notes += _backs(problem)
    notes += _uneven(problem)
    notes += _surprises(problem)
    return tuple(notes)


def _backs(problem: Problem) -> list[str]:
    """Whether the pictures show what would be the back of the board as it is drawn."""
    towards = []
    for view in problem.views:
        if view.used.any():
            pose = cam_from_board(problem.state, view)
            towards.append(float(pose[:, 2] @ pose[:, 3]))
    if not towards or np.mean(np.array(towards) > 0) <= 0.5:
        return []
    return [
        "Most pictures show the board from behind: the board, its layout or the pictures are "
        "mirrored, unless it is of glass. Mirrored pictures make a mirrored rig."
    ]


def _uneven(problem: Problem) -> list[str]:
    """How far the board's places lie off, where the shots show that they do."""
    shape = np.asarray(problem.state.shape)
    if not len(shape):
        return []
    across, above = np.sqrt(np.mean(shape[:, :2] ** 2)), np.sqrt(np.mean(shape[:, 2] ** 2))
    return [
        f"The board's places lie {across:.2g} mm aside of the drawing and {above:.2g} mm off its "
        "plane (root mean square); this was found with the rig, and is taken into account."
    ]


def _surprises(problem: Problem) -> list[str]:
    """Where the board is not as it was said to be."""
    information = np.asarray(problem.chart.sheet_information)
    free = np.flatnonzero(np.diag(information) > 0)
    if not len(free):
        return []
    covariance = np.linalg.inv(information[np.ix_(free, free)])
    found = np.asarray(problem.state.sheet)[free]
    told = []
    several = len(boards_of(problem.target)) > 1
    terms = problem.chart.sheet_model.names
    names = [(whose, name) for whose in board_names(problem.target) for name in terms]
    for row, value, sigma in zip(free, found, np.sqrt(np.diag(covariance)), strict=True):
        whose, name = names[row]
        if abs(value) > _SURPRISING * sigma:
            of = f" {whose}" if several else ""
            said = f"{value:.2f} mm" if name.endswith("_mm") else f"{100 * value:.2f} %"
            told.append(
                f"The board{of}'s {name.removesuffix('_mm')} is {said}, more than was thought "
                f"possible ({abs(value) / sigma:.0f} sigmas): check the layout and the size of its "
                "squares."
            )
    return told
