"""Errors of shots that the rig was not fitted to."""

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from trinoc.calib.problem.information import information_of
from trinoc.calib.problem.problem import Problem, with_head_held
from trinoc.calib.problem.robust_fit import errors_px, fitted

FEWEST_SHOTS = 4


class CrossValidation(NamedTuple):
    """How far lenses and cameras from one half of the shots miss the places of the other half.

    Of a shot that is held out only the board's pose is fitted, to what one camera saw of it.

    Fields
    ------
    shots : how many were held out in turn.
    own_px : for each camera root mean square length of its errors, the board placed by itself:
        what its lens does not explain.
    across_px : the same, the board placed by each other camera of the shot in turn, which errs by
        that camera's noise, too: what the rig does not explain. Empty for one camera.
    """

    shots: int
    own_px: Mapping[str, float]
    across_px: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """The errors in words."""
        sentence = (
            f"shots held out are missed by {_listed(self.own_px)}, the board placed by the camera "
            "itself"
        )
        if self.across_px:
            sentence += f", and by {_listed(self.across_px)}, placed by another camera"
        return sentence


def cross_validation(problem: Problem, cameras: tuple[str, ...]) -> CrossValidation | None:
    """Every second shot from the others, then the other way round.

    Lenses, cameras and board are fitted anew without the shots held out; which places were located
    wrongly is known from all. None where a half does not determine the rig.
    """
    own: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    across: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    if len(shots_of(problem)) < FEWEST_SHOTS:
        return None
    for end, held in halves_fitted(problem):
        information = information_of(end)
        if information.seen.rank < len(information.free):
            return None
        held_out = with_head_held(end._replace(views=problem.views))
        for source in range(len(cameras)):
            seen = {v.shot for v in problem.views if v.camera == source and v.used.any()} & held
            placed, _ = fitted(of_shots(held_out, seen, {source}))
            for view, errors in zip(problem.views, errors_px(placed), strict=True):
                if view.shot in seen:
                    into = own if view.camera == source else across
                    into[cameras[view.camera]].append(errors[view.kept])
    return CrossValidation(len(shots_of(problem)), _rms_px(own), _rms_px(across))


def halves_fitted(problem: Problem) -> Iterator[tuple[Problem, set[int]]]:
    """The problem fitted to every second shot, and the others; then the other way round."""
    shots = shots_of(problem)
    for remainder in (0, 1):
        end, _ = fitted(of_shots(problem, shots[remainder::2]))
        yield end, set(shots[1 - remainder :: 2])


def shots_of(problem: Problem) -> list[int]:
    """The shots of which some place takes part."""
    return sorted({view.shot for view in problem.views if view.used.any()})


def of_shots(
    problem: Problem, shots: Collection[int], cameras: Collection[int] | None = None
) -> Problem:
    """The problem with the places of these shots, and these cameras, alone."""
    views = tuple(
        view
        if view.shot in shots and (cameras is None or view.camera in cameras)
        else view._replace(used=np.zeros_like(view.used))
        for view in problem.views
    )
    return problem._replace(views=views)


def _rms_px(errors: Mapping[str, list[np.ndarray]]) -> dict[str, float]:
    return {
        name: float(np.sqrt(np.mean(np.sum(np.concatenate(own) ** 2, axis=1))))
        for name, own in errors.items()
        if own
    }


def _listed(errors_px: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3f} px ({name})" for name, value in errors_px.items())
