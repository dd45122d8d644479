"""Matches of rendered pictures and of photographs, as they are, after guided detection, with rims.

    python benchmarks/guided.py FOLDER... [--merton DIR] [--questions]

FOLDER holds scenes of `benchmarks/render_pictures.py blocks`. Of each: precision of length at 1 mm
(in brackets, lines along shadows neither way), recall of length (edges of 8 grey levels, rims of
cylinders included; of straight edges alone; of those that three views show, and two), tracks in
three views, processor time. Over all: expected calibration error of posteriors, and the error
across of segments that were added, in claimed standard deviations. The third row has the rims of
round bodies besides (`find_rims` among chords of arcs, `add_rims`), and not the tracks that these
mark as outlines.
"""

import argparse
import time
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from matching import _calibration_error as calibration_error
from matching_rendered import GREY_STEP, TOLERANCE_MM, Place, _place, _samples

import trinoc
import trinoc.synth
from trinoc.evaluation.distances import distance_to_segments_mm, sampled_segments
from trinoc.evaluation.scoring import score_lengths
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io.rig_json import load_rig
from trinoc.match.pixels import guide
from trinoc.match.pixels.guide import GuidedMatches
from trinoc.match.tracks.matches import Matches
from trinoc.synth import table1_rig
from trinoc.synth.truth import SceneTruth, shown_parts_mm

Outcome = tuple[float, bool, bool]


def by_views(truth: SceneTruth, lines_mm: np.ndarray) -> np.ndarray:
    """Length found and length to find of straight edges: in three views or more, in just two."""
    two, three = (
        shown_parts_mm(truth, views=k, grey_step=GREY_STEP, kinds=("edge",)) for k in (2, 3)
    )
    points, weight = sampled_segments(two, 0.5)
    in_three = distance_to_segments_mm(points, three) < 1e-6
    near = distance_to_segments_mm(points, lines_mm) < TOLERANCE_MM
    parts = (near & in_three, in_three, near & ~in_three, ~in_three)
    return np.array([weight[part].sum() for part in parts])


def figures(place: Place, matches: Matches) -> tuple[np.ndarray, np.ndarray, list[Outcome]]:
    """(precision, the same without shadows, recall; recall by views; outcomes)."""
    samples = _samples(place, matches)
    count = np.bincount(samples.owner, minlength=len(matches))
    right, shadow = (
        np.bincount(samples.owner, is_so, minlength=len(count)) / count > 0.5
        for is_so in (samples.right, samples.right | samples.shadow)
    )
    length, good = samples.length_mm, samples.length_mm[samples.right].sum()
    recall = score_lengths(
        matches.lines_mm, place.truth, tolerance_mm=TOLERANCE_MM, grey_step=GREY_STEP
    ).recall
    found = np.array([good / length.sum(), good / length[~samples.shadow].sum(), recall])
    outcomes = list(zip(matches.posterior.tolist(), right, shadow, strict=True))
    return found, by_views(place.truth, matches.lines_mm), outcomes


def normalised_errors(
    place: Place, segments: dict[str, Segments], added: dict[str, np.ndarray]
) -> list[float]:
    """Distance across of both ends of added segments from the true edge that they show, over the
    claimed standard deviation; of those nearer than 2 px and in line with one."""
    found: list[float] = []
    for name, rows in added.items():
        matrix, seen = place.rig[name].matrix_px, place.truth.seen[name]
        edges = place.truth.edges_mm[np.unique(seen.edge)]
        image = edges @ matrix[:, :3].T + matrix[:, 3]
        image = image[..., :2] / image[..., 2:]
        way = image[:, 1] - image[:, 0]
        unit = way / np.linalg.norm(way, axis=1)[:, None]
        normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
        for row in rows.tolist():
            ends = np.asarray(segments[name].endpoints_px)[row]
            across = np.einsum("nei,ni->ne", ends[None] - image[:, :1], normal)
            along = np.einsum("nei,ni->ne", ends[None] - image[:, :1], unit).mean(axis=1)
            beside = (along > 0) & (along < np.linalg.norm(way, axis=1))
            worst = np.where(beside, np.abs(across).max(axis=1), np.inf)
            best = int(worst.argmin())
            if worst[best] < 2.0:
                blocks = np.asarray(segments[name].covariance_px2)[row].reshape(2, 2, 2, 2)
                variance = np.einsum("eiej,i,j->e", blocks, normal[best], normal[best])
                found += (across[best] / np.sqrt(variance)).tolist()
    return found


def added_rows(given: dict[str, Segments], after: dict[str, Segments]) -> dict[str, np.ndarray]:
    """The segments of each view that were not given."""
    return {name: np.arange(len(given[name]), len(after[name])) for name in given}


def words(found: np.ndarray, views: np.ndarray) -> str:
    """One line of figures."""
    edges = (views[0] + views[2]) / (views[1] + views[3])
    return (
        "{:.3f} ({:.3f}) / {:.3f}".format(*found)
        + f"; edges {edges:.3f}, three views {views[0] / views[1]:.3f}, "
        + f"two {views[2] / max(views[3], 1e-9):.3f}"
    )


def with_rims(place: Place, guided: GuidedMatches) -> Matches:
    """Guided matches with rims, which are found among chords, without what is an outline."""
    chords = {view: trinoc.find_segments(p, arcs=True) for view, p in place.pictures.items()}
    rims = trinoc.match.find_rims(trinoc.match_segments(chords, place.rig), chords, place.rig)
    found = trinoc.match.add_rims(guided.matches, guided.segments, rims, chords, place.rig).matches
    return found.take(np.flatnonzero(found.marks["silhouette"] < 0.5))


# What guided detection asks the pictures, by the function of its file that does so, and what that
# answers where nothing is asked.
QUESTIONS = {
    "lines": ("with_new_lines", lambda state, *_: (state, 0)),
    "ends": ("prolong_segments", lambda state, *_: (state, 0)),
}


def of_questions(name: str, places: list[Place]) -> None:
    """Figures with all questions of guided detection, without each, and with none."""
    scenes = []
    for place in places:
        segments = {view: trinoc.find_segments(p) for view, p in place.pictures.items()}
        scenes.append((place, segments, trinoc.match_segments(segments, place.rig)))
    alone = (tuple(other for other in QUESTIONS if other != each) for each in QUESTIONS)
    for left_out in ((), *((each,) for each in QUESTIONS), *alone, tuple(QUESTIONS)):
        rows, views, seconds = [], np.zeros(4), 0.0
        kept = {each: getattr(guide, QUESTIONS[each][0]) for each in left_out}
        for each in left_out:
            setattr(guide, *QUESTIONS[each])
        for place, segments, matches in scenes:
            start = time.process_time()
            found = trinoc.match.guide_matches(matches, segments, place.rig, place.pictures).matches
            seconds += time.process_time() - start
            own, by, _ = figures(place, found)
            rows.append(own)
            views += by
        for each, function in kept.items():
            setattr(guide, QUESTIONS[each][0], function)
        label = "without " + " and ".join(left_out) if left_out else "all questions"
        print(f"{name:10s} {label:32s} {words(np.mean(rows, axis=0), views)}; {seconds:.2f} s")


def of_scenes(name: str, places: Iterable[Place]) -> None:
    """The figures of all these scenes."""
    rows, views, outcomes = [[], [], []], np.zeros((3, 4)), [[], [], []]
    seconds, errors, triples = np.zeros(3), [], np.zeros(3, dtype=np.int64)
    for place in places:
        for _ in range(1 if rows[0] else 2):  # the first run compiles
            start = time.process_time()
            segments = {view: trinoc.find_segments(p) for view, p in place.pictures.items()}
            matches = trinoc.match_segments(segments, place.rig)
            middle = time.process_time()
            guided = trinoc.match.guide_matches(matches, segments, place.rig, place.pictures)
            spent = np.array([middle - start, time.process_time() - middle, 0.0])
            start = time.process_time()
            rims = with_rims(place, guided)
            spent[2] = time.process_time() - start
        seconds += spent
        errors += normalised_errors(place, guided.segments, added_rows(segments, guided.segments))
        for k, one in enumerate((matches, guided.matches, rims)):
            found, by, out = figures(place, one)
            rows[k].append(found)
            views[k] += by
            outcomes[k] += out
            triples[k] += (one.stage == "trinocular").sum()
    for k, label in enumerate(("plain", "guided", "rims")):
        strict = calibration_error([(p, right) for p, right, _ in outcomes[k]])
        lenient = calibration_error([(p, right or shadow) for p, right, shadow in outcomes[k]])
        print(
            f"{name:12s} {label:7s} {words(np.mean(rows[k], axis=0), views[k])}; "
            f"{len(outcomes[k])} tracks, {triples[k]} in three; calibration error {strict:.3f} "
            f"({lenient:.3f}); {seconds[: k + 1].sum() / len(rows[k]):.2f} s",
            flush=True,
        )
    z = np.array(errors)
    if len(z):
        print(
            f"{name:12s} added segments, ends: {len(z)}, normalised error: variance "
            f"{np.mean(z**2):.2f}, by the median {(1.4826 * np.median(np.abs(z))) ** 2:.2f}, "
            f"beyond three sigmas {np.mean(np.abs(z) > 3):.3f}"
        )


def of_merton(folder: Path) -> None:
    """Merton College: tracks in three views and how well they fit, and the published matches."""
    data = np.load(folder / "merton1.npz")
    pictures = {
        f"view{k}": np.asarray(cv2.imread(str(folder / f"view{k}.jpg"), cv2.IMREAD_GRAYSCALE))
        for k in range(3)
    }
    height, width = pictures["view0"].shape
    matrices = {f"view{k}": data["projection"][k] for k in range(3)}
    rig = Rig.from_matrices(matrices, image_size_px=(width, height))
    start = time.process_time()
    segments = {view: trinoc.find_segments(picture) for view, picture in pictures.items()}
    matches = trinoc.match_segments(segments, rig)
    middle = time.process_time()
    guided = trinoc.match.guide_matches(matches, segments, rig, pictures)
    times = middle - start, time.process_time() - middle
    for k, (label, one) in enumerate((("plain", matches), ("guided", guided.matches))):
        three = one.stage == "trinocular"
        off = misfit_px(rig, one)[three]
        print(
            f"merton1      {label:7s} {len(one)} tracks, {three.sum()} in three views, of these "
            f"under 1 px {np.mean(off < 1.0):.3f}, median {np.median(off):.3f} px; length of lines "
            f"{np.linalg.norm(one.lines_mm[:, 1] - one.lines_mm[:, 0], axis=1).sum():.4g}; "
            f"{times[k]:.2f} s",
            flush=True,
        )


def misfit_px(rig: Rig, matches: Matches) -> np.ndarray:
    """(t,) greatest distance across of a fragment's ends from the image of its line."""
    worst = np.zeros(len(matches))
    for view, name in enumerate(matches.views):
        matrix = rig[name].matrix_px
        image = matches.lines_mm @ matrix[:, :3].T + matrix[:, 3]
        image = image[..., :2] / image[..., 2:]
        way = image[:, 1] - image[:, 0]
        normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.linalg.norm(way, axis=1)[:, None]
        off = np.einsum("tei,ti->te", matches.fragments_px[:, view] - image[:, :1], normal)
        worst = np.fmax(worst, np.abs(off).max(axis=1))
    return worst


def main() -> None:
    """Print all tables asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--questions", action="store_true", help="without each question in turn")
    parser.add_argument("--merton", type=Path, help="folder of merton1.npz and its photographs")
    given = parser.parse_args()
    trinoc.io.enable_compile_cache()
    demo = Path(trinoc.synth.__file__).parent / "demo"
    if not given.questions:
        of_scenes("demo", [_place(demo, table1_rig())])
    for folder in given.folders:
        paths = [path for path in sorted(folder.iterdir()) if (path / "truth.json").exists()]
        places = [_place(path, load_rig(path / "rig.json")) for path in paths]
        if given.questions:
            of_questions(folder.name, places)
        else:
            of_scenes(folder.name, places)
    if given.merton:
        of_merton(given.merton)


if __name__ == "__main__":
    main()
