"""A rig to be fitted: its views, where the fit starts or ended, and what of it is free."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.shots.motions import chained
from trinoc.calib.shots.state import Chart, RigState
from trinoc.calib.shots.table import View, ViewTable, view_table
from trinoc.calib.targets import AbstractTarget
from trinoc.geometry import AbstractLens


class Problem(NamedTuple):
    """Everything that the fit takes.

    Fields
    ------
    views : what was seen.
    target : the board.
    state : where the fit starts, or where it ended.
    chart : units, and what is free.
    shots : how many there are; arrays have more rows.
    sigma_factor : (c,) by how much the places' sigmas are multiplied for each camera.
    spent : how many numbers the residuals have told of where the board's places lie.
    spent_on_lenses : how many they have told of what has a prior in the lenses.
    """

    views: tuple[View, ...]
    target: AbstractTarget
    state: RigState
    chart: Chart
    shots: int
    sigma_factor: Float[np.ndarray, "c"]
    spent: float = 0.0
    spent_on_lenses: float = 0.0

    @property
    def cameras(self) -> int:
        """How many cameras there are."""
        return len(self.chart.lens_of_camera)

    @property
    def table(self) -> ViewTable:
        """The views as arrays."""
        table = view_table(self.views, self.target)
        by_view = self.sigma_factor[np.asarray(table.camera)]
        return table._replace(whitening=table.whitening / by_view[:, None, None, None])


class EndedProblem(NamedTuple):
    """Where a fit ended, and how well that is known.

    Fields
    ------
    problem : at its end.
    covariance : (f, f) of the free steps of the head.
    variance_factor : of the shots' noise, which is in the covariance.
    """

    problem: Problem
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def cam_from_board(state: RigState, view: View) -> Float[np.ndarray, "3 4"]:
    """The pose of a view's board before its camera."""
    pose = chained(
        np.asarray(state.cam_from_rig)[view.camera], np.asarray(state.rig_from_board)[view.shot]
    )
    if not len(state.set_from_board):
        return pose
    return chained(pose, np.asarray(state.set_from_board)[view.board])


def lens_number(problem: Problem, number: int) -> AbstractLens:
    """One of the stacked lenses of the state."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[number], problem.state.lenses)
