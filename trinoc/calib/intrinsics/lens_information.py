"""What the pictures say of the lens once the pose of each is eliminated."""

import numpy as np
from jaxtyping import Float

from trinoc.calib.intrinsics.lens_fit import LensFit
from trinoc.calib.intrinsics.lens_parameters import LensModel, free_directions
from trinoc.geometry import PoseModel
from trinoc.numerics import Observability, observability


def lens_information(information: Float[np.ndarray, "*k s s"]) -> Float[np.ndarray, "*k q q"]:
    """Information on the q = s - 6 scaled parameters in one picture whose pose is unknown.

    A pose that the circles leave open tells nothing in its open directions.
    """
    count = information.shape[-1] - PoseModel.RIGID.size
    lens, coupling = information[..., :count, :count], information[..., :count, count:]
    motion = np.linalg.pinv(information[..., count:, count:], hermitian=True)
    reduced = lens - coupling @ motion @ np.swapaxes(coupling, -1, -2)
    return 0.5 * (reduced + np.swapaxes(reduced, -1, -2))


def directions_of(model: LensModel) -> Float[np.ndarray, "q f"]:
    """Change of all scaled parameters with each parameter of `model.free`."""
    directions = free_directions(model)
    return directions[:, np.any(directions != 0.0, axis=0)]


def lens_observability(fit: LensFit, model: LensModel, variance_factor: float) -> Observability:
    """Rank, covariance and open parameters of the lens's parameters; held ones have variance 0.

    variance_factor : by how much the circles scatter more than their covariances say.
    """
    directions = directions_of(model)
    total = lens_information(np.asarray(fit.information)).sum(axis=0) / variance_factor
    # In scaled parameters every direction is held to one limit: there is no other for each.
    return observability(
        directions.T @ total @ directions,
        np.asarray(fit.scale)[:, None] * directions,
        np.full(len(directions), np.inf),
    )
