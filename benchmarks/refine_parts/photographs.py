"""Photographs of the Merton College with disturbed cameras, refined by their line matches.

The folder holds vgg_merton1 (VGG, Oxford): matrices, segments, published matches of lines, and
published points with their images, which no refinement sees. Every camera is turned about any axis
and shifted any way; each degree goes with the centre's shift of as much of the distance between the
cameras as 5 mm are of those of the paper's rig. Points are triangulated by each rig: what is shown
is the root mean square, and the median, of their distance from their images, and the error of
the cameras after the best similarity.
"""

from pathlib import Path

import jax
import numpy as np
from shared_scenes import VIEWS

from refine_parts.rigs import knocked, relative_error
from trinoc.calib.bundle.refinement import refine
from trinoc.calib.bundle.result import RefineStatus
from trinoc.geometry import LineObservations, triangulate_segment
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.matcher import match_segments
from trinoc.numerics.precision import in_float64
from trinoc.numerics.tables import take_rows

PAPERS_BASELINE_MM = 300.0
TOLERANT_SIGMA_PX = 4.0  # as the command takes it


def reprojection_px(rig: Rig, images: list[np.ndarray], where: np.ndarray) -> tuple[float, float]:
    """(rms, median) reprojection error of points triangulated by least squares, px."""
    matrices = rig.matrices_px
    distances = []
    for row in where:
        views = np.flatnonzero(row >= 0)
        if len(views) < 3:
            continue
        uv = np.array([images[v][row[v]] for v in views])
        point = _point(matrices[views], uv)
        image = matrices[views] @ np.append(point, 1.0)
        distances.append(np.linalg.norm(image[:, :2] / image[:, 2:] - uv, axis=1))
    every = np.concatenate(distances)
    return float(np.sqrt(np.mean(every**2))), float(np.median(every))


def _point(matrices: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Triangulated point: the linear solution, then Gauss-Newton steps."""
    rows = np.concatenate([uv[:, :1] * matrices[:, 2] - matrices[:, 0],
                           uv[:, 1:] * matrices[:, 2] - matrices[:, 1]])  # fmt: skip
    rows /= np.linalg.norm(rows[:, :3], axis=1, keepdims=True)
    point = -np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)[0]
    for _ in range(5):
        image = matrices @ np.append(point, 1.0)
        off = image[:, :2] / image[:, 2:] - uv
        slope = matrices[:, :2, :3] - (image[:, :2] / image[:, 2:])[..., None] * matrices[:, 2:, :3]
        slope = (slope / image[:, 2:, None]).reshape(-1, 3)
        point = point - np.linalg.lstsq(slope, off.reshape(-1), rcond=None)[0]
    return point


def published(segments: dict[str, np.ndarray], matches: np.ndarray, rig: Rig) -> LineObservations:
    """The published matches, with lines triangulated by a rig."""
    view_segments = {
        view: Segments.from_endpoints(segments[view][matches[:, v]]) for v, view in enumerate(VIEWS)
    }
    fragments = np.stack([np.asarray(view_segments[view].endpoints_px) for view in VIEWS], axis=1)
    # Both ends run as those of the first view do.
    directions = fragments[:, :, 1] - fragments[:, :, 0]
    swap = (directions * directions[:, :1]).sum(axis=-1) < 0
    fragments = np.where(swap[..., None, None], fragments[:, :, ::-1], fragments)
    covariance = np.stack(
        [np.asarray(view_segments[view].covariance_px2) for view in VIEWS], axis=1
    )
    is_seen = np.ones(matches.shape, dtype=bool)
    solve = in_float64(jax.jit(jax.vmap(triangulate_segment, (None, 0, 0, 0))))
    ends = np.asarray(solve(rig.matrices_px, fragments, covariance, is_seen).ends_mm)
    good = np.isfinite(ends).all(axis=(1, 2))
    lines = LineObservations(VIEWS, fragments, covariance, is_seen, ends)
    return take_rows(lines, np.flatnonzero(good))


def run(folder: Path, trials: int, *, published_only: bool) -> None:
    """Print the tables; `published_only` leaves out the matches of trinoc."""
    data = np.load(folder / "vgg_merton1" / "merton1.npz")
    segments = {view: data[f"segments_{v}"] for v, view in enumerate(VIEWS)}
    points = [data[f"corners_{v}"] for v in range(3)]
    true = Rig.from_matrices(dict(zip(VIEWS, data["projection"], strict=True)), (1024, 768))
    centres = np.stack([camera.centre_world_mm for camera in true.cameras])
    unit = float(np.linalg.norm(centres[0] - centres[1])) / PAPERS_BASELINE_MM

    def shown(rig: Rig) -> str:
        rms, median = reprojection_px(rig, points, data["point_matches"])
        angle, shift = relative_error(rig, true)
        return f"{rms:8.3f} {median:7.3f} {angle:7.4f} {shift / unit:7.3f}"

    def match(rig: Rig, sigma_px: float | None = None):
        return match_segments(segments, rig, sigma_px=sigma_px)

    print(
        "points' rms and median (px), cameras' error (deg, and mm of a rig as wide as the paper's)"
    )
    print(f"as published                   {shown(true)}")
    for degrees, millimetres in ((0.0, 0.0), (0.05, 0.1), (0.2, 1.0), (0.5, 2.5), (1.0, 5.0)):
        for trial in range(trials if degrees else 1):
            random = np.random.default_rng(trial)
            start = knocked(true, VIEWS, (degrees, millimetres * unit), random)
            print(f"{degrees:4.2f} {millimetres:3.1f} disturbed             {shown(start)}")
            refined = refine(start, published(segments, data["line_matches"], start))
            answers = [("published matches", refined)]
            if not published_only:
                rematches = [lambda rig: match(rig, TOLERANT_SIGMA_PX), match]
                ours = refine(start, match(start), match_again=rematches)
                answers.append(("our matches", ours))
            for label, answer in answers:
                refused = answer.status in (RefineStatus.AMBIGUOUS, RefineStatus.NOT_CONVERGED)
                note = answer.status.name.lower() if refused else ""
                print(f"         {label:20s}  {shown(answer.rig)} noise "
                      f"{answer.segment_sigma_factor:.2f} {note}", flush=True)  # fmt: skip
