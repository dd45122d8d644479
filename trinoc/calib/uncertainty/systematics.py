"""Errors that no repetition of a picture shows: of the sheet and of the lens.

They move every camera that looks at the sheet in the same way, so that they join the cameras'
parameters in one covariance, and they are larger than the noise: a tenth of a percent of print
scale is half a millimetre of distance, a hundred times the bound of a good picture.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.model import (
    CircleObservations,
    bucket_size,
    circle_observations,
    predicted_centre_px,
)
from trinoc.calib.pose import DEGREES, pose_of_values
from trinoc.calib.result import CalibrationResult
from trinoc.errors import InputError
from trinoc.geometry import (
    PARAMETER_NAMES,
    AbstractLens,
    Intrinsics,
    Pose,
    PoseModel,
    Rig,
    promoted,
)
from trinoc.numerics import ArrayLike, in_float64

# Shared by all cameras: print scale along X and Y, and three ways in which a sheet bends.
_SHARED = 5


class Systematics(NamedTuple):
    """What is known of the errors of the sheet and the lens; zeros and None leave them out.

    Fields
    ------
    print_scale_sigma : of the print's scale along X and along Y, as shares (1e-3 is a tenth of
        a percent). `trinoc.calib.targets.print_scale` gets them from two measured bars.
    flatness_mm : sigma of the height, at the circles farthest from the origin, of each of the
        three ways in which a sheet bends: along X, along Y, and twisted.
    lens_covariance : (k, k) of the first k of the lens's `parameter_names` (for an ideal lens those
        of Brown-Conrady), as `trinoc intrinsics` writes it. One matrix is of one calibrated lens
        that all cameras were given, whose error they share; a mapping holds one for each camera by
        name, and those errors are independent.
    """

    print_scale_sigma: tuple[float, float] = (0.0, 0.0)
    flatness_mm: float = 0.0
    lens_covariance: np.ndarray | Mapping[str, np.ndarray] | None = None

    def lens_factors(
        self, lenses: Mapping[str, Intrinsics | None]
    ) -> dict[str, Float[np.ndarray, "_ _"]]:
        """For each camera whose lens is uncertain, L (k, r) with L L^T its covariance.

        lenses : of all cameras; None for one that takes no part.

        Raises InputError for a covariance of another shape or not finite, or one of a camera
        that is not among `lenses`.
        """
        given = self.lens_covariance
        if given is None:
            return {}
        if not isinstance(given, Mapping):
            return {
                name: _factor(_checked(given, lens.lens, "of all cameras"))
                for name, lens in lenses.items()
                if lens is not None
            }
        for name in given:
            if name not in lenses:
                raise InputError(
                    f'`lens_covariance` names the camera "{name}", but the cameras are '
                    f"{', '.join(lenses)}."
                )
        return {
            name: _factor(_checked(matrix, lens.lens, f'of camera "{name}"'))
            for name, matrix in given.items()
            if (lens := lenses[name]) is not None
        }

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
            given = self.lens_covariance
            of = f" of {', '.join(given)}" if isinstance(given, Mapping) else ""
            terms.append(f"the lens's own covariance{of}")
        return tuple(terms)


@in_float64
def with_systematics(result: CalibrationResult, systematics: Systematics) -> CalibrationResult:
    """The same calibration with systematic errors added to its covariance.

    Each error moves the circles' centres, and with them the least-squares solution, linearly:
    the implicit derivative of the fitted pose, -(J^T J)^-1 J^T dr/de, carries its covariance.
    `trinoc.calibrate(systematics=)` has the picture, and asks it what an error of the lens does.

    Raises InputError for a negative sigma, a lens covariance of another shape or not finite,
    or one for a camera that the result does not know.
    """
    lenses = dict.fromkeys(result.status) | {
        name: camera.intrinsics for name, camera in result.rig.items()
    }
    factors = systematics.lens_factors(lenses)
    return with_spreads(result, systematics, factors, {})


def with_spreads(
    result: CalibrationResult,
    systematics: Systematics,
    factors: Mapping[str, Float[np.ndarray, "_ _"]],
    spreads: Mapping[str, Float[np.ndarray, "_ _"]],
) -> CalibrationResult:
    """`with_systematics`, where `spreads` knows what the lens's errors do to some cameras."""
    if min(*systematics.print_scale_sigma, systematics.flatness_mm) < 0:
        raise InputError("A sigma of `Systematics` is negative: give standard deviations.")
    sheet_sigma = np.array([*systematics.print_scale_sigma, *np.full(3, systematics.flatness_mm)])
    names = result.rig.names
    count = len(result.parameters) // len(names)
    lens_is_shared = not isinstance(systematics.lens_covariance, Mapping)
    covariance, shared = np.array(result.covariance), []
    for k, name in enumerate(names):
        response = _response(result, name, count)
        columns = [response[:, :_SHARED] * sheet_sigma]
        if name in factors:
            factor = factors[name]
            by_lens = spreads.get(name, response[:, _SHARED:][:, : len(factor)] @ factor)
            if lens_is_shared:
                columns.append(by_lens)
            else:
                block = slice(k * count, (k + 1) * count)
                covariance[block, block] += by_lens @ by_lens.T
        shared.append(np.concatenate(columns, axis=1))
    stacked = np.concatenate(shared)
    covariance += stacked @ stacked.T
    rig = Rig(dict(result.rig.items()), parameters=result.parameters, covariance=covariance)
    words = (*result.systematics, *systematics.words)
    return replace(result, rig=rig, covariance=covariance, systematics=words)


def _checked(matrix: np.ndarray, lens: AbstractLens, whose: str) -> Float[np.ndarray, "k k"]:
    matrix, names = np.asarray(matrix, dtype=np.float64), promoted(lens).parameter_names
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or len(matrix) > len(names):
        raise InputError(
            f"The lens covariance {whose} has shape {matrix.shape}, but must be (k, k) for the "
            f"first k of {', '.join(names)}."
        )
    if not (np.isfinite(matrix).all() and (np.diag(matrix) >= 0).all()):
        raise InputError(
            f"The lens covariance {whose} is no covariance of a lens that is determined: "
            "take the pictures that `trinoc intrinsics` asks for."
        )
    return matrix


def _factor(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k r"]:
    """One sigma along each direction in which the lens is uncertain."""
    sigma = np.sqrt(np.diag(covariance))
    free = np.flatnonzero(sigma > 0)
    correlation = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    values, vectors = np.linalg.eigh(correlation)
    kept = values > 1e-12 * values.max(initial=0.0)
    factor = np.zeros((len(covariance), int(kept.sum())))
    factor[free] = sigma[free, None] * vectors[:, kept] * np.sqrt(values[kept])
    return factor


def _response(result: CalibrationResult, name: str, count: int) -> Float[np.ndarray, "p e"]:
    """Change of a camera's parameters, in degrees and mm, for a unit of each error."""
    fit, camera = result.fits[name], result.rig[name]
    values = [getattr(camera, key) for key in PARAMETER_NAMES[:4]]
    pose = pose_of_values(np.array([*values, *camera.aim_mm]))
    circles = circle_observations(
        fit.detection, result.pattern, bucket_size(len(fit.detection)), fit.used
    )
    by_step, by_error, by_delta = (
        np.asarray(part) for part in _derivatives(pose, promoted(camera.intrinsics.lens), circles)
    )
    by_step, by_delta = by_step[:, :count], by_delta[:count, :count]
    step = -np.linalg.solve(by_step.T @ by_step, by_step.T @ by_error)
    return DEGREES[:count, None] * by_delta @ step


@jax.jit
def _derivatives(
    pose: Pose, lens: AbstractLens, circles: CircleObservations
) -> tuple[Float[ArrayLike, "n 6"], Float[ArrayLike, "n e"], Float[ArrayLike, "6 6"]]:
    """Whitened centres by a step of the pose and by every error, and parameters by that step."""
    model, unit_mm = PoseModel.AIM_FREE, pose.distance_mm
    reach = jnp.sqrt(jnp.max(jnp.sum(circles.centres_sheet_mm**2, axis=1)))

    def centres(step: Float[ArrayLike, "6"], error: Float[ArrayLike, "e"]) -> ArrayLike:
        stepped = pose.retract(step, model, unit_mm)
        deformed = lens.retract(error[_SHARED:])

        def centre(place: Float[ArrayLike, "2"], radius: Float[ArrayLike, ""]) -> ArrayLike:
            scaled = place * (1 + error[:2])
            x, y = place[0] / reach, place[1] / reach
            height = error[2] * x * x + error[3] * y * y + error[4] * x * y
            flat = stepped.cam_from_sheet @ jnp.append(scaled, 1.0)
            raised = flat + stepped.rotation[:, 2] * height
            lift = deformed.project_ray(raised) - deformed.project_ray(flat)
            return predicted_centre_px(stepped, deformed, scaled, radius) + lift

        predicted = jax.vmap(centre)(circles.centres_sheet_mm, circles.radius_mm)
        return jnp.einsum("nij,nj->ni", circles.whitening, predicted).reshape(-1)

    zero, none = jnp.zeros(model.size), jnp.zeros(_SHARED + len(lens.parameter_names))
    by_step, by_error = jax.jacfwd(centres, argnums=(0, 1))(zero, none)
    return by_step, by_error, pose.d_parameters_d_delta(model, unit_mm, pose)
