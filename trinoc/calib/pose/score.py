"""Is the model right? What a circle fit's residuals say of everything it holds fixed.

A score test: of each unknown that the model leaves out (the aim, the focal length, radial
distortion) the residuals tell how much chi-square it would take away, without another fit.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from trinoc.calib.detection import Detection
from trinoc.calib.model import (
    CircleObservations,
    bucket_size,
    circle_observations,
    whitened_residuals,
)
from trinoc.calib.pose.estimate import PoseEstimate, pose_of_values
from trinoc.calib.result import Alternative
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Intrinsics, Pose, PoseModel, promoted
from trinoc.numerics import ArrayLike

# Columns of the extended Jacobian: six of the pose, then focal length, then distortion k1.
_AIM, _FOCAL, _RADIAL = [4, 5], [6], [7]


def score_test(
    fit: PoseEstimate, lens: Intrinsics, detection: Detection, pattern: Pattern
) -> list[Alternative]:
    """Every alternative to the model, the one that explains most of the residuals first."""
    pose, used, count = pose_of_values(fit.values), fit.used, len(fit.covariance)
    size = bucket_size(len(detection))
    circles = circle_observations(detection, pattern, size, used)
    residual, jacobian = (
        np.asarray(part) for part in _extended(pose, promoted(lens.lens), circles)
    )
    base = jacobian[:, :count]
    alternatives = []
    for name, columns in (("aim", _AIM), ("focal length", _FOCAL), ("radial distortion", _RADIAL)):
        if columns[0] < count or columns[-1] >= jacobian.shape[1]:
            continue
        freedom = 2 * int(used.sum()) - count - len(columns)
        if freedom < 1:
            continue
        alternatives.append(
            _score(name, residual, base, jacobian[:, columns], freedom, float(pose.distance_mm))
        )
    return sorted(alternatives, key=lambda item: item.p_value)


def model_sentence(alternatives: list[Alternative]) -> str:
    """One plain sentence: the likeliest thing that is wrong, or that nothing is."""
    if not alternatives:
        return "There are too few circles to judge the model."
    first = alternatives[0]
    if first.found:
        return first.sentence
    return "The residuals show nothing that the model leaves out."


def _score(
    name: str,
    residual: Float[np.ndarray, "n"],
    base: Float[np.ndarray, "n p"],
    extra: Float[np.ndarray, "n k"],
    freedom: int,
    distance_mm: float,
) -> Alternative:
    basis, _ = np.linalg.qr(base)
    left = residual - basis @ (basis.T @ residual)
    across = extra - basis @ (basis.T @ extra)
    normal = across.T @ across
    estimate = -np.linalg.solve(normal, across.T @ left)
    drop = float(estimate @ normal @ estimate)
    # Centres that scatter more than they claim scatter alike in every direction.
    scale = max(1.0, (float(left @ left) - drop) / freedom)
    sigma = np.sqrt(scale * np.diag(np.linalg.inv(normal)))
    if name == "aim":
        estimate, sigma = distance_mm * estimate, distance_mm * sigma
    p_value = float(chi2.sf(drop / scale, len(estimate)))
    return Alternative(
        name, drop / scale, p_value, estimate, sigma, _sentence(name, estimate, sigma)
    )


def _sentence(name: str, estimate: Float[np.ndarray, "k"], sigma: Float[np.ndarray, "k"]) -> str:
    if name == "aim":
        return (
            f"the optical axis misses the origin of the sheet by ({estimate[0]:.2f}, "
            f"{estimate[1]:.2f}) +- ({sigma[0]:.1g}, {sigma[1]:.1g}) mm: use parameters=6."
        )
    if name == "focal length":
        return (
            f"the residuals look like a focal length {100 * estimate[0]:+.3f} +- "
            f"{100 * sigma[0]:.1g} % off: check the lens and its focus."
        )
    return (
        f"the residuals look like radial distortion k1 = {estimate[0]:+.3f} +- {sigma[0]:.3f} "
        "that the lens does not hold: calibrate its intrinsics."
    )


@jax.jit
def _extended(
    pose: Pose, lens: AbstractLens, circles: CircleObservations
) -> tuple[Float[ArrayLike, "n"], Float[ArrayLike, "n k"]]:
    """Whitened residuals and their derivative by pose (6), log focal length and k1.

    A lens model without a k1 has no last column.
    """
    radial = [name == "k1" for name in lens.parameter_names]

    def residuals(change: Float[ArrayLike, "k"]) -> Float[ArrayLike, "n"]:
        # The principal point stays: scale the focal lengths alone.
        factor = jnp.stack([1 + change[6], 1 + change[6]])
        other = lens.with_focal_factor(factor)
        if any(radial):
            other = other.retract(jnp.where(np.array(radial), change[7], 0.0))
        stepped = pose.retract(change[:6], PoseModel.AIM_FREE, pose.distance_mm)
        return whitened_residuals(stepped, other, circles).reshape(-1)

    zero = jnp.zeros(8 if any(radial) else 7)
    return residuals(zero), jax.jacfwd(residuals)(zero)
