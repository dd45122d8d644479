"""Lens model selection by cross-validation over shots."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.halves import fit_halves, keep_shots
from trinoc.calib.problem.problem import Problem, with_head_held, with_sheet_held
from trinoc.calib.problem.rao_test import RaoTest
from trinoc.calib.problem.robust_fit import errors_px, fit_places
from trinoc.calib.starts.placing import of_one_moment
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning

# From the one that people expect to the one with most coefficients.
LENSES_TRIED = ("brown_conrady", "kannala_brandt", "rational")
# numerical: errors that are 0 have a quotient, too.
_LEAST_PX2 = 1e-24


# Lengths of the errors, in px, of shots that a lens was not fitted to, by camera and shot.
HeldOut = Mapping[tuple[int, str], Float[np.ndarray, "_m"]]


def measure_held_out_errors(
    problem: Problem, shots: Sequence[str], cameras: Sequence[str]
) -> HeldOut:
    """Lenses and cameras from every second shot; the others tell where their board is, and err.

    shots : their names, as a `PlacedRig` has them.
    """
    errors: dict[tuple[int, str], np.ndarray] = {}
    for half in fit_halves(with_sheet_held(problem)):
        known = with_head_held(half.problem._replace(views=problem.views))
        end, _ = fit_places(keep_shots(known, half.held_out))
        for view, pixels in zip(end.views, errors_px(end), strict=True):
            if view.shot in half.held_out:
                key = view.camera, of_one_moment(shots[view.shot], cameras[view.camera])
                length = np.linalg.norm(pixels, axis=1)
                length = np.where(np.isfinite(length), length, np.inf)
                errors[key] = np.append(errors.get(key, np.zeros(0)), length)
    return errors


class LensChoice(NamedTuple):
    """model : the name of the lens. rms_px : of each lens tried, on shots that were held out."""

    model: str
    rms_px: Mapping[str, float]


def choose_lens(tried: Mapping[str, HeldOut], tuning: AnswerTuning = TUNING.answer) -> LensChoice:
    """The first of the lenses that is not significantly worse than the best, shot by shot."""
    squares = _mean_squares(tried, tuning.cap)
    best = min(squares.values(), key=np.mean)

    def is_worse(own: Float[np.ndarray, "s"]) -> bool:
        # Quotients, since a few shots with large errors would drown all others in a difference.
        excess = np.log(own / best)
        sigma = excess.std() / np.sqrt(max(len(excess) - 1, 1))
        return bool(excess.mean() > tuning.worse_sigmas * sigma)

    chosen = next(name for name, own in squares.items() if not is_worse(own))
    return LensChoice(chosen, {name: float(np.sqrt(own.mean())) for name, own in squares.items()})


def _mean_squares(
    tried: Mapping[str, HeldOut], largest: float
) -> dict[str, Float[np.ndarray, "_s"]]:
    """Mean squared errors of each lens in each shot; errors are capped at `largest` medians."""
    keys = set.intersection(*(set(each) for each in tried.values()))
    shots = sorted({shot for _, shot in keys})
    errors = {
        name: [np.concatenate([own[k] for k in sorted(keys) if k[1] == shot])
               for shot in shots]
        for name, own in tried.items()
    }  # fmt: skip
    cap = largest * min(float(np.median(np.concatenate(own))) for own in errors.values())
    return {
        name: _LEAST_PX2 + np.array([np.mean(np.minimum(each, cap) ** 2) for each in own])
        for name, own in errors.items()
    }


def is_significant(test: RaoTest, limit: float = TUNING.answer.chance_of_lens) -> bool:
    """Whether chance alone hardly pulls so much."""
    return test.chance < limit


def choice_sentence(
    choice: LensChoice, rational: RaoTest | None, correction: RaoTest | None = None
) -> str:
    """Which lens was chosen and why. The tests are of k4, k5, k6 and of a correction by splines, of
    the best of the lenses without one."""
    rivals = ", ".join(
        f"{name} {rms:.3g}" for name, rms in choice.rms_px.items() if name != choice.model
    )
    against = f" ({rivals})" if rivals else ""
    sentence = (
        f"Of the lenses tried, {choice.model} was chosen: fitted to one half of the shots it "
        f"misses the places of the other half by {choice.rms_px[choice.model]:.3g} px{against}"
    )
    tests = {"k4, k5, k6 of the rational lens": rational, "a correction by splines": correction}
    verdicts = [
        f"{'' if is_significant(test) else 'do not '}ask for {what} (chance {test.chance:.2g})"
        for what, test in tests.items()
        if test is not None
    ]
    if not verdicts:
        return f"{sentence}."
    sentence = f"{sentence}; by score tests the shots {', and '.join(verdicts)}"
    if correction is None or not is_significant(correction):
        return f"{sentence}."
    return f"{sentence}: the polynomial does not describe the lens, or the board is not as drawn."
