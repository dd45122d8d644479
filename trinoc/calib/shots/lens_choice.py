"""Which model of lens the shots call for: that which tells best of shots it was not fitted to."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from trinoc.calib.shots.covariance import information_of
from trinoc.calib.shots.placing import PlacedRig, of_one_moment
from trinoc.calib.shots.problem import Problem, lens_number, with_head_held, with_sheet_held
from trinoc.calib.shots.robust_fit import errors_px, fitted
from trinoc.geometry import BrownConrady, lens_model, stack_lenses

# From the one that people expect to the one with most coefficients.
LENSES_TRIED = ("brown_conrady", "kannala_brandt", "rational")
# A lens is worse where its held-out errors are larger by so many standard deviations.
_DEVIATIONS = 2.0
# Errors beyond so many times those of the best lens are no nearer to the truth for being smaller.
_CAP = 5.0
# Where chance alone has less than this probability, a score test asks for more coefficients.
_CHANCE = 1e-3


class HeldOut(NamedTuple):
    """Errors of shots that a lens was not fitted to.

    Fields
    ------
    errors_px : for each shot, and each camera in it, the lengths of its errors.
    """

    errors_px: Mapping[tuple[int, str], Float[np.ndarray, "_m"]]


def held_out(problem: Problem, placed: PlacedRig, cameras: Sequence[str]) -> HeldOut:
    """Lenses and cameras from every second shot; the others tell where their board is, and err."""
    shots = sorted({view.shot for view in problem.views if view.used.any()})
    errors = {}
    for remainder in (0, 1):
        half, rest = shots[remainder::2], shots[1 - remainder :: 2]
        end, _ = fitted(_of_shots(with_sheet_held(problem), half))
        end, _ = fitted(with_head_held(_of_shots(end._replace(views=problem.views), rest)))
        for view, pixels in zip(end.views, errors_px(end), strict=True):
            if view.shot in rest:
                shot = of_one_moment(placed.shots[view.shot], cameras[view.camera])
                length = np.linalg.norm(pixels, axis=1)
                errors[view.camera, shot] = np.where(np.isfinite(length), length, np.inf)
    return HeldOut(errors)


def _of_shots(problem: Problem, shots: Sequence[int]) -> Problem:
    views = tuple(
        view if view.shot in shots else view._replace(used=np.zeros_like(view.used))
        for view in problem.views
    )
    return problem._replace(views=views)


class LensChoice(NamedTuple):
    """model : the name of the lens. rms_px : of each lens tried, on shots that were held out."""

    model: str
    rms_px: Mapping[str, float]


def chosen_lens(tried: Mapping[str, HeldOut]) -> LensChoice:
    """The first of the lenses that is not significantly worse than the best, shot by shot."""
    keys = set.intersection(*(set(each.errors_px) for each in tried.values()))
    shots = sorted({shot for _, shot in keys})
    median = {
        name: float(np.median(np.concatenate([each.errors_px[key] for key in keys])))
        for name, each in tried.items()
    }
    cap = _CAP * max(min(median.values()), 1e-9)
    squares = {
        name: np.array(
            [
                1e-24 + np.mean(np.concatenate([
                    np.minimum(each.errors_px[key], cap) ** 2 for key in keys if key[1] == shot
                ]))
                for shot in shots
            ]
        )
        for name, each in tried.items()
    }  # fmt: skip
    best = min(squares, key=lambda name: float(squares[name].mean()))
    for name in tried:
        # Quotients, since a few shots with large errors would drown all others in a difference.
        worse = np.log(squares[name] / squares[best])
        sigma = worse.std(ddof=1) / np.sqrt(len(shots)) if len(shots) > 1 else np.inf
        if name == best or worse.mean() <= _DEVIATIONS * sigma:
            break
    rms = {each: float(np.sqrt(values.mean())) for each, values in squares.items()}
    return LensChoice(name, rms)


def score_chance(
    problem: Problem, image_sizes_px: Sequence[tuple[int, int]], variance_factor: float
) -> float:
    """Probability by which chance pulls so much at the further coefficients of a rational lens.

    Rao's score test, at the end of a fit of Brown and Conrady's lens, which is the rational one
    whose last three coefficients are 0: nothing is fitted anew.
    """
    model, count = lens_model("rational"), len(problem.chart.lens_scale)
    more = len(model.parameter_names) - len(BrownConrady.parameter_names)
    lenses = []
    for k in range(count):
        lens = lens_number(problem, k)
        wider = np.append(lens.coefficients, np.zeros(more))
        lenses.append(model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, wider))
    size = problem.chart.lens_scale.shape[1]
    free = np.asarray(problem.chart.free)
    by_lens = free[: count * size].reshape(count, size)
    told = by_lens.any(axis=1, keepdims=True) * np.ones((1, more))
    scale = np.stack([a.parameter_scales(b) for a, b in zip(lenses, image_sizes_px, strict=True)])
    chart = eqx.tree_at(
        lambda chart: (chart.lens_scale, chart.free),
        problem.chart,
        (scale, np.append(np.append(by_lens, told, axis=1).ravel(), free[count * size :])),
    )
    state = eqx.tree_at(lambda state: state.lenses, problem.state, stack_lenses(lenses))
    information = information_of(problem._replace(state=state, chart=chart))
    added = np.zeros((count, size + more), dtype=bool)
    added[:, size:] = told > 0
    is_new = np.zeros(len(chart.free), dtype=bool)
    is_new[: added.size] = added.ravel()
    pull = np.where(is_new, information.pulls.sum(axis=0), 0.0)[information.free]
    whole = information.of_shot.sum(axis=0)[np.ix_(information.free, information.free)]
    whole = whole + information.prior
    score = float(pull @ np.linalg.pinv(whole, hermitian=True) @ pull) / variance_factor
    return float(chi2.sf(score, int(is_new.sum())))


def choice_sentence(choice: LensChoice, chance: float | None) -> str:
    """Which lens was chosen and why."""
    rivals = ", ".join(
        f"{name} {rms:.3g}" for name, rms in choice.rms_px.items() if name != choice.model
    )
    against = f" ({rivals})" if rivals else ""
    sentence = (
        f"Of the lenses tried, {choice.model} was chosen: fitted to one half of the shots it "
        f"misses the places of the other half by {choice.rms_px[choice.model]:.3g} px{against}"
    )
    if chance is None:
        return f"{sentence}."
    verdict = "ask for" if chance < _CHANCE else "do not ask for"
    return (
        f"{sentence}; by a score test the shots {verdict} k4, k5, k6 of the rational lens "
        f"(chance {chance:.2g})."
    )
