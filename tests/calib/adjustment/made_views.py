"""Views of a sheet that lies, was printed and is seen through a lens as chance has it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tests.calib.simulated import LENS, TABLE_1, reference_sheet
from trinoc.calib.adjustment import HEIGHT_TERMS, PRINT_TERMS, SheetView, point_of_place
from trinoc.calib.adjustment.sheet_shape import shape_sigmas
from trinoc.calib.model import SheetPoints
from trinoc.calib.uncertainty import Systematics, data_sheet_covariance
from trinoc.geometry import AbstractLens, Pose, project_point, promoted
from trinoc.numerics import ArrayLike

SHEET = reference_sheet()
REACH_MM = float(np.hypot(*SHEET.centres_mm.T).max())
SIGMA_PX = 0.01
# A lens that its data sheet describes ten times better than most.
LENS_FACTOR = 0.1 * np.linalg.cholesky(data_sheet_covariance(LENS) + 1e-12 * np.eye(5))
TYPICAL = Systematics.typical({})


class MadeViews(NamedTuple):
    """What the adjustment is given, and the truth."""

    views: list[SheetView]
    poses: list[Pose]


def made_views(
    seed: int,
    known: Systematics = TYPICAL,
    *,
    lens_factor: np.ndarray | None = None,
    cameras: tuple[str, ...] = tuple(TABLE_1),
    sigma_px: float = SIGMA_PX,
) -> MadeViews:
    """Everything that `known` leaves open drawn from its prior, and noise on every circle."""
    random = np.random.default_rng([4, seed])
    terms = len(PRINT_TERMS) + len(HEIGHT_TERMS)
    sigma = shape_sigmas(known.print_size_sigma, known.print_scale_sigma, known.flatness_mm)
    shape = sigma * random.normal(size=terms)
    views, poses = [], []
    for name in cameras:
        values = np.radians(TABLE_1[name][:3])
        aim = min(known.aim_sigma_mm, 2.0) * random.normal(size=2)
        pose = Pose.from_parameters(jnp.array([*values, TABLE_1[name][3], *aim]))
        change = np.zeros(5)
        if lens_factor is not None:
            change = lens_factor @ random.normal(size=5)
        uv = np.asarray(_seen(pose, promoted(LENS.lens).retract(change), shape))
        points = SheetPoints(
            SHEET.centres_mm,
            uv + sigma_px * random.normal(size=uv.shape),
            np.eye(uv.size) / sigma_px,
        )
        # From where a circle fit would start.
        start = Pose.from_parameters(jnp.array([*(values + 0.002), TABLE_1[name][3] + 1, 0, 0]))
        views.append(SheetView(points, start, LENS.lens, lens_factor, has_outliers=True))
        poses.append(pose)
    return MadeViews(views, poses)


@jax.jit
def _seen(pose: Pose, lens: AbstractLens, shape: np.ndarray) -> ArrayLike:
    def one(place: ArrayLike) -> ArrayLike:
        return project_point(pose, lens, point_of_place(place, shape, jnp.asarray(REACH_MM)))

    return jax.vmap(one)(jnp.asarray(SHEET.centres_mm))
