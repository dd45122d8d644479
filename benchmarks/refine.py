"""Joint refinement: disturbed rigs, coverage of 3-D segments, a sheet helped by segments, time.

    python benchmarks/refine.py [--trials N]

Lines about the paper's rig are projected, and noise drawn from the claimed covariance; wrong
matches get another segment's fragment in one view. Beside ours in the same run:
scipy.optimize.least_squares with the sparsity of the same problem (six numbers per camera, four
per line), from the same start. pyceres and pycolmap have no residual of a line: a cost function
in Python would measure Python.
"""

import argparse
import resource
import time

import jax
import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from trinoc.calib.joint.camera_state import Freedom
from trinoc.calib.joint.refine import refine
from trinoc.geometry.camera import Camera
from trinoc.geometry.line_observations import LineObservations
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import covariance_of_ends
from trinoc.synth.rigs import table1_rig

PARAMETERS = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
TRUE_RIG = table1_rig()
NAMES = tuple(f"{camera}.{name}" for camera in TRUE_RIG for name in PARAMETERS)
TRUTH = np.array([getattr(TRUE_RIG[camera], name) for camera in TRUE_RIG for name in PARAMETERS])
ANGLE = np.array([name.endswith("_deg") for name in NAMES])
CHI_SQUARE_6_AT_95 = 12.592


def rig_at(values: np.ndarray, covariance: np.ndarray | None = None) -> Rig:
    rows = values.reshape(len(TRUE_RIG), 4).tolist()
    cameras = {
        name: Camera.from_degrees(camera.intrinsics, **dict(zip(PARAMETERS, row, strict=True)))
        for (name, camera), row in zip(TRUE_RIG.items(), rows, strict=True)
    }
    if covariance is None:
        return Rig(cameras)
    return Rig(cameras, parameters=NAMES, covariance=covariance)


def projected(matrices: np.ndarray, ends_mm: np.ndarray) -> np.ndarray:
    """(t, v, 2, 2) images of segments (t, 2, 3)."""
    homogeneous = np.concatenate([ends_mm, np.ones((*ends_mm.shape[:2], 1))], axis=2)
    image = np.einsum("vij,tej->tvei", matrices, homogeneous)
    return image[..., :2] / image[..., 2:]


def made_lines(
    random: np.random.Generator, tracks: int, sigma_px: float, wrong: float, reach_mm: float = 70
) -> tuple[LineObservations, np.ndarray, np.ndarray]:
    """(observations, true ends, which are wrong); a fifth of the tracks is seen in two views."""
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
    seen = np.ones((tracks, 3), dtype=bool)
    hidden = np.flatnonzero((random.random(tracks) < 0.2) & ~bad)
    seen[hidden, random.integers(0, 3, len(hidden))] = False
    return LineObservations(TRUE_RIG.names, fragments, covariance, seen, ends), ends, bad


def started_from(rig: Rig, lines: LineObservations) -> LineObservations:
    """The same fragments, with lines triangulated by a (disturbed) rig."""
    from trinoc.geometry.precision import in_float64
    from trinoc.geometry.triangulation import triangulate_segment

    solve = jax.jit(jax.vmap(triangulate_segment, (None, 0, 0, 0)))
    found = in_float64(solve)(rig.matrices_px, lines.fragments_px, lines.covariance_px2, lines.seen)
    finite = np.isfinite(found.ends_mm).all(axis=(1, 2))
    start = np.where(finite[:, None, None], found.ends_mm, lines.lines_mm)
    return LineObservations(
        lines.views, lines.fragments_px, lines.covariance_px2, lines.seen, start
    )


def knocked_cameras(trials: int) -> None:
    """One camera disturbed, the two others known by their sheet: error before and after."""
    print("\nOne camera knocked; rms error of its angles (deg) and distance (mm) before -> after")
    print(f"{'deg, mm':>12} {'lines':>6} {'wrong':>6}  {'angle':>18}  {'distance':>16}"
          f"  within 3 sigma  wrong found")  # fmt: skip
    sigma = np.where(ANGLE, 0.0015, 0.0045)
    for degrees, millimetres in ((0.05, 0.1), (0.2, 1.0), (0.5, 2.5), (1.0, 5.0)):
        for tracks, wrong in ((100, 0.05), (100, 0.3), (500, 0.15), (2000, 0.3)):
            before, after, within, caught = [], [], [], []
            for seed in range(trials if tracks < 2000 else max(trials // 3, 1)):
                random = np.random.default_rng([seed, tracks])
                camera = int(random.integers(0, 3))
                own = np.arange(4 * camera, 4 * camera + 4)
                values = TRUTH + sigma * random.standard_normal(12)
                size = np.where(ANGLE, degrees, millimetres)[own]
                values[own] += size * random.choice([-1, 1], 4)
                lines, _, bad = made_lines(random, tracks, 0.3, wrong)
                start = rig_at(values, np.diag(sigma**2))
                answer = refine(start, started_from(start, lines), moved=(TRUE_RIG.names[camera],))
                error = (answer.values - TRUTH)[own]
                before.append((values - TRUTH)[own])
                after.append(error)
                within.append(np.abs(error) < 3 * np.sqrt(np.diag(answer.covariance))[own])
                caught.append((answer.inlier != lines.seen).any(axis=1)[bad].mean())
            rms = [np.sqrt(np.mean(np.square(e), axis=0)) for e in (before, after)]
            angle = [np.sqrt(np.mean(r[:3] ** 2)) for r in rms]
            print(f"{degrees:5.2f}, {millimetres:4.1f} {tracks:6d} {wrong:6.0%}  "
                  f"{angle[0]:7.4f} -> {angle[1]:7.5f}  {rms[0][3]:6.3f} -> {rms[1][3]:6.4f}"
                  f"  {np.mean(within):13.1%}  {np.mean(caught):10.1%}")  # fmt: skip


def coverage(trials: int) -> None:
    """Do 95 % ellipsoids hold the true segments, and how near is the error to its bound?"""
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
    """Held-out segments: 3-D error by the sheet alone, and by sheet and segments."""
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
                    found = started_from(rig, held_out).lines_mm
                    errors.append(np.median(np.linalg.norm(found - ends, axis=2)))
            print(f"  sheet {sheet:4.0f} x its bound, {tracks:5d} lines of 0.3 px: median error "
                  f"{1e3 * np.mean(alone):8.2f} -> {1e3 * np.mean(together):8.2f} um")  # fmt: skip


def times() -> None:
    """Warm time and memory beside scipy with the same problem's sparsity."""
    print("\nTime of one refinement (six free numbers per camera, no sheet), and peak memory")
    for tracks in (100, 1000, 10_000):
        random = np.random.default_rng(tracks)
        lines, _, _ = made_lines(random, tracks, 0.3, 0.0)
        values = TRUTH + np.where(ANGLE, 0.05, 0.2) * random.standard_normal(12)
        start = rig_at(values)
        lines = started_from(start, lines)
        laps = []
        for _ in range(4):
            begin = time.perf_counter()
            refine(start, lines, freedom=Freedom.POSE)
            laps.append(time.perf_counter() - begin)
        ours = float(np.median(laps[1:]))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        theirs = scipy_time(start, lines) if tracks <= 1000 else float("nan")
        print(f"  {tracks:6d} tracks: first {laps[0]:6.2f} s, warm {1e3 * ours:8.1f} ms, "
              f"scipy {theirs:7.2f} s ({theirs / ours:6.1f} x), peak {peak:6.0f} MiB")  # fmt: skip


def scipy_time(rig: Rig, lines: LineObservations) -> float:
    """Seconds that scipy takes for the same unknowns and residuals (soft_l1 loss)."""
    from scipy.spatial.transform import Rotation

    tracks, views = lines.seen.shape
    calibration = np.stack([np.asarray(c.intrinsics.matrix) for c in rig.cameras])
    rotation = np.stack([np.asarray(c.pose.rotation) for c in rig.cameras])
    centre = np.stack([c.centre_world_mm for c in rig.cameras])
    axis = np.diff(lines.lines_mm, axis=1)[:, 0]
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis, first) / np.linalg.norm(axis, axis=1, keepdims=True)
    direction = np.diff(lines.fragments_px, axis=2)[:, :, 0]
    normal = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    sigma = np.sqrt(
        np.einsum("tvi,tvij,tvj->tv", normal, lines.covariance_px2[..., :2, :2], normal)
    )

    def residual(x: np.ndarray) -> np.ndarray:
        step, offset = x[: 6 * views].reshape(views, 6), x[6 * views :].reshape(tracks, 2, 2)
        turned = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rotation
        moved = -np.einsum("vij,vj->vi", turned, centre + 470 * step[:, 3:])
        matrices = calibration @ np.concatenate([turned, moved[..., None]], axis=2)
        ends = lines.lines_mm + offset[..., :1] * first[:, None] + offset[..., 1:] * second[:, None]
        image = projected(matrices, ends)
        along = np.diff(image, axis=2)
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        distance = np.einsum("tvei,tvei->tve", np.broadcast_to(across, image.shape),
                             lines.fragments_px - image[:, :, :1])  # fmt: skip
        return np.where(lines.seen[..., None], distance / sigma[..., None], 0.0).reshape(-1)

    pattern = lil_matrix((tracks * views * 2, 6 * views + 4 * tracks), dtype=np.int8)
    for track in range(tracks):
        for view in range(views):
            row = slice(2 * (track * views + view), 2 * (track * views + view) + 2)
            pattern[row, 6 * view : 6 * view + 6] = 1
            pattern[row, 6 * views + 4 * track : 6 * views + 4 * track + 4] = 1
    begin = time.perf_counter()
    least_squares(
        residual, np.zeros(pattern.shape[1]), jac_sparsity=pattern, x_scale="jac", loss="soft_l1"
    )
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=20)
    trials = parser.parse_args().trials
    times()
    coverage(trials)
    sheet_and_segments(trials)
    knocked_cameras(trials)


if __name__ == "__main__":
    main()
