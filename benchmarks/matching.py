"""Matching: precision and recall beside other matchers, calibration, what each step adds, time.

    TRINOC_DATA=DIR python benchmarks/matching.py [--seeds N] [--rendered FOLDER] [--no-files]
        [--no-times]

DIR holds scenes/NAME.npz with NAME.gt.npz and vgg_merton1, vgg_merton2, vgg_corridor (VGG, Oxford).
FOLDER holds scenes of blocks that benchmarks/render_pictures.py rendered, a folder each. Fresh
scenes are drawn by simulation from seeds that nothing was tuned on. Figures of Line3D++ and
LIMAP are of the same files, measured apart, at their best settings. A pair or a triple is right
when its segments come from one edge and their true extents overlap.
"""

import argparse
import os
import resource
import time
from collections.abc import Callable, Iterator
from itertools import combinations, pairwise
from pathlib import Path

import cv2
import numpy as np
from match_scores import MatchScore, score_groups, score_matches
from matching_rendered import table_of_rendered
from shared_scenes import VIEWS, load_scene

from simulation import Detector, block_scene, loose_segments, simulate_segments
from simulation.scenes import see_through_boxes
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.match import match_many
from trinoc.match.candidates.triples import trinocular_candidates
from trinoc.match.matcher import match_segments
from trinoc.match.observations.clutter import fit_clutter
from trinoc.match.observations.match_input import MatchInput, prepare
from trinoc.match.selection.marginals import Selection, select
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.precision import in_float64
from trinoc.segments import with_side_levels
from trinoc.synth import table1_rig
from trinoc.synth.truth import SegmentTruth

Problem = tuple[str, Rig, dict[str, Segments], SegmentTruth]

# Precision/recall of triples, then of pairs: Line3D++ and LIMAP on the original files, each run
# once, apart, at its best settings. Neither can be installed with pip alone, so they are quoted.
ELSEWHERE = {
    "table_clean": (".93/.88 .95/.83", ".95/.83 .96/.80"),
    "table_0": (".83/.57 .89/.58", ".83/.49 .87/.49"),
    "random100_0": (".90/.43 .97/.46", ".96/.51 .98/.52"),
    "boxes120_0": (".41/.42 .66/.44", ".85/.40 .89/.40"),
    "random500_0": (".87/.31 .91/.32", ".86/.33 .88/.32"),
    "boxes504_0": (".27/.31 .60/.33", ".49/.27 .64/.29"),
    "boxes504_ej5": (".33/.25 .60/.28", ".58/.28 .70/.30"),
    "random500_x4": ("1.0/.35 1.0/.37", ".99/.53 .99/.54"),
    "random2000_x4": (".99/.23 .99/.25", ".89/.32 .90/.34"),
}
FILES = (*ELSEWHERE, "table_1", "random500_ej5", "boxes504_x4")
FRESH_SEED = 120_000
BINS = np.array([0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0])


def fresh_problems(kind: str, count: int) -> Iterator[Problem]:
    """Scenes of seeds from FRESH_SEED on, which only this table uses."""
    for seed in range(FRESH_SEED, FRESH_SEED + count):
        rig = table1_rig(resolution=4 if kind.endswith("x4") else 1)
        if kind.startswith("table"):
            scene = block_scene(seed, count=8)
        elif kind.startswith("boxes"):
            scene = see_through_boxes(seed, count=42)
        else:
            scene = loose_segments(seed, count=500)
        detector = Detector(
            cut_back_px=5.0 if "ej5" in kind else 0.0,
            shortest_px=3.0 if "ej5" in kind else 8.0 * (4 if kind.endswith("x4") else 1),
        )
        segments, truth = simulate_segments(scene, rig, detector, seed=seed)
        yield f"{kind} {seed}", rig, segments, truth


def figures(score: MatchScore) -> str:
    return " ".join(f"{g.precision:.3f}/{g.recall:.3f}" for g in (score.triples, score.pairs))


def table_of_files(folder: Path) -> None:
    print("\n## Files: precision/recall of triples, then of pairs")
    print(f"{'scene':15s} {'trinoc':24s} {'Line3D++':18s} {'LIMAP':18s}")
    for name in FILES:
        rig, segments, truth = load_scene(folder, name)
        score = score_matches(match_segments(segments, rig), truth)
        line, limap = ELSEWHERE.get(name, ("", ""))
        print(f"{name:15s} {figures(score):24s} {line:18s} {limap:18s}", flush=True)


def merton(folder: Path) -> None:
    print("\n## Photographs: share of the published matches found, triples put out")
    for name, elsewhere in (
        ("merton1", "Line3D++ .38 (545), LIMAP .43 (268)"),
        ("merton2", "Line3D++ .39 (538), LIMAP .32 (262)"),
    ):
        file = folder / f"vgg_{name}" / f"{name}.npz"
        if not file.exists():
            print(f"{name} is left out: TRINOC_DATA has no {file.parent.name}/{file.name}")
            continue
        data = np.load(file)
        matrices = {
            str(view): matrix for view, matrix in zip(VIEWS, data["projection"], strict=True)
        }
        rig = Rig.from_matrices(matrices, (1024, 768))
        plain = {view: data[f"segments_{k}"] for k, view in enumerate(VIEWS)}
        inputs = [("as they are", plain), ("with their sides", _sided(plain))]
        pictures = [folder / f"vgg_{name}" / f"view{k}.jpg" for k in range(len(VIEWS))]
        if all(picture.exists() for picture in pictures):
            inputs.append(("with side levels", _with_levels(plain, pictures)))
        for label, segments in inputs:
            matches = match_segments(segments, rig)
            triples = matches.index[(matches.index >= 0).all(axis=1)]
            triple_set = {tuple(row) for row in triples.tolist()}
            share = np.mean([tuple(row) in triple_set for row in data["line_matches"].tolist()])
            share_near = np.mean(_reprojection_px(matches, rig) < 1.5)
            print(
                f"{name} {label:17s} {share:.3f} ({len(triples)}), under 1.5 px {share_near:.3f}; "
                f"published, of p {_published(matches, data['line_matches'])}; {elsewhere}",
                flush=True,
            )


def corridor(folder: Path) -> None:
    """Print the share of each published match, in eleven views, that one track contains."""
    data = np.load(folder / "vgg_corridor" / "corridor.npz")
    names = [str(view) for view in range(len(data["projection"]))]
    rig = Rig.from_matrices(dict(zip(names, data["projection"], strict=True)), (512, 512))
    matches = match_segments({view: data[f"segments_{view}"] for view in names}, rig)
    rows = data["line_matches"]
    members = ((matches.index[:, None] == rows) & (rows >= 0)).sum(axis=2).max(axis=0)
    share = members / (rows >= 0).sum(axis=1)
    quantiles_px = np.quantile(_reprojection_px(matches, rig), [0.5, 0.95, 1.0])
    print(
        f"corridor, 11 views: whole rows {np.mean(share == 1):.3f}, of a row {share.mean():.3f}; "
        f"{len(matches)} tracks; reprojection, median, 95 %, most: {quantiles_px.round(2)} px"
    )


def _published(matches: Matches, published: np.ndarray) -> str:
    """Share of published matches among triples with a segment of one, by posterior."""
    three = (matches.index >= 0).all(axis=1)
    rows, p = matches.index[three], matches.posterior[three]
    shares_segment = np.stack(
        [np.isin(rows[:, v], published[:, v]) for v in range(len(VIEWS))]
    ).any(axis=0)
    right = (rows[:, None] == published).all(axis=2).any(axis=1)
    cells = []
    for low, high in ((0.7, 0.9), (0.9, 0.97), (0.97, 0.99), (0.99, 1.01)):
        inside = shares_segment & (p >= low) & (p < high)
        share = right[inside].mean() if inside.any() else np.nan
        cells.append(f"{low} to {min(high, 1.0)}: {share:.2f} ({inside.sum()})")
    return ", ".join(cells)


def _sided(plain: dict[str, np.ndarray]) -> dict[str, Segments]:
    """Segments whose darker side is on one hand, as the order of their ends defines."""
    sided = {}
    for view, ends in plain.items():
        view_segments = Segments.from_endpoints(ends)
        fields = (
            view_segments.endpoints_px,
            view_segments.covariance_px2,
            np.ones(len(ends), dtype=np.int64),
        )
        sided[view] = Segments(*fields, view_segments.contrast, view_segments.support, None)
    return sided


def _with_levels(plain: dict[str, np.ndarray], pictures: list[Path]) -> dict[str, Segments]:
    """Segments with the grey levels on their sides, measured in their pictures."""
    levels = {}
    for (view, ends), picture in zip(plain.items(), pictures, strict=True):
        image = np.asarray(cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE))
        levels[view] = with_side_levels(Segments.from_endpoints(ends), image)
    return levels


def _reprojection_px(matches: Matches, rig: Rig) -> np.ndarray:
    """Per track in three views or more, the largest distance of the 3-D line's image from a
    fragment's ends."""
    rows = np.flatnonzero((matches.index >= 0).sum(axis=1) > 2)
    worst = np.zeros(len(rows))
    for view, name in enumerate(matches.views):
        image = matches.lines_mm[rows] @ rig[name].matrix_px[:, :3].T + rig[name].matrix_px[:, 3]
        line = np.cross(image[:, 0], image[:, 1])
        line /= np.linalg.norm(line[:, :2], axis=1, keepdims=True)
        ends = matches.fragments_px[rows, view]
        off = np.abs((ends * line[:, None, :2]).sum(-1) + line[:, None, 2]).max(axis=1)
        worst = np.fmax(worst, off)
    return worst


def is_right(members: list[tuple[int, int]], truth: SegmentTruth) -> bool | None:
    """True if segments (view, number) are of one edge and overlap; None if not scored."""
    edges = {int(truth.edge_of[VIEWS[view]][segment]) for view, segment in members}
    if edges == {-2}:
        return None
    extents = np.array([truth.extent[VIEWS[view]][segment] for view, segment in members])
    return len(edges) == 1 and min(edges) >= 0 and extents[:, 0].max() < extents[:, 1].min()


@in_float64
def steps(problem: Problem) -> dict[str, MatchScore]:
    """Scores after candidates and exclusion, after neighbours, and after pairs."""
    _, rig, segments, truth = problem
    inputs = prepare(segments, rig, None)
    strangers = fit_clutter(inputs.lines, inputs.counts)
    candidates = trinocular_candidates(inputs.lines, (0, 1, 2), inputs.counts, strangers)
    scores = {}
    for label, neighbours in (("1", False), ("1+2", True)):
        selection = select(candidates, float(np.mean(inputs.counts)), neighbours=neighbours)
        scores[label] = score_groups(inputs.names, _groups(inputs, selection), truth)
    scores["1+2+3"] = score_matches(match_segments(segments, rig), truth)
    return scores


def _groups(inputs: MatchInput, selection: Selection) -> list[tuple[tuple[int, int], ...]]:
    rows = selection.candidates.index[selection.is_accepted]
    return [tuple((v, int(inputs.order[v][s])) for v, s in enumerate(row)) for row in rows]


def table_of_fresh(seeds: int) -> None:
    kinds = ("table", "boxes", "boxes ej5", "boxes x4", "random", "random ej5", "random x4")
    print(f"\n## Fresh scenes, {seeds} of each: what the steps add; step 3 alone; calibration")
    reliability = []
    for kind in kinds:
        scores: dict[str, list[MatchScore]] = {}
        alone, epipolar, outcomes = [], [], []
        for problem in fresh_problems(kind, seeds):
            for label, score in steps(problem).items():
                scores.setdefault(label, []).append(score)
            _, rig, segments, truth = problem
            matches = match_segments(segments, rig)
            alone.append(_step_three(matches, truth))
            epipolar.append(_near_epipolar(matches, rig, segments, truth))
            outcomes += _outcomes(matches, truth)
        reliability += outcomes
        for label, values in scores.items():
            means = np.mean([[v.triples[:2], v.pairs[:2]] for v in values], axis=0)
            text = " ".join(f"{p:.3f}/{r:.3f}" for p, r in means)
            print(f"{kind:11s} {label:6s} triples, pairs {text}", flush=True)
        right, out, correct, true = np.sum(alone, axis=0)
        joined, flat = np.sum(epipolar, axis=0)
        print(
            f"{kind:11s} step 3 alone {right / max(out, 1):.3f}/{correct / max(true, 1):.3f} "
            f"({out} out, {true} true); near epipolar {joined / max(flat, 1):.3f} of {flat}; "
            f"calibration error {_calibration_error(outcomes):.3f}"
        )
    print("\nposterior   put out  stated  right")
    p, right = np.array(reliability).T
    for low, high in pairwise(BINS):
        inside = (p >= low) & ((p < high) | (high == 1.0))
        if inside.any():
            mean_posterior, share = p[inside].mean(), right[inside].mean()
            print(f"{low:.2f}-{high:.2f}  {inside.sum():8d}   {mean_posterior:.3f}  {share:.3f}")
    print(f"expected calibration error {_calibration_error(reliability):.3f}")


def _outcomes(matches: Matches, truth: SegmentTruth) -> list[tuple[float, bool]]:
    outcomes = []
    for row, posterior in zip(matches.index, matches.posterior, strict=True):
        right = is_right([(v, int(s)) for v, s in enumerate(row) if s >= 0], truth)
        if right is not None:
            outcomes.append((float(posterior), right))
    return outcomes


def _calibration_error(outcomes: list[tuple[float, bool]]) -> float:
    p, right = np.array(outcomes, dtype=float).T
    bin_number = np.clip(np.digitize(p, np.linspace(0, 1, 11)) - 1, 0, 9)
    gaps = [
        abs((p - right)[bin_number == bin_].sum())
        for bin_ in range(10)
        if (bin_number == bin_).any()
    ]
    return float(np.sum(gaps) / len(p))


def _step_three(matches: Matches, truth: SegmentTruth) -> tuple[int, int, int, int]:
    """(right, put out, found, true) of pairs whose edge has no segment in the third view."""
    out = []
    for row in matches.index[(matches.index >= 0).sum(axis=1) == 2]:
        out.append(tuple((int(v), int(row[v])) for v in np.flatnonzero(row >= 0)))
    verdicts = [is_right(list(pair), truth) for pair in out]
    true = set()
    for a, b in combinations(range(3), 2):
        third = set(truth.edge_of[VIEWS[3 - a - b]].tolist())
        edges = truth.edge_of[VIEWS[a]]
        for i in np.flatnonzero((edges >= 0) & ~np.isin(edges, list(third))):
            for j in np.flatnonzero(truth.edge_of[VIEWS[b]] == edges[i]):
                extents = np.array([truth.extent[VIEWS[a]][i], truth.extent[VIEWS[b]][j]])
                common = extents[:, 1].min() - extents[:, 0].max()
                if common >= 0.2 * (extents[:, 1] - extents[:, 0]).min():
                    true.add(((a, int(i)), (b, int(j))))
    scored = [right for right in verdicts if right is not None]
    return sum(scored), len(scored), len(true & set(out)), len(true)


def _near_epipolar(
    matches: Matches, rig: Rig, segments: dict[str, Segments], truth: SegmentTruth
) -> tuple[int, int]:
    """(found, true) pairs within 5 degrees of an epipolar line whose edge three views see."""
    joined_pairs, true_pairs = 0, 0
    joined = {
        ((a, int(row[a])), (b, int(row[b])))
        for row in matches.index[:, [matches.views.index(v) for v in VIEWS]]
        for a, b in combinations(range(3), 2)
    }
    for a, b in combinations(range(3), 2):
        image = rig[VIEWS[a]].matrix_px @ np.append(rig[VIEWS[b]].centre_world_mm, 1.0)
        epipole = image[:2] / image[2]
        ends = np.asarray(segments[VIEWS[a]].endpoints_px)
        step, toward = ends[:, 1] - ends[:, 0], epipole - ends.mean(axis=1)
        across = step[:, 0] * toward[:, 1] - step[:, 1] * toward[:, 0]
        sine = np.abs(across) / np.linalg.norm(step, axis=1)
        flat = sine / np.linalg.norm(toward, axis=1) < np.sin(np.radians(5))
        edges, third = truth.edge_of[VIEWS[a]], set(truth.edge_of[VIEWS[3 - a - b]].tolist())
        for i in np.flatnonzero(flat & (edges >= 0) & np.isin(edges, list(third))):
            for j in np.flatnonzero(truth.edge_of[VIEWS[b]] == edges[i]):
                extents = np.array([truth.extent[VIEWS[a]][i], truth.extent[VIEWS[b]][j]])
                if np.ptp(extents[:, :1]) >= 0 and (
                    extents[:, 1].min() - extents[:, 0].max()
                    >= 0.2 * (extents[:, 1] - extents[:, 0]).min()
                ):
                    true_pairs += 1
                    joined_pairs += ((a, int(i)), (b, int(j))) in joined
    return joined_pairs, true_pairs


def batch() -> None:
    print("\n## A batch: 1,000 frames of about 100 segments per view")
    rig = table1_rig(resolution=4)
    frames = []
    for seed in range(FRESH_SEED, FRESH_SEED + 1000):
        scene = loose_segments(seed, count=75)
        frames.append(simulate_segments(scene, rig, Detector(shortest_px=32.0), seed=seed)[0])
    match_segments(frames[0], rig)
    start = time.perf_counter()
    result = match_many(frames, rig)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{len(result)} frames in {seconds:.1f} s, {(result.status == 'ok').sum()} ok, "
        f"peak memory so far {peak:.0f} MiB"
    )


def times() -> None:
    print("\n## Time: loose segments at four times the resolution; warm: median of 5, last of 1")
    for count in (75, 500, 2000, 7000):
        rig = table1_rig(resolution=4)
        scene = loose_segments(FRESH_SEED + 500, count=count)
        segments, _ = simulate_segments(scene, rig, Detector(shortest_px=32.0), seed=FRESH_SEED)
        first = _seconds(lambda: match_segments(segments, rig))  # noqa: B023
        repeats = range(5 if count <= 2000 else 1)
        warm = float(np.median([_seconds(lambda: match_segments(segments, rig)) for _ in repeats]))  # noqa: B023
        line = f"{len(segments['upper']):6d} per view: first {first:.2f} s, warm {warm:.3f} s"
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{line}, peak memory so far {peak:.0f} MiB", flush=True)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--rendered", type=Path)
    parser.add_argument("--no-files", action="store_true")
    parser.add_argument("--no-times", action="store_true")
    options = parser.parse_args()
    if "TRINOC_DATA" in os.environ and not options.no_files:
        folder = Path(os.environ["TRINOC_DATA"])
        table_of_files(folder / "scenes")
        merton(folder)
        corridor(folder)
    if options.seeds:
        table_of_fresh(options.seeds)
    table_of_rendered(options.rendered, _calibration_error)
    if not options.no_times:
        times()
        batch()


if __name__ == "__main__":
    main()
