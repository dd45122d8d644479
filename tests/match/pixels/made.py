"""Pictures of separate lines: an exact blurred step along each line."""

import numpy as np
from scipy.special import ndtr

from trinoc.geometry import undistort_pixels
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.synth import table1_rig

RIG = table1_rig()
VIEWS = RIG.names
BLUR_PX, NOISE, SIGMA_MM = 0.9, 2.0, 0.06


def image_px(view, points):
    matrix = RIG[view].matrix_px
    image = points @ matrix[:, :3].T + matrix[:, 3]
    return image[..., :2] / image[..., 2:]


def lines_of(seed):
    """Twelve lines, 22 mm long, in all directions, that are separate in all pictures."""
    generator = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-54, 54, 4), np.linspace(-36, 36, 3))
    middle = np.column_stack([x.ravel(), y.ravel(), generator.uniform(0, 8, 12)])
    direction = generator.normal(size=(12, 3)) * np.array([1, 1, 0.3])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return np.stack([middle - 11 * direction, middle + 11 * direction], axis=1)


def light_of(
    view,
    lines,
    blur_px: float | np.ndarray = BLUR_PX,
    low: float = 70.0,
    high: float = 130.0,
    lens: Intrinsics | None = None,
    beside_px: float | np.ndarray = 0.0,
):
    """The light without noise. `blur_px`, and `beside_px`, the offset of each edge to the right
    of its line, may be one number per line."""
    width, height = RIG[view].image_size_px
    v, u = np.mgrid[:height, :width].astype(float)
    if lens is not None:
        pixels = np.stack([u, v], axis=-1)
        u, v = np.moveaxis(undistort_pixels(lens, pixels), -1, 0)
    ends = image_px(view, lines)
    middle = ends.mean(axis=1)
    owner = np.hypot(u[..., None] - middle[:, 0], v[..., None] - middle[:, 1]).argmin(axis=-1)
    direction = ends[:, 1] - ends[:, 0]
    normal = (
        np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        / np.linalg.norm(direction, axis=1)[:, None]
    )
    # Always toward the right of the picture, so that a line has one darker side in all views.
    normal *= np.where(normal[:, :1] < 0, -1, 1)
    off = (u - middle[owner, 0]) * normal[owner, 0] + (v - middle[owner, 1]) * normal[owner, 1]
    off -= np.broadcast_to(beside_px, len(lines))[owner]
    width_px = np.broadcast_to(blur_px, len(lines))[owner]
    return low + (high - low) * ndtr(off / width_px)


def noisy(light, generator, sigma=NOISE):
    return np.clip(np.rint(light + sigma * generator.normal(size=light.shape)), 0, 255).astype(
        np.uint8
    )


def matches_of(lines, generator, views=VIEWS):
    """Matches whose lines and segments have errors of their reported sigmas."""
    count = len(lines)
    noisy_lines = lines + SIGMA_MM * generator.normal(size=lines.shape)
    index = np.tile(np.arange(count)[:, None], (1, len(views)))
    segments = {
        view: Segments.from_endpoints(
            image_px(view, lines) + 0.15 * generator.normal(size=(count, 2, 2)), sigma_px=0.15
        )
        for view in views
    }
    fragments = np.stack([segments[view].endpoints_px for view in views], axis=1)
    covariance = np.stack([segments[view].covariance_px2 for view in views], axis=1)
    return segments, Matches(
        views,
        index,
        fragments,
        noisy_lines,
        np.tile(SIGMA_MM**2 * np.eye(6), (count, 1, 1)),
        np.full(count, "trinocular"),
        np.full(count, 0.9),
        np.zeros(count),
        {view: np.full(count, "matched") for view in views},
        {},
        covariance,
        np.zeros(count),
    )
