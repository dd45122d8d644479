"""Errors that no repetition of a picture shows: of the sheet and of the lens.

They move every camera that looks at the sheet in the same way, so that they join the cameras'
parameters in one covariance, and they are larger than the noise: a tenth of a percent of print
scale is half a millimetre of distance, a hundred times the bound of a good picture.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.circle_observations import CircleObservations, bucket_size, circle_observations
from trinoc.calib.circle_residual import predicted_centre_px
from trinoc.calib.lens_arrays import LensArrays, lens_arrays
from trinoc.calib.picture_fit import DEGREES, sheet_pose_of_values
from trinoc.calib.result import CalibrationResult
from trinoc.calib.sheet_pose import SheetPose
from trinoc.errors import InputError
from trinoc.geometry.arrays import ArrayLike
from trinoc.geometry.precision import in_float64
from trinoc.geometry.rig import PARAMETER_NAMES, Rig

LENS_PARAMETERS = ("fu", "fv", "cu", "cv", "k1", "k2", "p1", "p2", "k3")
# Shared by all cameras: print scale along X and Y, and three ways in which a sheet bends.
_SHARED = 5


class Systematics(NamedTuple):
    """What is known of the errors of the sheet and the lens; zeros and None leave them out.

    Fields
    ------
    print_scale_sigma : of the print's scale along X and along Y, as shares (1e-3 is a tenth of
        a percent). `trinoc.calib.print_scale` gets them from two measured bars.
    flatness_mm : sigma of the height, at the circles farthest from the origin, of each of the
        three ways in which a sheet bends: along X, along Y, and twisted.
    lens_covariance : (k, k) of the first k of fu, fv, cu, cv in px, k1, k2, p1, p2, k3; one
        for all cameras, whose errors are then independent, or one for each by name.
    """

    print_scale_sigma: tuple[float, float] = (0.0, 0.0)
    flatness_mm: float = 0.0
    lens_covariance: np.ndarray | Mapping[str, np.ndarray] | None = None

    @property
    def words(self) -> tuple[str, ...]:
        """The terms that are in, for people."""
        terms = []
        if any(self.print_scale_sigma):
            x, y = (100 * sigma for sigma in self.print_scale_sigma)
            terms.append(f"print scale ({x:.3g} % along X, {y:.3g} % along Y)")
        if self.flatness_mm:
            terms.append(f"flatness of the sheet ({self.flatness_mm:.3g} mm)")
        if self.lens_covariance is not None:
            terms.append("the lens's own covariance")
        return tuple(terms)


@in_float64
def with_systematics(result: CalibrationResult, systematics: Systematics) -> CalibrationResult:
    """The same calibration with systematic errors added to its covariance.

    Each error moves the circles' centres, and with them the least-squares solution, linearly.
    Raises InputError for a negative sigma or a lens covariance of another shape.
    """
    if min(*systematics.print_scale_sigma, systematics.flatness_mm) < 0:
        raise InputError("A sigma of `Systematics` is negative: give standard deviations.")
    shared_variance = np.array(
        [*np.square(systematics.print_scale_sigma), *np.full(3, systematics.flatness_mm**2)]
    )
    names = result.rig.names
    count = len(result.parameters) // len(names)
    covariance, shared = np.array(result.covariance), []
    for k, name in enumerate(names):
        response = _response(result, name, count)
        shared.append(response[:, :_SHARED])
        block = slice(k * count, (k + 1) * count)
        lens = _lens_covariance(systematics, name)
        by_lens = response[:, _SHARED : _SHARED + len(lens)]
        covariance[block, block] += by_lens @ lens @ by_lens.T
    stacked = np.concatenate(shared)
    covariance += (stacked * shared_variance) @ stacked.T
    rig = Rig(dict(result.rig.items()), parameters=result.parameters, covariance=covariance)
    fields = {name: getattr(result, name) for name in result.__dataclass_fields__}
    words = (*result.systematics, *systematics.words)
    changed = {"rig": rig, "covariance": covariance, "systematics": words}
    return CalibrationResult(**fields | changed)


def _lens_covariance(systematics: Systematics, name: str) -> Float[np.ndarray, "k k"]:
    given = systematics.lens_covariance
    matrix = given.get(name) if isinstance(given, Mapping) else given
    if matrix is None:
        return np.zeros((0, 0))
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or len(matrix) > len(LENS_PARAMETERS):
        raise InputError(
            f'The lens covariance of camera "{name}" has shape {matrix.shape}, but must be (k, k) '
            f"for the first k of {', '.join(LENS_PARAMETERS)}."
        )
    return matrix


def _response(result: CalibrationResult, name: str, count: int) -> Float[np.ndarray, "p 14"]:
    """Change of a camera's parameters, in degrees and mm, for a unit of each error."""
    fit, camera = result.fits[name], result.rig[name]
    values = [getattr(camera, key) for key in PARAMETER_NAMES[:4]]
    pose = sheet_pose_of_values(np.array([*values, *camera.aim_mm]))
    circles = circle_observations(
        fit.detection, result.pattern, bucket_size(len(fit.detection)), fit.used
    )
    by_step, by_error, by_chart = (
        np.asarray(part)
        for part in _derivatives(pose, lens_arrays(camera.intrinsics, True), circles)
    )
    by_step, by_chart = by_step[:, :count], by_chart[:count, :count]
    chart = -np.linalg.solve(by_step.T @ by_step, by_step.T @ by_error)
    return DEGREES[:count, None] * by_chart @ chart


@jax.jit
def _derivatives(
    pose: SheetPose, lens: LensArrays, circles: CircleObservations
) -> tuple[Float[ArrayLike, "n 6"], Float[ArrayLike, "n 14"], Float[ArrayLike, "6 6"]]:
    """Whitened centres by the pose's chart and by every error, and parameters by the chart."""
    reach = jnp.sqrt(jnp.max(jnp.sum(circles.centres_sheet_mm**2, axis=1)))

    def centres(step: Float[ArrayLike, "6"], error: Float[ArrayLike, "14"]) -> ArrayLike:
        moved = pose.moved(step)
        deformed = _moved_lens(lens, error[_SHARED:])

        def centre(place: Float[ArrayLike, "2"], radius: Float[ArrayLike, ""]) -> ArrayLike:
            scaled = place * (1 + error[:2])
            x, y = place[0] / reach, place[1] / reach
            height = error[2] * x * x + error[3] * y * y + error[4] * x * y
            flat = moved.cam_from_sheet @ jnp.append(scaled, 1.0)
            raised = flat + moved.rotation[:, 2] * height
            lift = deformed.pixel_from_normalised(raised[:2] / raised[2])
            lift = lift - deformed.pixel_from_normalised(flat[:2] / flat[2])
            return predicted_centre_px(moved, deformed, scaled, radius) + lift

        predicted = jax.vmap(centre)(circles.centres_sheet_mm, circles.radius_mm)
        return jnp.einsum("nij,nj->ni", circles.whitening, predicted).reshape(-1)

    zero, none = jnp.zeros(6), jnp.zeros(_SHARED + len(LENS_PARAMETERS))
    by_step, by_error = jax.jacfwd(centres, argnums=(0, 1))(zero, none)
    return by_step, by_error, jax.jacfwd(lambda step: pose.moved(step).parameters)(zero)


def _moved_lens(lens: LensArrays, change: Float[ArrayLike, "9"]) -> LensArrays:
    """The lens after a change of fu, fv, cu, cv and its distortion."""
    zero = jnp.zeros_like(change[0])
    matrix = jnp.stack(
        [
            jnp.stack([change[0], zero, change[2]]),
            jnp.stack([zero, change[1], change[3]]),
            jnp.stack([zero, zero, zero]),
        ]
    )
    assert lens.distortion is not None
    return LensArrays(lens.matrix_px + matrix, lens.distortion + change[4:])
