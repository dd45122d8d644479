"""Static figures for notebooks and papers, on matplotlib axes (`pip install trinoc[plot]`)."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from trinoc.calib.result.calibration import CameraFit
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.report.pictures import clip_line
from trinoc.report.space_content import (
    BLUE,
    GREEN,
    PALETTE,
    VERMILION,
    content_box,
    distinct_neighbours,
    frusta,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from mpl_toolkits.mplot3d import Axes3D

OUTLINE_POINTS = 48


def draw_image(axes: "Axes", picture: np.ndarray, *, strength: float = 1.0) -> None:
    """Draw an image in its pixel coordinates. strength : 1 for full contrast, less to fade it to
    white.
    """
    axes.imshow(picture, cmap="gray", alpha=strength, interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])


def draw_detection(
    axes: "Axes", picture: np.ndarray, fit: CameraFit, *, magnification: float
) -> None:
    """Draw the detected circles, the sheet's two crossed lines, and the magnified residuals."""
    from matplotlib.collections import LineCollection

    draw_image(axes, picture, strength=0.8)
    detection = fit.detection
    angles = np.linspace(0, 2 * np.pi, OUTLINE_POINTS)
    unit = np.stack([np.cos(angles), np.sin(angles)])
    roots = np.linalg.cholesky(np.asarray(detection.shape_px2))
    outlines = detection.centres_px[:, None] + np.swapaxes(roots @ unit, 1, 2)
    axes.add_collection(LineCollection(list(outlines), colors=BLUE, linewidths=1.0))
    lines = [clip_line(line, detection.image_size_px) for line in detection.lines_px]
    ends = [line for line in lines if line is not None]
    axes.add_collection(LineCollection(ends, colors=GREEN, linewidths=1.0))
    axes.quiver(
        *detection.centres_px[fit.used].T,
        *(magnification * fit.residuals_px[fit.used]).T,
        angles="xy", scale_units="xy", scale=1, color=VERMILION, width=0.006, zorder=3,
    )  # fmt: skip


def draw_segments(axes: "Axes", picture: np.ndarray, segments: Segments) -> None:
    """Draw every segment of an image with its ends (figure 6 of the paper)."""
    from matplotlib.collections import LineCollection

    draw_image(axes, picture, strength=0.4)
    ends = np.asarray(segments.endpoints_px)
    axes.add_collection(LineCollection(list(ends), colors=BLUE, linewidths=1.2))
    axes.plot(*ends.reshape(-1, 2).T, linestyle="none", marker=".", markersize=3, color=BLUE)


def draw_tracks(axes: "Axes", picture: np.ndarray, matches: Matches, view: str, stage: str) -> None:
    """Draw the tracks of one stage in one view, with one colour for each track (figure 7 of the
    paper).
    """
    from matplotlib.collections import LineCollection

    draw_image(axes, picture, strength=0.4)
    fragments = np.asarray(matches.fragments_px)
    colours = distinct_neighbours(fragments.mean(axis=2))
    column = matches.views.index(view)
    is_drawn = (np.asarray(matches.stage) == stage) & (np.asarray(matches.index)[:, column] >= 0)
    axes.add_collection(
        LineCollection(
            list(fragments[is_drawn, column]),
            colors=[PALETTE[colour] for colour in colours[is_drawn]],
            linewidths=1.8,
        )
    )


def draw_space(axes: "Axes3D", matches: Matches, rig: Rig | None = None) -> None:
    """Draw the 3-D segments and, if `rig` is given, the cameras, in mm with equal axes."""
    lines, stage = np.asarray(matches.lines_mm), np.asarray(matches.stage)
    box = content_box(None, matches)
    corners = np.zeros((1, 3)) if box is None else np.stack(box)
    strokes = [
        (list(lines[stage == name]), colour)
        for name, colour in ((TRINOCULAR, BLUE), (BINOCULAR, VERMILION))
    ]
    if rig is not None:
        strokes.append((frusta(rig), GREEN))
        corners = np.concatenate([corners, *frusta(rig)])
    draw_lines_in_space(axes, strokes, corners)


def draw_lines_in_space(
    axes: "Axes3D",
    strokes: Sequence[tuple[Sequence[np.ndarray], str]],
    within: Float[np.ndarray, "n 3"] | None = None,
) -> None:
    """Draw lines in mm with equal axes.

    strokes : groups of (n, 3) lines with their colour. within : points that the axes must contain.
    """
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    for lines, colour in strokes:
        if len(lines):
            axes.add_collection3d(Line3DCollection(list(lines), colors=colour, linewidths=1.4))
    if within is None:
        all_lines = [line for lines, _ in strokes for line in lines]
        within = np.concatenate(all_lines) if all_lines else np.zeros((1, 3))
    low, high = np.nanmin(within, axis=0), np.nanmax(within, axis=0)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_aspect("equal")
    axes.view_init(elev=28, azim=-72)
    # Y points into the page: its numbers have a third of the room.
    shares = np.array([1.0, 1 / 3, 1.0]) * (high - low) / max(np.max(high - low), 1e-9)
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), shares.tolist(), strict=True):
        axis.set_major_locator(
            MaxNLocator(max(int(np.ceil(5 * share)), 1), steps=[1, 2, 2.5, 5, 10])
        )
    axes.set_xlabel("X (mm)")
    axes.set_ylabel("Y (mm)", labelpad=8)
    axes.set_zlabel("Z (mm)")
