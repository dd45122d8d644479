"""Lens model selection by cross-validation over shots."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.halves import fit_halves, keep_shots
from trinoc.calib.problem.problem import Problem, with_fixed_board_shape, with_only_boards_free
from trinoc.calib.problem.rao_test import RaoTest
from trinoc.calib.problem.robust_fit import errors_px, fit_points
from trinoc.calib.sentences import lens_choice
from trinoc.calib.starts.placing import original_shot_name
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning

# From the usual model to the one with most coefficients.
LENSES_TRIED = ("brown_conrady", "kannala_brandt", "rational")
# numerical: avoids 0 / 0 for errors of 0.
_LEAST_PX2 = 1e-24


# Lengths (px) of the errors in held-out shots, by camera and shot.
HeldOutErrors = Mapping[tuple[int, str], Float[np.ndarray, "_m"]]


def measure_held_out_errors(
    problem: Problem, shots: Sequence[str], cameras: Sequence[str]
) -> HeldOutErrors:
    """Cross-validation of a lens model: residuals in shots that were not used in its fit, px.

    Lenses and cameras are fitted to every second shot, and then to the others. In the held-out
    shots only the board poses are fitted.

    shots : names of the shots, as in `InitialRig`. cameras : names of the cameras.
    """
    errors: dict[tuple[int, str], np.ndarray] = {}
    for half in fit_halves(with_fixed_board_shape(problem)):
        fixed = with_only_boards_free(half.problem._replace(views=problem.views))
        fitted, _ = fit_points(keep_shots(fixed, half.held_out))
        for view, view_errors in zip(fitted.views, errors_px(fitted), strict=True):
            if view.shot in half.held_out:
                key = view.camera, original_shot_name(shots[view.shot], cameras[view.camera])
                length = np.linalg.norm(view_errors, axis=1)
                length = np.where(np.isfinite(length), length, np.inf)
                errors[key] = np.append(errors.get(key, np.zeros(0)), length)
    return errors


class LensChoice(NamedTuple):
    """Chosen lens model.

    Attributes
    ----------
    model : name of the chosen model.
    rms_px : root mean square residual in held-out shots of each tried model, by name.
    """

    model: str
    rms_px: Mapping[str, float]


def choose_lens(
    held_out: Mapping[str, HeldOutErrors], tuning: AnswerTuning = TUNING.answer
) -> LensChoice:
    """Choose the first lens model that is not significantly worse than the best one.

    held_out : for each model, in order of preference, its residuals in held-out shots.
    """
    squares = _mean_squares(held_out, tuning.cap)
    best = min(squares.values(), key=np.mean)

    def is_worse(model_squares: Float[np.ndarray, "s"]) -> bool:
        # Ratios, since differences would be dominated by a few shots with large errors.
        excess = np.log(model_squares / best)
        sigma = excess.std() / np.sqrt(max(len(excess) - 1, 1))
        return bool(excess.mean() > tuning.worse_sigmas * sigma)

    model_name = next(
        name for name, model_squares in squares.items() if not is_worse(model_squares)
    )
    return LensChoice(
        model_name,
        {name: float(np.sqrt(model_squares.mean())) for name, model_squares in squares.items()},
    )


def _mean_squares(
    held_out: Mapping[str, HeldOutErrors], largest: float
) -> dict[str, Float[np.ndarray, "_s"]]:
    """Mean squared residual of each lens model (key) in each held-out shot, px^2, (s,).

    Residuals are limited to `largest` times the median of the best model.
    """
    keys = set.intersection(*(set(shot_errors) for shot_errors in held_out.values()))
    shots = sorted({shot for _, shot in keys})
    errors = {
        name: [np.concatenate([lens_errors[k] for k in sorted(keys) if k[1] == shot])
               for shot in shots]
        for name, lens_errors in held_out.items()
    }  # fmt: skip
    cap = largest * min(
        float(np.median(np.concatenate(lens_errors))) for lens_errors in errors.values()
    )
    return {
        name: _LEAST_PX2
        + np.array([np.mean(np.minimum(shot_errors, cap) ** 2) for shot_errors in lens_errors])
        for name, lens_errors in errors.items()
    }


def is_significant(test: RaoTest, limit: float = TUNING.answer.chance_of_lens) -> bool:
    """True if the p-value of a test is below `limit`."""
    return test.p_value < limit


def choice_sentence(
    choice: LensChoice, rational: RaoTest | None, correction: RaoTest | None = None
) -> str:
    """Return the note on the chosen lens model, with the reason.

    rational : test whether the shots need the coefficients k4, k5, k6 of the rational model.
    correction : test whether they need a correction by splines.
    """
    tests = {"k4, k5, k6 of the rational lens": rational, "a correction by splines": correction}
    results = {
        extension: (test.p_value, is_significant(test))
        for extension, test in tests.items()
        if test is not None
    }
    needs_splines = correction is not None and is_significant(correction)
    return lens_choice(choice.model, choice.rms_px, results, needs_splines)
