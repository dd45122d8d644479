"""A first pose of a plane board from the rays of its places, whatever the lens."""

import numpy as np
from jaxtyping import Float

FEWEST_PLACES = 4


def plane_pose(
    rays: Float[np.ndarray, "m 3"], places_mm: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "3 4"] | None:
    """cam_from_board of the homography from the board to the rays; None where there is none.

    Rays are of any length and may look backwards, as those of a fisheye do: each is parallel to H
    (X, Y, 1), which is two equations. Source: Hartley and Zisserman, section 4.1.
    """
    middle, spread = places_mm.mean(axis=0), float(np.std(places_mm)) or 1.0
    place = np.append((places_mm - middle) / spread, np.ones((len(places_mm), 1)), axis=1)
    # The two directions across each ray.
    _, _, axes = np.linalg.svd(rays[:, None, :])
    rows = (axes[:, 1:, :, None] * place[:, None, None, :]).reshape(-1, 9)
    _, values, vectors = np.linalg.svd(rows)
    if not (np.isfinite(values).all() and values[7] > 1e-9 * values[0]):
        return None
    homography = vectors[-1].reshape(3, 3)
    if np.sum(rays * (place @ homography.T)) < 0:
        homography = -homography
    first, second, origin = homography.T
    length = np.sqrt(np.linalg.norm(first) * np.linalg.norm(second))
    turn = np.stack([first, second, np.cross(first, second) / length], axis=1)
    u, _, v = np.linalg.svd(turn)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    translation = origin * spread / length - rotation[:, :2] @ middle
    return np.column_stack([rotation, translation])
