"""What of a rig is fitted: problems in which more or less of it is held."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.shots.problem import Problem
from trinoc.calib.shots.state import Chart
from trinoc.geometry import AFFINE_PARAMETERS, AbstractLens, stack_lenses


class Freedom(NamedTuple):
    """What is fitted of the lenses.

    Fields
    ------
    lens_of_camera : (c,) which lens each camera has.
    free : (l, q) which parameters of each lens are fitted.
    """

    lens_of_camera: np.ndarray
    free: Bool[np.ndarray, "l q"]


def with_lens_free(problem: Problem, free: Bool[np.ndarray, "l q"]) -> Problem:
    """The problem with other parameters of the lenses held; held coefficients are zero, but for
    lenses that are held as a whole, and for what is never fitted."""
    lenses, size = problem.chart.lens_scale.shape
    head = np.array(problem.chart.free)
    head[: lenses * size] = free.astype(float).ravel()
    given = np.asarray(problem.state.lenses.coefficients)
    whole = ~free.any(axis=1, keepdims=True)
    model = problem.state.lenses
    never = np.array([[name in model.never_fitted for name in model.coefficient_names]], dtype=bool)
    kept = np.where(free[:, len(AFFINE_PARAMETERS) :] | whole | never, given, 0.0)
    state = eqx.tree_at(lambda state: state.lenses.coefficients, problem.state, kept)
    return problem._replace(chart=_with_free(problem.chart, head), state=state)


def with_wider_lenses(
    problem: Problem, lenses: Sequence[AbstractLens], image_sizes_px: Sequence[tuple[int, int]]
) -> Problem:
    """The problem with lenses of a model whose parameters begin with those of its own.

    What is added is free, without a prior, of lenses that are not held as a whole.
    """
    count, size = problem.chart.lens_scale.shape
    names, never = lenses[0].parameter_names[size:], lenses[0].never_fitted
    scale = np.stack(
        [lens.parameter_scales(each) for lens, each in zip(lenses, image_sizes_px[:count])]
    )
    head = np.asarray(problem.chart.free)
    of_lens, of_rest = head[: count * size].reshape(count, size), head[count * size :]
    added = of_lens.any(axis=1, keepdims=True) * np.array([name not in never for name in names])
    chart = eqx.tree_at(
        lambda chart: (chart.lens_scale, chart.free, chart.lens_information),
        problem.chart,
        (
            scale,
            np.append(np.append(of_lens, added, axis=1).ravel(), of_rest),
            np.zeros((*scale.shape, scale.shape[1])),
        ),
    )
    state = eqx.tree_at(lambda state: state.lenses, problem.state, stacked_lenses(lenses))
    return problem._replace(state=state, chart=chart)


def with_sheet_held(problem: Problem) -> Problem:
    """The problem with the board taken as it was found."""
    head = np.array(problem.chart.free)
    head[problem.chart.sheet_first :] = 0.0
    return problem._replace(chart=_with_free(problem.chart, head))


def with_head_held(problem: Problem) -> Problem:
    """The problem with lenses, cameras and board as they are: only where it stands is free."""
    return problem._replace(chart=_with_free(problem.chart, np.zeros(len(problem.chart.free))))


def _with_free(chart: Chart, free: Float[np.ndarray, "h"]) -> Chart:
    return eqx.tree_at(lambda chart: chart.free, chart, free)


def stacked_lenses(lenses: Sequence[AbstractLens]) -> AbstractLens:
    """Lenses of one model along a first axis, in double precision."""
    plain = partial(jax.tree.map, partial(np.asarray, dtype=np.float64))
    return stack_lenses([plain(lens) for lens in lenses])
