"""Test of the matcher's reports: ellipsoids, noise, posteriors, positions, many views.

    python benchmarks/matching_truth.py [--seeds N] [--first SEED] [--only angle noise ...]

Scenes are drawn by simulation from seeds that nothing was tuned on. A match is right when its
segments come from one edge; its error is that of its two ends across the edge, four numbers,
compared with 95 % of chi-square under the covariance it claims.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from match_scores import score_matches
from scipy.stats import chi2

from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import Scene, see_through_boxes
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.synth import table1_lens, table1_rig
from trinoc.synth.truth import SegmentTruth

SEED = 950_000
ANGLES = (0, 2, 5, 10, 20, 45, 90.1)
# Outcomes drawn from the stated posteriors.
DRAWS = 200
Found = tuple[Matches, SegmentTruth]


def scenes(seeds: range, loose: int = 150, boxes: int = 12) -> Iterator[tuple[str, int, Scene]]:
    for seed in seeds:
        yield "loose", seed, loose_segments(seed, count=loose)
        yield "boxes", seed, see_through_boxes(seed, count=boxes)
        yield "table", seed, block_scene(seed, count=8)


def collinear_rig(lens: Intrinsics | None = None) -> Rig:
    """Three cameras in one line, at the height of those of Table 1, that look at the origin."""
    lens, cameras = lens or table1_lens(), {}
    for name, x in (("upper", 0.0), ("left", -190.0), ("right", 190.0)):
        centre = np.array([x, -370.0, 300.0])
        distance = np.linalg.norm(centre)
        cameras[name] = Camera.from_degrees(
            lens,
            pan_deg=float(np.degrees(np.arctan2(centre[0], -centre[1]))),
            tilt_deg=float(np.degrees(np.arcsin(centre[2] / distance))),
            swing_deg=0.0,
            distance_mm=float(distance),
        )
    return Rig(cameras)


def ring(count: int) -> Rig:
    """Cameras on an arc about the scene, alternately higher and lower."""
    reach = min(20.0 * (count - 1) / 2, 160.0)
    return Rig(
        {
            f"c{k}": Camera.from_degrees(
                table1_lens(),
                pan_deg=float(pan),
                tilt_deg=38.0 + 15.0 * (k % 2),
                swing_deg=0.0,
                distance_mm=475.0,
            )
            for k, pan in enumerate(np.linspace(-reach, reach, count))
        }
    )


def edges_of(matches: Matches, truth: SegmentTruth, track: int) -> set[int]:
    row = matches.index[track]
    return {int(truth.edge_of[matches.views[v]][row[v]]) for v in np.flatnonzero(row >= 0)}


def squares(matches: Matches, truth: SegmentTruth) -> np.ndarray:
    """(t,) Mahalanobis distance of each right line from its edge; NaN where it is not right."""
    distances = np.full(len(matches), np.nan)
    for track in range(len(matches)):
        edges = edges_of(matches, truth, track)
        if len(edges) > 1 or min(edges) < 0:
            continue
        distances[track] = square_of(matches, track, truth.edges_mm[min(edges)])
    return distances


def square_of(matches: Matches, track: int, edge: np.ndarray) -> float:
    """Mahalanobis distance of a line's ends from an edge, across it: of 4 degrees of freedom."""
    along = (edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0])
    across = np.linalg.svd(along[None])[2][1:]
    error = ((matches.lines_mm[track] - edge[0]) @ across.T).ravel()
    both = np.kron(np.eye(2), across)
    covariance = both @ matches.covariance_mm2[track] @ both.T
    return float(error @ np.linalg.solve(covariance, error))


def angles_deg(matches: Matches, rig: Rig) -> np.ndarray:
    """(t,) for pairs, the smaller angle of its fragments to the epipolar lines; NaN for others."""
    angles = np.full(len(matches), np.nan)
    for track, row in enumerate(matches.index):
        views = np.flatnonzero(row >= 0)
        if len(views) == 2:
            names = [matches.views[v] for v in views]
            ends = [matches.fragments_px[track, v] for v in views]
            angles[track] = min(
                _angle(rig, names[0], names[1], ends[0]), _angle(rig, names[1], names[0], ends[1])
            )
    return angles


def _angle(rig: Rig, view: str, other: str, ends: np.ndarray) -> float:
    epipole = rig[view].matrix_px @ np.append(rig[other].centre_world_mm, 1.0)
    step, toward = ends[1] - ends[0], epipole[:2] - epipole[2] * ends.mean(axis=0)
    sine = (step[0] * toward[1] - step[1] * toward[0]) / np.linalg.norm(step)
    return float(np.degrees(np.arcsin(abs(sine) / np.linalg.norm(toward))))


def held(square: np.ndarray) -> str:
    valid = square[np.isfinite(square)]
    if len(valid) == 0:
        return "   -      "
    return f"{np.mean(valid < chi2.ppf(0.95, 4)):.3f} ({len(valid):4d})"


def by_angle(seeds: range) -> None:
    print("\n## Pairs by their angle to the epipolar line: 95 % ellipsoids hold (right pairs)")
    print(f"{'rig':24s}" + " ".join(f"{a:>4g}-{b:<6.0f}" for a, b in pairwise(ANGLES)))
    cases = (
        ("three views", table1_rig(), ("upper", "left", "right")),
        ("upper, left", table1_rig(), ("upper", "left")),
        ("left, right", table1_rig(), ("left", "right")),
        ("collinear, two", collinear_rig(), ("upper", "left")),
        ("collinear, three", collinear_rig(), ("upper", "left", "right")),
    )
    for label, rig, views in cases:
        square, angle, triples, refused = [], [], [], 0
        for _, seed, scene in scenes(seeds):
            segments, truth = simulate_segments(scene, rig, Detector(), seed=seed)
            matches = match_segments({view: segments[view] for view in views}, rig)
            distances = squares(matches, truth)
            pair = (matches.index >= 0).sum(axis=1) == 2
            square.append(distances[pair])
            angle.append(angles_deg(matches, rig)[pair])
            triples.append(distances[~pair])
            refused += matches.counts.get("tracks along the epipolar lines", 0)
        bin_number = np.digitize(np.concatenate(angle), ANGLES) - 1
        cells = [held(np.concatenate(square)[bin_number == k]) for k in range(len(ANGLES) - 1)]
        print(
            f"{label:24s}{' '.join(cells)}; triples {held(np.concatenate(triples))}; "
            f"refused {refused}",
            flush=True,
        )


def by_noise(seeds: range) -> None:
    print("\n## Noise given wrongly: what is learned, what holds, precision/recall of pairs")
    for true, stated_sigma_px in ((0.5, 0.5), (1.0, 0.5), (0.1, 0.5), (0.5, 0.05), (0.5, 5.0)):
        triples, pairs, scores, scales, posteriors = [], [], [], [], []
        for kind, seed, scene in scenes(seeds):
            if kind == "table":
                continue
            rig, detector = table1_rig(), Detector(end_sigma_px=true)
            segments, truth = simulate_segments(scene, rig, detector, seed=seed)
            matches = match_segments(_plain(segments), rig, sigma_px=stated_sigma_px)
            distances, is_pair = squares(matches, truth), (matches.index >= 0).sum(axis=1) == 2
            triples.append(distances[~is_pair])
            pairs.append(distances[is_pair])
            score = score_matches(matches, truth)
            scores.append((score.pairs.precision, score.pairs.recall))
            scales.append(getattr(matches, "noise_scale", 1.0))
            posteriors.append(matches.posterior)
        print(
            f"{true:4g} px given as {stated_sigma_px:<5g} scale {np.mean(scales):6.3f}; "
            f"triples {held(np.concatenate(triples))}, pairs {held(np.concatenate(pairs))}; "
            "{:.3f}/{:.3f}".format(*np.mean(scores, axis=0))
            + f", mean posterior {np.concatenate(posteriors).mean():.3f}",
            flush=True,
        )


def _plain(segments: dict[str, Segments]) -> dict[str, np.ndarray]:
    return {
        v: np.asarray(view_segments.endpoints_px).reshape(-1, 4)
        for v, view_segments in segments.items()
    }


def posteriors(seeds: range) -> None:
    print("\n## Posteriors: stated, right, expected calibration error, of a perfect one (matches)")
    views = {
        "two: upper, left": ("upper", "left"),
        "two: left, right": ("left", "right"),
        "three": ("upper", "left", "right"),
    }
    for label, names in views.items():
        every: list[tuple[float, bool]] = []
        for kind in ("loose", "boxes", "table"):
            outcomes: list[tuple[float, bool]] = []
            for drawn, seed, scene in scenes(seeds, loose=500, boxes=42):
                if drawn == kind:
                    segments, truth = simulate_segments(scene, table1_rig(), Detector(), seed=seed)
                    matches = match_segments({v: segments[v] for v in names}, table1_rig())
                    outcomes += _outcomes(matches, truth)
            every += outcomes
            print(f"{label:18s} {kind:6s} {_reliability(outcomes)}", flush=True)
        print(f"{label:18s} {'all':6s} {_reliability(every)}")


def _outcomes(matches: Matches, truth: SegmentTruth) -> list[tuple[float, bool]]:
    outcomes = []
    for track, posterior in enumerate(matches.posterior.tolist()):
        edges = edges_of(matches, truth, track)
        if edges != {-2}:
            outcomes.append((posterior, len(edges) == 1 and min(edges) >= 0))
    return outcomes


def _calibration_error(p: np.ndarray, right: np.ndarray) -> float:
    """The expected calibration error over ten bins."""
    bin_number = np.clip((10 * p).astype(int), 0, 9)
    return float(np.abs(np.bincount(bin_number, p - right, 10)).sum() / len(p))


def _of_a_perfect_one(p: np.ndarray) -> float:
    """Mean calibration error of true posteriors for this number of matches; not zero."""
    generator = np.random.default_rng(0)
    drawn = (generator.random(len(p)) < p for _ in range(DRAWS))
    return float(np.mean([_calibration_error(p, right) for right in drawn]))


def _reliability(outcomes: list[tuple[float, bool]]) -> str:
    p, right = np.array(outcomes, dtype=float).T
    sure = p > 0.95
    return (
        f"{p.mean():.3f} {right.mean():.3f} {_calibration_error(p, right):.3f} "
        f"{_of_a_perfect_one(p):.3f} ({len(p)}); "
        f"p > .95: {right[sure].mean() if sure.any() else np.nan:.3f} ({sure.sum()})"
    )


def behind(seeds: range) -> None:
    print("\n## Places: lines behind a camera that sees them; mirrored rigs")
    out, wrong = 0, 0
    for _, seed, scene in scenes(seeds):
        for rig in (table1_rig(), collinear_rig(), ring(8)):
            segments, _ = simulate_segments(scene, rig, Detector(), seed=seed)
            matches = match_segments(segments, rig)
            matrices = np.stack([rig[view].matrix_px for view in matches.views])
            depth = np.einsum("vi,tei->tve", matrices[:, 2, :3], matches.lines_mm)
            depth = depth + matrices[:, 2, 3:]
            wrong += int(((depth <= 0).any(axis=2) & (matches.index >= 0)).any(axis=1).sum())
            out += len(matches)
    print(f"{wrong} of {out} lines are behind a camera")
    _, seed, scene = next(scenes(seeds[:1]))
    rig = table1_rig()
    segments, _ = simulate_segments(scene, rig, Detector(), seed=seed)
    flip, width = np.diag([1.0, 1.0, -1.0, 1.0]), rig["left"].image_size_px[0] - 1
    turn = np.array([[-1.0, 0, width], [0, 1, 0], [0, 0, 1]])
    for label, matrices, inputs in (
        ("a left-handed world", {n: c.matrix_px @ flip for n, c in rig.items()}, segments),
        (
            "one mirrored picture",
            {n: (turn if n == "left" else np.eye(3)) @ c.matrix_px for n, c in rig.items()},
            segments,
        ),
        (
            "all pictures mirrored",
            {n: turn @ c.matrix_px for n, c in rig.items()},
            {n: _turned(s, width) for n, s in segments.items()},
        ),
    ):
        try:
            matches = match_segments(inputs, Rig.from_matrices(matrices, (512, 480)))
            print(f"{label}: {len(matches)} tracks")
        except InputError as error:
            print(f"{label}: {error}")


def _turned(segments: Segments, width: int) -> np.ndarray:
    ends = np.asarray(segments.endpoints_px).copy()
    ends[..., 0] = width - ends[..., 0]
    return ends


def many_views(seeds: range) -> None:
    print("\n## Many views: pairs found, tracks, the worst misfit")
    for count in (3, 4, 5, 6, 8):
        rig, scores, worst, views, beyond, began = ring(count), [], (0.0, 1, 0.0), [], 0, 0.0
        for _, seed, scene in scenes(seeds, loose=100, boxes=10):
            segments, truth = simulate_segments(scene, rig, Detector(), seed=seed)
            start = time.perf_counter()
            matches = match_segments(segments, rig)
            began += time.perf_counter() - start
            score = score_matches(matches, truth)
            scores.append((score.pairs.precision, score.pairs.recall))
            view_count = (matches.index >= 0).sum(axis=1)
            views += view_count.tolist()
            assert matches.misfit is not None
            for track in np.flatnonzero(view_count > 2):
                misfit, degrees = float(matches.misfit[track]), int(2 * (view_count[track] - 2))
                beyond += chi2.sf(misfit, degrees) < 1e-6
                if misfit / degrees > worst[0] / worst[1]:
                    worst = misfit, degrees, float(matches.posterior[track])
        print(
            f"{count} views: pairs "
            + "{:.3f}/{:.3f}".format(*np.mean(scores, axis=0))
            + f", {len(views)} tracks of {np.mean(views):.2f} views; beyond one in a million: "
            f"{beyond}, worst {worst[0]:.0f} on {worst[1]}, p {worst[2]:.3f}; {began:.1f} s",
            flush=True,
        )


PARTS = {
    "angle": by_angle,
    "noise": by_noise,
    "posterior": posteriors,
    "behind": behind,
    "views": many_views,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=SEED)
    parser.add_argument("--only", nargs="*", default=list(PARTS), choices=PARTS)
    options = parser.parse_args()
    for part in options.only:
        PARTS[part](range(options.first, options.first + options.seeds))


if __name__ == "__main__":
    main()
