"""Lenses and cameras fitted to some shots, against shots that were held out."""

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from trinoc.calib.problem.information import Information, information_of
from trinoc.calib.problem.problem import Problem, with_head_held
from trinoc.calib.problem.robust_fit import errors_px, fit_places

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


class HalfFit(NamedTuple):
    """Where the fit to one half of the shots ended, and the shots of the other half."""

    problem: Problem
    converged: bool
    held_out: frozenset[int]

    def determined(self) -> Information | None:
        """What the half says; None where that does not determine all that is free."""
        information = information_of(self.problem)
        full = information.observability.rank == len(information.free)
        return information if full else None


def cross_validate(problem: Problem, cameras: tuple[str, ...]) -> CrossValidation | None:
    """Every second shot from the others, then the other way round.

    Lenses, cameras and board are fitted anew without the shots held out; which places were located
    wrongly is known from all. None where a half does not determine the rig.
    """
    own: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    across: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    if len(used_shots(problem)) < FEWEST_SHOTS:
        return None
    for half in fit_halves(problem):
        if half.determined() is None:
            return None
        known = with_head_held(half.problem._replace(views=problem.views))
        for source in range(len(cameras)):
            seen = {v.shot for v in problem.views if v.camera == source and v.used.any()}
            seen &= half.held_out
            placed, _ = fit_places(keep_shots(known, seen, {source}))
            for view, errors in zip(problem.views, errors_px(placed), strict=True):
                if view.shot in seen:
                    into = own if view.camera == source else across
                    into[cameras[view.camera]].append(errors[view.kept])
    return CrossValidation(len(used_shots(problem)), _rms_px(own), _rms_px(across))


def fit_halves(problem: Problem) -> Iterator[HalfFit]:
    """The problem fitted to every second shot; then to the others."""
    shots = used_shots(problem)
    for remainder in (0, 1):
        end, converged = fit_places(keep_shots(problem, shots[remainder::2]))
        yield HalfFit(end, converged, frozenset(shots[1 - remainder :: 2]))


def used_shots(problem: Problem) -> list[int]:
    """The shots of which some place takes part."""
    return sorted({view.shot for view in problem.views if view.used.any()})


def keep_shots(
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
