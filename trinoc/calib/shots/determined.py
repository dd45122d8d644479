"""What the shots determine: coefficients that are given up, and parameters that stay open."""

import numpy as np

from trinoc.calib.problem.information import Information, information_of
from trinoc.calib.problem.problem import Problem, with_lens_free
from trinoc.calib.problem.robust_fit import RobustFit, refitted


def determined(fit: RobustFit) -> tuple[RobustFit, tuple[str, ...]]:
    """The fit with as many coefficients as are determined, and those that were given up."""
    richest, given_up = fit, []
    lenses = fit.problem.state.lenses
    for name in ("", *lenses.dispensable):
        if name:
            column = lenses.parameter_names.index(name)
            count, size = fit.problem.chart.lens_shape
            free = np.asarray(fit.problem.chart.free)[: count * size].reshape(count, size) > 0
            if not free[:, column].any():
                continue
            free = free.copy()
            free[:, column] = False
            fit = refitted(fit, with_lens_free(fit.problem, free))
            given_up.append(name)
        information = information_of(fit.problem)
        if information.seen.rank == len(information.free):
            return fit, tuple(given_up)
    return richest, ()


def open_rows(problem: Problem, information: Information, names: tuple[str, ...]) -> np.ndarray:
    """Which named parameters what is not determined touches."""
    chart = problem.chart
    count, size = chart.lens_shape
    open_head = np.zeros(len(chart.free), dtype=bool)
    open_head[information.free[list(information.seen.gauge)]] = True
    of_lens = open_head[: count * size].reshape(count, size)
    any_pose = bool(open_head[count * size :].any())
    sheet = open_head[chart.sheet_first : chart.shape_first]
    rows = []
    for lens in chart.lens_of_camera:
        rows += [any_pose or bool(of_lens.any())] * 6 + of_lens[lens].tolist()
    rows += [any_pose] * (6 * max(len(problem.state.set_from_board) - 1, 0))
    rows += sheet.tolist()
    assert len(rows) == len(names)
    return np.array(rows)
