"""Matching of rendered pictures: precision and recall of length, calibration of posteriors."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import equinox as eqx
import numpy as np
from segment_truth import samples_on_shadow, shadow_gradient
from shared_scenes import VIEWS

import trinoc.synth
from simulation import block_scene
from trinoc.evaluation.distances import distance_to_segments_mm, sampled_segments
from trinoc.evaluation.scoring import score_lengths
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io import load_scene_truth
from trinoc.io.rig_json import load_rig
from trinoc.match.matcher import match_segments
from trinoc.match.tracks.matches import Matches
from trinoc.segments import find_segments, find_segments_lsd
from trinoc.synth import table1_rig
from trinoc.synth.truth import SceneTruth, shown_parts_mm

TOLERANCE_MM, GREY_STEP, STEP_MM = 1.0, 8.0, 0.5
SURE = 0.9


class RenderedScene(NamedTuple):
    """A rendered scene; `triangles_mm` are its surfaces, `shadows` the removed grey levels."""

    name: str
    rig: Rig
    truth: SceneTruth
    pictures: dict[str, np.ndarray]
    triangles_mm: np.ndarray
    shadows: dict[str, np.ndarray] | None


class Samples(NamedTuple):
    """Points along the matched lines: line number, represented length, and class."""

    owner: np.ndarray
    length_mm: np.ndarray
    right: np.ndarray
    shadow: np.ndarray


def table_of_rendered(folder: Path | None, calibration_error: Callable) -> None:
    """Print the demo's figures and, of the scenes in a folder, the means."""
    print("\n## Rendered pictures: precision (shadow lines neither way) / recall of length at 1 mm")
    demo = load_rendered_scene(Path(trinoc.synth.__file__).parent / "demo", table1_rig())
    for label, detector in DETECTORS.items():
        figures, _ = _figures(demo, detector)
        print(f"demo        {label:28s} {_words(figures)}", flush=True)
    folders = sorted(folder.iterdir()) if folder else []
    scenes = [
        load_rendered_scene(f, load_rig(f / "rig.json"))
        for f in folders
        if (f / "truth.json").exists()
    ]
    for label, detector in DETECTORS.items() if scenes else ():
        rows, strict, lenient = [], [], []
        for scene in scenes:
            figures, borne_out = _figures(scene, detector)
            rows.append(figures)
            strict += [(p, right) for p, right, _ in borne_out]
            lenient += [(p, right or shadow) for p, right, shadow in borne_out]
        errors = f"{calibration_error(strict):.3f} ({calibration_error(lenient):.3f})"
        print(f"mean of {len(scenes):2d}  {label:28s} {_words(np.mean(rows, axis=0))}  ", end="")
        print(f"calibration error {errors}", flush=True)


def _contrast_alone(image: np.ndarray) -> Segments:
    segments = find_segments(image)
    return eqx.tree_at(lambda s: s.side_levels, segments, None, is_leaf=lambda leaf: leaf is None)


def _geometry_alone(image: np.ndarray) -> Segments:
    segments = _contrast_alone(image)
    return eqx.tree_at(lambda s: s.contrast, segments, np.full(len(segments.contrast), np.nan))


# For matching, arcs are kept in shorter pieces: chords of one arc that views cut differently.
DETECTORS: dict[str, Callable[[np.ndarray], Segments]] = {
    "find_segments, geometry alone": _geometry_alone,
    "find_segments, contrast alone": _contrast_alone,
    "find_segments": find_segments,
    "find_segments with arcs": partial(find_segments, arcs=True, tolerance_px=1.0),
    "LSD": find_segments_lsd,
}


def _figures(
    scene: RenderedScene, detector: Callable[[np.ndarray], Segments]
) -> tuple[np.ndarray, list[tuple[float, bool, bool]]]:
    """(precision, the same without shadows, recall) of all, triples and sure ones; outcomes."""
    segments = {view: detector(picture) for view, picture in scene.pictures.items()}
    matches = match_segments(segments, scene.rig)
    samples = _samples(scene, matches)
    three = (matches.index >= 0).sum(axis=1) > 2
    figures = []
    for rows in (three | ~three, three, matches.posterior > SURE):
        recall = score_lengths(
            matches.lines_mm[rows], scene.truth, tolerance_mm=TOLERANCE_MM, grey_step=GREY_STEP
        ).recall
        length = samples.length_mm * rows[samples.owner]
        right = length[samples.right].sum()
        figures += [right / length.sum(), right / length[~samples.shadow].sum(), recall]
    count = np.bincount(samples.owner, minlength=len(matches.posterior))
    right, shadow = (
        np.bincount(samples.owner, is_so, minlength=len(count)) / count > 0.5
        for is_so in (samples.right, samples.right | samples.shadow)
    )
    return np.array(figures), list(zip(matches.posterior.tolist(), right, shadow, strict=True))


def length_by_views(truth: SceneTruth, lines_mm: np.ndarray) -> np.ndarray:
    """Length found and length to find of straight edges: in three views or more, in just two."""
    two, three = (
        shown_parts_mm(truth, views=k, grey_step=GREY_STEP, kinds=("edge",)) for k in (2, 3)
    )
    points, weight = sampled_segments(two, 0.5)
    in_three = distance_to_segments_mm(points, three) < 1e-6
    is_near = distance_to_segments_mm(points, lines_mm) < TOLERANCE_MM
    parts = (is_near & in_three, in_three, is_near & ~in_three, ~in_three)
    return np.array([weight[part].sum() for part in parts])


def score_scene(
    scene: RenderedScene, matches: Matches
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, bool, bool]]]:
    """(precision, the same without shadows, recall; recall by views; outcomes) of all lines."""
    samples = _samples(scene, matches)
    count = np.bincount(samples.owner, minlength=len(matches))
    right, shadow = (
        np.bincount(samples.owner, is_so, minlength=len(count)) / count > 0.5
        for is_so in (samples.right, samples.right | samples.shadow)
    )
    length, good = samples.length_mm, samples.length_mm[samples.right].sum()
    recall = score_lengths(
        matches.lines_mm, scene.truth, tolerance_mm=TOLERANCE_MM, grey_step=GREY_STEP
    ).recall
    scores = np.array([good / length.sum(), good / length[~samples.shadow].sum(), recall])
    outcomes = list(zip(matches.posterior.tolist(), right, shadow, strict=True))
    return scores, length_by_views(scene.truth, matches.lines_mm), outcomes


def _words(figures: np.ndarray) -> str:
    return "  ".join(
        f"{kind} {precision:.3f} ({without:.3f})/{recall:.3f}"
        for kind, (precision, without, recall) in zip(
            ("all", "triples", f"p > {SURE}"), figures.reshape(3, 3), strict=True
        )
    )


def load_rendered_scene(folder: Path, rig: Rig) -> RenderedScene:
    pictures = {view: _picture(folder / f"scene_{view}.png") for view in VIEWS}
    truth = load_scene_truth(folder / "truth.json")
    seed = json.loads((folder / "truth.json").read_text()).get("seed")
    triangles, shadows = np.zeros((0, 3, 3)), None
    if seed is not None and (folder / f"shadows_{VIEWS[0]}.png").exists():
        triangles = np.concatenate([solid.triangles_mm for solid in block_scene(seed).solids])
        shadows = {
            view: shadow_gradient(folder / f"shadows_{view}.png", picture.shape)
            for view, picture in pictures.items()
        }
    return RenderedScene(folder.name, rig, truth, pictures, triangles, shadows)


def _picture(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise SystemExit(f"{path} is no picture.")
    return picture


def _samples(scene: RenderedScene, matches: Matches) -> Samples:
    """Points every half millimetre along the lines.

    A point is on a shadow's line where it lies on no edge but on a surface, and where in all
    views of its match a shadow's boundary runs along the line there.
    """
    step = matches.lines_mm[:, 1] - matches.lines_mm[:, 0]
    length = np.linalg.norm(step, axis=1)
    count = np.maximum(np.ceil(length / STEP_MM).astype(int), 1)
    owner = np.repeat(np.arange(len(count)), count)
    position = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[
        owner
    ]
    points = matches.lines_mm[owner, 0] + position[:, None] * step[owner]
    right = distance_to_segments_mm(points, scene.truth.edges_mm) < TOLERANCE_MM
    if scene.shadows is None:
        return Samples(owner, (length / count)[owner], right, np.zeros_like(right))
    shadow = ~right & _on_surface(points, scene.triangles_mm)
    unit = step[owner] / length[owner, None]
    for column, view in enumerate(matches.views):
        here, there = (_project(scene.rig[view].matrix_px, p) for p in (points, points + unit))
        along = (there - here) / np.linalg.norm(there - here, axis=1, keepdims=True)
        is_member = matches.index[owner, column] >= 0
        shadow &= ~is_member | samples_on_shadow(here, along, scene.shadows[view])
    return Samples(owner, (length / count)[owner], right, shadow)


def _project(matrix: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    image = points_mm @ matrix[:, :3].T + matrix[:, 3]
    return image[:, :2] / image[:, 2:]


def _on_surface(points_mm: np.ndarray, triangles_mm: np.ndarray) -> np.ndarray:
    """Mask of the points within the tolerance of the table (Z = 0) or of a triangle."""
    is_near = np.abs(points_mm[:, 2]) < TOLERANCE_MM
    for triangle in triangles_mm:
        first, second = triangle[1] - triangle[0], triangle[2] - triangle[0]
        normal = np.cross(first, second)
        offset = points_mm - triangle[0]
        height = offset @ normal / np.linalg.norm(normal)
        basis = np.stack([first, second], axis=1)
        inner = offset @ np.linalg.pinv(basis).T
        inside = (inner >= 0).all(axis=1) & (inner.sum(axis=1) <= 1)
        is_near |= inside & (np.abs(height) < TOLERANCE_MM)
    return is_near
