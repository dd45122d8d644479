"""The judged answer of one picture's circle fit."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.result import Status
from trinoc.geometry import PARAMETER_NAMES, Pose
from trinoc.numerics import LARGEST_SIGMA, in_float64, observability

# From (rad, rad, rad, mm, mm, mm), in which fits run, to degrees, in which people read.
DEGREES = np.array([180 / np.pi, 180 / np.pi, 180 / np.pi, 1.0, 1.0, 1.0])
# Chi-square beyond this many of its own standard deviations is not noise: the sigmas grow.
_CHI_SQUARE_DEVIATIONS = 4.0


class PoseEstimate(NamedTuple):
    """The pose of one camera with everything needed to judge it.

    Fields
    ------
    status : how the fit ended.
    values : (6,) pan, tilt, swing in degrees, distance, aim X, aim Y in mm; NaN unless the
        status is CONVERGED, so that no initial guess is ever read as a result.
    covariance : (p, p) of the first p values; NaN where a parameter is not determined.
    residuals_px : (m, 2) predicted minus observed centres.
    used : (m,) circles that took part; the others were located wrongly.
    rank : number of determined directions.
    reduced_chi_square : of the used circles; NaN without degrees of freedom.
    chi_square : of the used circles.
    gauge : names of the parameters that are not determined.
    """

    status: Status
    values: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "p p"]
    residuals_px: Float[np.ndarray, "m 2"]
    used: Bool[np.ndarray, "m"]
    rank: int
    reduced_chi_square: float
    chi_square: float
    gauge: tuple[str, ...]


def assess(
    parameters: Float[np.ndarray, "p"],
    residuals_px: Float[np.ndarray, "m 2"],
    whitened: Float[np.ndarray, "m 2"],
    information: Float[np.ndarray, "p p"],
    d_parameters_d_delta: Float[np.ndarray, "p p"],
    converged: bool,
    used: Bool[np.ndarray, "m"],
) -> PoseEstimate:
    """Status, rank and covariance of a fit at the point where it ended.

    Where the residuals are larger than the centres' own sigmas explain, the covariance is
    multiplied by the reduced chi-square: what disturbs the centres disturbs the pose.
    """
    count = information.shape[0]
    chi_square = float(np.sum(whitened[used] ** 2))
    freedom = 2 * int(used.sum()) - count
    reduced = chi_square / freedom if freedom > 0 else float("nan")
    usable = converged and bool(
        np.isfinite(parameters[:4]).all() and np.isfinite(information).all()
    )
    usable = usable and parameters[3] > 0 and parameters[1] > 0
    if not usable:
        unknown = np.full((count, count), np.nan)
        return PoseEstimate(
            Status.NOT_CONVERGED,
            np.full(6, np.nan),
            unknown,
            np.full_like(residuals_px, np.nan),
            used,
            0,
            reduced,
            chi_square,
            (),
        )
    largest = LARGEST_SIGMA * DEGREES * np.array([1, 1, 1, *np.full(3, parameters[3])])
    by_delta = DEGREES[:count, None] * d_parameters_d_delta
    seen = observability(information, by_delta, largest[:count])
    inflated = reduced > 1 + _CHI_SQUARE_DEVIATIONS * np.sqrt(2 / max(freedom, 1))
    complete = seen.rank == count
    return PoseEstimate(
        Status.CONVERGED if complete else Status.RANK_DEFICIENT,
        values_of_parameters(parameters) if complete else np.full(6, np.nan),
        seen.covariance * (reduced if inflated else 1.0),
        residuals_px,
        used,
        seen.rank,
        reduced,
        chi_square,
        tuple(PARAMETER_NAMES[k] for k in seen.gauge),
    )


def values_of_parameters(parameters: Float[np.ndarray, "p"]) -> Float[np.ndarray, "6"]:
    """All six parameters in degrees and mm, an aim that is held at the origin."""
    values = np.zeros(len(DEGREES))
    values[: len(parameters)] = DEGREES[: len(parameters)] * parameters
    return values


@in_float64
def pose_of_values(values: Float[np.ndarray, "6"]) -> Pose:
    """The pose of pan, tilt, swing in degrees, distance and aim in mm."""
    return _pose(np.concatenate([np.radians(values[:3]), values[3:]]))


# Operation by operation it takes two milliseconds, which a batch of frames feels.
_pose = jax.jit(Pose.from_parameters)
