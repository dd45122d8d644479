"""Disturbed rigs, coverage of 3-D segments, and a sheet with segments; all matches are given.

Lines about the paper's rig are projected, and noise drawn from the claimed covariance; wrong
matches get another segment's fragment in one view.
"""

import jax
import numpy as np

from refine_parts.rigs import (
    ANGLE,
    NAMES,
    SIZES,
    TRUE_RIG,
    TRUTH,
    relative_error,
    rig_at,
)
from trinoc.calib.bundle.refinement import refine
from trinoc.geometry import LineObservations
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import covariance_of_ends

CHI_SQUARE_6_AT_95 = 12.592


def projected(matrices: np.ndarray, ends_mm: np.ndarray) -> np.ndarray:
    """(t, v, 2, 2) images of segments (t, 2, 3)."""
    homogeneous = np.concatenate([ends_mm, np.ones((*ends_mm.shape[:2], 1))], axis=2)
    image = np.einsum("vij,tej->tvei", matrices, homogeneous)
    return image[..., :2] / image[..., 2:]


def made_lines(
    random: np.random.Generator, tracks: int, sigma_px: float, wrong: float, reach_mm: float = 70
) -> tuple[LineObservations, np.ndarray, np.ndarray]:
    """(observations, true ends, mask of wrong ones); a fifth of the tracks has only two views."""
    middle = random.uniform(-reach_mm, reach_mm, (tracks, 3))
    middle[:, 2] = np.abs(middle[:, 2])
    direction = random.standard_normal((tracks, 3))
    direction *= random.uniform(5, 25, (tracks, 1)) / np.linalg.norm(direction, axis=1)[:, None]
    ends = np.stack([middle - direction, middle + direction], axis=1)
    exact = projected(TRUE_RIG.matrices_px, ends)
    covariance = np.stack(
        [covariance_of_ends(exact[:, v], sigma_px, 4 * sigma_px) for v in range(3)], axis=1
    )
    draw = random.standard_normal((tracks, 3, 4))
    noise = np.einsum("tvij,tvj->tvi", np.linalg.cholesky(covariance), draw)
    fragments = exact + noise.reshape(exact.shape)
    bad = random.random(tracks) < wrong
    view = random.integers(0, 3, bad.sum())
    fragments[bad, view] = fragments[random.permutation(tracks)[: bad.sum()], view]
    is_seen = np.ones((tracks, 3), dtype=bool)
    hidden = np.flatnonzero((random.random(tracks) < 0.2) & ~bad)
    is_seen[hidden, random.integers(0, 3, len(hidden))] = False
    return LineObservations(TRUE_RIG.names, fragments, covariance, is_seen, ends), ends, bad


def started_from(rig: Rig, lines: LineObservations) -> LineObservations:
    """The same fragments, with lines triangulated by another (disturbed) rig."""
    from trinoc.geometry import triangulate_segment
    from trinoc.numerics.precision import in_float64

    solve = jax.jit(jax.vmap(triangulate_segment, (None, 0, 0, 0)))
    triangulated = in_float64(solve)(
        rig.matrices_px, lines.fragments_px, lines.covariance_px2, lines.seen
    )
    finite = np.isfinite(triangulated.ends_mm).all(axis=(1, 2))
    start = np.where(finite[:, None, None], triangulated.ends_mm, lines.lines_mm)
    return LineObservations(
        lines.views, lines.fragments_px, lines.covariance_px2, lines.seen, start
    )


def knocked_cameras(trials: int) -> None:
    """Print errors before and after for one disturbed camera and two calibrated by their sheet."""
    print("\nOne camera knocked; rms error of its angles (deg) and distance (mm) before -> after")
    print(f"{'deg, mm':>12} {'lines':>6} {'wrong':>6}  {'angle':>18}  {'distance':>16}"
          f"  within 3 sigma  wrong found")  # fmt: skip
    sigma = np.where(ANGLE, 0.0015, 0.0045)
    for degrees, millimetres in SIZES:
        for tracks, wrong in ((100, 0.05), (100, 0.3), (500, 0.15), (2000, 0.3)):
            before, after, within, caught = [], [], [], []
            for seed in range(trials if tracks < 2000 else max(trials // 3, 1)):
                random = np.random.default_rng([seed, tracks])
                camera = int(random.integers(0, 3))
                unknowns = np.arange(4 * camera, 4 * camera + 4)
                values = TRUTH + sigma * random.standard_normal(12)
                size = np.where(ANGLE, degrees, millimetres)[unknowns]
                values[unknowns] += size * random.choice([-1, 1], 4)
                lines, _, bad = made_lines(random, tracks, 0.3, wrong)
                start = rig_at(values, np.diag(sigma**2))
                answer = refine(start, started_from(start, lines), moved=(TRUE_RIG.names[camera],))
                rows = [answer.parameters.index(NAMES[i]) for i in unknowns]
                error = answer.values[rows] - TRUTH[unknowns]
                before.append((values - TRUTH)[unknowns])
                after.append(error)
                within.append(np.abs(error) < 3 * np.sqrt(np.diag(answer.covariance))[rows])
                caught.append((answer.inlier != lines.seen).any(axis=1)[bad].mean())
            rms = [np.sqrt(np.mean(np.square(e), axis=0)) for e in (before, after)]
            angle = [np.sqrt(np.mean(r[:3] ** 2)) for r in rms]
            print(f"{degrees:5.2f}, {millimetres:4.1f} {tracks:6d} {wrong:6.0%}  "
                  f"{angle[0]:7.4f} -> {angle[1]:7.5f}  {rms[0][3]:6.3f} -> {rms[1][3]:6.4f}"
                  f"  {np.mean(within):13.1%}  {np.mean(caught):10.1%}")  # fmt: skip


def coverage(trials: int) -> None:
    """Print the share of 95 % ellipsoids that contain the true segments, and error over bound."""
    print("\nCoverage of 3-D segments: share inside 95 % ellipsoids, mean chi-square (6), and")
    print("median error over the median of errors drawn from the bound (true cameras and noise)")
    for label, sheet in (("good sheet", 1.0), ("poor sheet, 20 x", 20.0)):
        sigma = sheet * np.where(ANGLE, 0.0015, 0.0045)
        for sigma_px in (0.1, 0.5, 1.0):
            for reach in (40.0, 110.0):
                squared, error, bound = [], [], []
                for seed in range(trials):
                    random = np.random.default_rng([seed, int(10 * sigma_px), int(reach)])
                    lines, ends, _ = made_lines(random, 250, sigma_px, 0.0, reach)
                    start = rig_at(TRUTH + sigma * random.standard_normal(12), np.diag(sigma**2))
                    answer = refine(start, lines)
                    offset = (answer.lines.ends_mm - ends).reshape(-1, 6)
                    covariance = answer.lines.covariance_mm2
                    squared.append(
                        np.einsum("ti,tij,tj->t", offset, np.linalg.inv(covariance), offset)
                    )
                    root = np.linalg.cholesky(covariance / answer.segment_sigma_factor**2)
                    draw = np.einsum("tij,tj->ti", root, random.standard_normal(offset.shape))
                    error.append(np.linalg.norm(offset, axis=1))
                    bound.append(np.linalg.norm(draw, axis=1))
                squared, error, bound = (np.concatenate(x) for x in (squared, error, bound))
                print(
                    f"  {label:18s} {sigma_px:3.1f} px, within {reach:5.0f} mm: "
                    f"{(squared < CHI_SQUARE_6_AT_95).mean():.1%} of {len(squared)}, "
                    f"{squared.mean():.2f}, {np.median(error) / np.median(bound):.3f}"
                )


def sheet_and_segments(trials: int) -> None:
    """Print the 3-D error of held-out segments by the sheet alone, and by sheet and segments."""
    print("\nSheet alone against sheet and segments, on 200 held-out lines without noise:")
    for sheet in (1.0, 10.0, 100.0):
        sigma = sheet * np.where(ANGLE, 0.0015, 0.0045)
        for tracks in (100, 1000):
            alone, together = [], []
            for seed in range(trials):
                random = np.random.default_rng([seed, tracks, int(sheet)])
                lines, _, _ = made_lines(random, tracks, 0.3, 0.05)
                held_out, ends, _ = made_lines(random, 200, 1e-3, 0.0)
                start = rig_at(TRUTH + sigma * random.standard_normal(12), np.diag(sigma**2))
                refined = refine(start, lines).rig
                for rig, errors in ((start, alone), (refined, together)):
                    estimated_mm = started_from(rig, held_out).lines_mm
                    errors.append(np.median(np.linalg.norm(estimated_mm - ends, axis=2)))
            print(f"  sheet {sheet:4.0f} x its bound, {tracks:5d} lines of 0.3 px: median error "
                  f"{1e3 * np.mean(alone):8.2f} -> {1e3 * np.mean(together):8.2f} um")  # fmt: skip


def every_camera(trials: int) -> None:
    """Print errors for all cameras disturbed: with such a sheet, and without, up to the gauge."""
    print("\nAll cameras disturbed, matches given; rms error of orientation (deg) and centre (mm)")
    print("after the best similarity of the whole rig, before -> after")
    for with_sheet in (True, False):
        label = "sheet of this size" if with_sheet else "no sheet"
        for degrees, millimetres in SIZES:
            size = np.where(ANGLE, degrees, millimetres)
            for tracks, wrong in ((100, 0.05), (100, 0.3), (500, 0.15)):
                before, after, within = [], [], []
                for seed in range(trials):
                    random = np.random.default_rng([seed, tracks, 7])
                    values = TRUTH + size * random.standard_normal(12)
                    lines, _, _ = made_lines(random, tracks, 0.3, wrong)
                    start = rig_at(values, np.diag(size**2) if with_sheet else None)
                    free = None if with_sheet else PoseModel.AIMED
                    answer = refine(start, started_from(start, lines), pose_model=free)
                    before.append(relative_error(start, TRUE_RIG))
                    after.append(relative_error(answer.rig, TRUE_RIG))
                    if with_sheet:
                        error = np.abs(answer.values - TRUTH)
                        within.append(error < 3 * np.sqrt(np.diag(answer.covariance)))
                ours, theirs = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (before, after))
                worst = np.max(after, axis=0)
                share = f"{np.mean(within):.1%} within 3 sigma" if with_sheet else ""
                print(f"{label:18s} {degrees:4.2f} {millimetres:3.1f} {tracks:4d} {wrong:4.0%} "
                      f"{ours[0]:.3f}, {ours[1]:5.2f} -> {theirs[0]:.4f}, {theirs[1]:5.3f} "
                      f"(worst {worst[0]:.3f}, {worst[1]:5.2f}) {share}", flush=True)  # fmt: skip


def run(trials: int) -> None:
    """Print every table."""
    coverage(trials)
    sheet_and_segments(trials)
    knocked_cameras(trials)
    every_camera(trials)
