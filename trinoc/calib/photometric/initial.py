"""A first guess of light, ink and blur, read off the picture at the circles."""

import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.appearance import LIGHT_TERMS, Appearance
from trinoc.calib.photometric.outlines import circle_points_mm, project_to_image
from trinoc.calib.photometric.square_pixels import places_to_look_at
from trinoc.calib.targets import Pattern, SquareSheet
from trinoc.geometry import AbstractLens, Pose

# A central difference over two pixels sees an edge as if blurred by this variance more.
_DIFFERENCE_VARIANCE = 1 / 3
_LEAST_SIGMA_PX, _LARGEST_SIGMA_PX = 0.4, 8.0


def initial_appearance(
    image: Float[np.ndarray, "h w"], pose: Pose, lens: AbstractLens, pattern: Pattern | SquareSheet
) -> Appearance:
    """Medians over all places: of the paper beside, the ink inside, the steepness between."""
    outlines = _places(pattern)
    sampled = np.asarray(project_to_image(pose, lens, np.concatenate(outlines)))
    limit = np.array(image.shape[::-1]) - 1
    ends = np.cumsum([len(part) for part in outlines])[:-1]
    places = np.split(np.round(sampled).astype(int), ends)
    ink, edge, paper = (p[((p >= 1) & (p < limit)).all(axis=1)] for p in places)
    u, v = edge[:, 0], edge[:, 1]
    slope = 0.5 * np.hypot(image[v, u + 1] - image[v, u - 1], image[v + 1, u] - image[v - 1, u])
    paper_grey = float(np.median(image[paper[:, 1], paper[:, 0]]))
    ink_grey = float(np.median(image[ink[:, 1], ink[:, 0]]))
    steepest = max(float(np.median(slope)), 1e-6)
    variance = ((paper_grey - ink_grey) / (steepest * np.sqrt(2 * np.pi))) ** 2
    sigma = np.sqrt(max(variance - _DIFFERENCE_VARIANCE, _LEAST_SIGMA_PX**2))
    light = np.zeros(LIGHT_TERMS)
    light[0] = paper_grey
    return Appearance(
        np.asarray(min(sigma, _LARGEST_SIGMA_PX)),
        np.asarray(0.0),
        np.asarray(ink_grey / max(paper_grey, 1e-6) - 1),
        light,
    )


def _places(pattern: Pattern | SquareSheet) -> tuple[Float[np.ndarray, "_n 2"], ...]:
    """Of the sheet: in ink, on edges, on paper."""
    if isinstance(pattern, SquareSheet):
        return places_to_look_at(pattern)
    outer, inner = pattern.radius_mm, pattern.inner_radius_mm
    radii = (0.5 * (outer + inner), outer, outer + 0.3 * outer)
    return tuple(circle_points_mm(pattern.centres_mm, radius).reshape(-1, 2) for radius in radii)
