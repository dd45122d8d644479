"""Simulated views of a sheet with random pose, print, bend and lens."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tests.calib.simulated import LENS, TABLE_1, reference_sheet
from trinoc.calib import Detection
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.uncertainty.systematics import Systematics, data_sheet_covariance
from trinoc.geometry import Pose
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import PoseModel

SHEET = reference_sheet()
SIGMA_PX = 0.01
# A lens that its data sheet describes ten times better than most.
LENS_FACTOR = 0.1 * np.linalg.cholesky(data_sheet_covariance(LENS) + 1e-12 * np.eye(5))
TYPICAL = Systematics.typical({})


class MadeViews(NamedTuple):
    """Cameras for the adjustment, and their true poses."""

    cameras: list[SheetCamera]
    poses: list[Pose]


def made_views(
    seed: int,
    systematics: Systematics = TYPICAL,
    *,
    lens_factor: np.ndarray | None = None,
    cameras: tuple[str, ...] = tuple(TABLE_1),
    sigma_px: float = SIGMA_PX,
) -> MadeViews:
    """Simulated views: values that `systematics` leaves uncertain, and noise, are drawn."""
    random = np.random.default_rng([4, seed])
    sigma = BentPaper.sigmas(
        systematics.print_size_sigma, systematics.print_scale_sigma, systematics.flatness_mm
    )
    shape = sigma * random.normal(size=len(sigma))
    made, poses = [], []
    for name in cameras:
        values = np.radians(TABLE_1[name][:3])
        aim = min(systematics.aim_sigma_mm, 2.0) * random.normal(size=2)
        pose = Pose.from_parameters(jnp.array([*values, TABLE_1[name][3], *aim]))
        change = np.zeros(5)
        if lens_factor is not None:
            change = lens_factor @ random.normal(size=5)
        uv = circles_px(pose, change, shape) + sigma_px * random.normal(size=(len(SHEET), 2))
        # From where a circle fit would start.
        start = Pose.from_parameters(jnp.array([*(values + 0.002), TABLE_1[name][3] + 1, 0, 0]))
        made.append(SheetCamera(name, detection(uv, sigma_px), LENS, lens_factor, start))
        poses.append(pose)
    return MadeViews(made, poses)


def detection(uv_px: np.ndarray, sigma_px: float) -> Detection:
    """Detection of all circles of the sheet at these pixels."""
    identities = np.broadcast_to(np.eye(2), (len(SHEET), 2, 2))
    return Detection(
        circle_index=np.arange(len(SHEET)),
        centres_px=uv_px,
        covariance_px2=sigma_px**2 * identities,
        shape_px2=100.0 * identities,
        lines_px=np.full((2, 3), np.nan),
        image_size_px=LENS.image_size_px,
    )


def circles_px(pose: Pose, change: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Pixels of the circles of a sheet of this shape, for one camera whose lens has this change."""
    nothing = detection(np.zeros((len(SHEET), 2)), 1.0)
    one = SheetCamera("one", nothing, LENS, None, pose)
    problem = sheet_problem([one], SHEET, SheetPriors(PoseModel.AIM_FREE, Systematics()))
    state, parameters = problem.state, np.array(promote_lens(LENS.lens).parameters)
    parameters[: len(change)] += change
    lenses = jax.vmap(lambda lens: lens.with_parameters(parameters))(state.lenses)
    state = eqx.tree_at(lambda s: (s.lenses, s.sheet), state, (lenses, shape))
    return errors_px(problem._replace(state=state))[0]
