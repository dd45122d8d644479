"""Contents of the figure in space: frusta, sheet and segments as lines in mm, the boxes around
them, and the colours of all figures.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import Matches

BLUE, VERMILION, GREEN = "#0072b2", "#d55e00", "#009e73"
PURPLE, ORANGE, SKY, BLACK = "#b8478f", "#e69f00", "#3a9bdc", "#222222"
# What stands in space, by the role of its layer.
COLOUR_OF_ROLE = {
    "three": BLUE,
    "two": VERMILION,
    "cameras": GREEN,
    "sheet": "#777777",
    "ellipsoids": PURPLE,
}
PALETTE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)


def distinct_neighbours(
    midpoints_px: Float[np.ndarray, "t v 2"], colours: int = len(PALETTE)
) -> Int[np.ndarray, "t"]:
    """Number of a colour for each track, such that tracks that are near each other in an image
    differ.

    Each track gets the colour whose earlier tracks are the farthest away.

    midpoints_px : (t, v, 2) midpoints of the tracks, NaN if a view does not show a track.
    """
    colour_of_track = np.zeros(len(midpoints_px), dtype=np.int64)
    for track in range(1, len(midpoints_px)):
        squared = np.sum((midpoints_px[:track] - midpoints_px[track]) ** 2, axis=-1)
        nearness = np.max(np.nan_to_num(1.0 / (squared + 1.0)), axis=-1)
        crowding = np.bincount(colour_of_track[:track], weights=nearness, minlength=colours)
        colour_of_track[track] = int(np.argmin(crowding))
    return colour_of_track


FRUSTUM_SHARE = 0.14
CIRCLE_POINTS = 24


class Box(NamedTuple):
    """Box in space that a figure shows, by its lowest and highest corner, mm."""

    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]

    @classmethod
    def around(cls, points_mm: Float[np.ndarray, "n 3"], room: float) -> "Box":
        """Box around points, with the same margin on all sides.

        room : margin as a share of the longest side of the points' bounding box.
        """
        low, high = points_mm.min(axis=0), points_mm.max(axis=0)
        margin = room * max(float(np.max(high - low)), 1e-6)
        return cls(low - margin, high + margin)


def sheet_outlines(pattern: Pattern) -> list[np.ndarray]:
    """Circles, rings' inner circles and crossed lines of the sheet: (n, 3) lines, mm, at Z = 0."""
    angles = np.linspace(0, 2 * np.pi, CIRCLE_POINTS + 1)
    unit = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    parts = []
    for centre, outer, inner in zip(
        pattern.centres_mm, pattern.radius_mm, pattern.inner_radius_mm, strict=True
    ):
        parts.extend(np.append(centre, 0.0) + r * unit for r in (outer, inner) if r > 0)
    if pattern.line_width_mm > 0:
        for axis, reach in enumerate(pattern.line_half_length_mm):
            end = np.zeros(3)
            end[axis] = reach
            parts.append(np.stack([-end, end]))
    return parts


def frusta(rig: Rig) -> list[np.ndarray]:
    """Drawing of each camera's viewing frustum: one polyline (n, 3) per camera, mm, in the world.

    It has the outline of the image at some depth, lines from the camera centre to its corners, and
    a mark at the upper side. The depth is the same for all cameras.
    """
    centres = np.stack([camera.centre_world_mm for _, camera in rig.items()])
    depth = FRUSTUM_SHARE * float(np.median(np.linalg.norm(centres, axis=1)))
    return [_frustum(camera, depth) for _, camera in rig.items()]


def _frustum(camera: Camera, depth_mm: float) -> np.ndarray:
    width, height = camera.image_size_px
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
    focal = np.asarray(camera.intrinsics.focal_length_px)
    # The outline is that of the picture without distortion, which is what the eye expects.
    rays = (corners - np.asarray(camera.intrinsics.principal_point_px)) / focal
    in_camera = depth_mm * np.column_stack([rays, np.ones(4)])
    centre = camera.centre_world_mm
    world = in_camera @ np.asarray(camera.pose.rotation) + centre
    order = [0, 1, 2, 3, 0]
    spokes = [row for corner in world for row in (centre, corner)]
    # A short line out of the middle of the upper side tells which way is up in the picture.
    middle, upward = (world[0] + world[1]) / 2, (world[0] - world[3]) / 6
    return np.concatenate(
        [world[order], np.stack(spokes), np.stack([world[0], middle, middle + upward])]
    )


def content_box(pattern: Pattern | None, matches: Matches | None) -> Box | None:
    """Box around the sheet and the 3-D segments with a margin; None without both.

    Segments far away from the others are ignored.
    """
    points = []
    if matches is not None and len(matches):
        ends = np.asarray(matches.lines_mm).reshape(-1, 3)
        ends = ends[np.isfinite(ends).all(axis=1)]
        if len(ends):
            middle, spread = np.median(ends, axis=0), np.percentile(ends, [5, 95], axis=0)
            reach = 3 * np.maximum(spread[1] - spread[0], 1e-9)
            points.append(ends[(np.abs(ends - middle) <= reach).all(axis=1)])
    if pattern is not None:
        margin = pattern.radius_mm[:, None]
        circle_corners = np.concatenate([pattern.centres_mm - margin, pattern.centres_mm + margin])
        points.append(np.column_stack([circle_corners, np.zeros(len(circle_corners))]))
    if not points:
        return None
    return Box.around(np.concatenate(points), 0.08)


def whole_box(rig: Rig, content: Box | None) -> Box:
    """Box around the cameras and `content`, with a margin."""
    corners = np.concatenate(frusta(rig))
    if content is not None:
        corners = np.concatenate([corners, np.stack(content)])
    return Box.around(corners, 0.05)
