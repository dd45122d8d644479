"""Tracks of public real scenes, tested in views that were not matched.

    python benchmarks/real_scenes.py FOLDER [--only NAME ...] [--sets 3 6 most] [--save DIR]

FOLDER/NAME holds rig.json and the pictures VIEW.png, as real_scenes_collect.py writes them.
Nobody knows the edges of such scenes. Segments are found in all views, those of some are matched,
and a track is judged by the others. A view shows a line if 15 px and half of it lie in the picture,
and if it is known there to 2 px across. It supports the line if at least half of what it shows lies
within 2 px and 6 degrees of segments. A track is supported if more views support it than 95 % of 60
copies, moved in depth by 8 to 20 % along the rays of the mean centre of its cameras. A track, right
or wrong, is left out where support by two thirds of the views that show it would not be enough: few
show it, or copies lie on segments everywhere. Right lines lack support where they are hidden or the
detector misses them, so that sure tracks stay below 1, most of all those of few of many views.
"chance" is the share of wrong lines, one more copy of each track, that count as supported.

Printed for each scene and number of matched views, by views in the track, and for tracks of four
views or more whose misfit is below its degrees of freedom ("fit") or above ten times these ("off"):
tracks, those judged, supported / claimed (number) by posterior, error of calibration (mean |claimed
- supported| by bins, weighted), chance; distance of the ends of the members from the projected
line (median, 95, 99 %); processor time. "fit" tells what right lines reach. --save keeps tracks.
"""

import argparse
import time
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

import trinoc

NEAR_PX, NEAR_DEG, HALF, ENOUGH = 2.0, 6.0, 0.5, 2 / 3
LEAST_PX, SURE_PX, SAMPLES, COPIES, SHARE, MOVED = 15.0, 2.0, 24, 60, 0.95, (0.08, 0.20)
# Directions are kept in bins of 3 degrees, a bit each.
BINS, HELD_OUT = 60, (3, 5)
KEPT = ("index", "fragments_px", "lines_mm", "covariance_mm2", "posterior", "misfit")
EDGES = np.array([0.0, 0.5, 0.8, 0.9, 0.97, 1.0])


class View(NamedTuple):
    """A projection, the picture's segments, and the directions of those near each pixel."""

    matrix_px: np.ndarray
    size_px: np.ndarray
    segments: trinoc.Segments
    direction_bits: np.ndarray


class Judged(NamedTuple):
    """For each track: numbers of supporting and of showing views, whether it can be judged and
    is supported, and whether a wrong line is supported."""

    supporting: np.ndarray
    showing: np.ndarray
    decided: np.ndarray
    supported: np.ndarray
    by_chance: np.ndarray


def directions_near(ends_px: np.ndarray, size_px: np.ndarray) -> np.ndarray:
    """(h, w) the bins of direction, as bits, of the segments that pass within NEAR_PX."""
    direction_bits = np.zeros((size_px[1], size_px[0]), np.uint64)
    for first, second in ends_px:
        along = second - first
        length = np.linalg.norm(along)
        angle = np.degrees(np.arctan2(along[1], along[0])) % 180
        turn = (np.arange(BINS) * 180 / BINS - angle + 90) % 180 - 90
        bits = np.uint64(sum(1 << int(k) for k in np.flatnonzero(np.abs(turn) <= NEAR_DEG)))
        across = np.array([-along[1], along[0]]) / length
        steps = np.linspace(0, 1, int(2 * length) + 2)[:, None, None]
        offsets = np.arange(-NEAR_PX, NEAR_PX + 0.1, 0.5)[None, :, None]
        pixel = np.rint(first + steps * along + offsets * across).astype(int).reshape(-1, 2)
        u, v = pixel[((pixel >= 0) & (pixel < size_px)).all(axis=1)].T
        direction_bits[v, u] |= bits
    return direction_bits


def load_views(scene: Path) -> tuple[dict[str, View], trinoc.Rig]:
    """Views and cameras of a scene, without distortion."""
    views, cameras = {}, {}
    for name, camera in trinoc.load_rig(scene / "rig.json").items():
        lens, size = camera.intrinsics, np.array(camera.image_size_px)
        picture = cv2.imread(str(scene / f"{name}.png"))
        segments = trinoc.find_segments(picture, intrinsics=lens if lens.has_distortion else None)
        ideal = trinoc.Intrinsics.from_matrix(lens.matrix, lens.image_size_px)
        cameras[name] = trinoc.Camera(ideal, camera.pose)
        direction_bits = directions_near(np.asarray(segments.endpoints_px), size)
        views[name] = View(np.asarray(cameras[name].matrix_px), size, segments, direction_bits)
    return views, trinoc.Rig(cameras)


def matching_sets(rig: trinoc.Rig, wanted: list[str]) -> dict[str, tuple[list[str], list[str]]]:
    """Matched and held-out views of each set: a central view, some near it, some between these."""
    centre = np.array([camera.centre_world_mm for camera in rig.cameras])
    away = np.linalg.norm(centre - centre[:, None], axis=2)
    order = [list(rig)[k] for k in np.argsort(away[away.sum(axis=1).argmin()])]
    sets = {}
    for set_name in wanted:
        count = min(int(set_name) if set_name != "most" else len(order), len(order) - HELD_OUT[0])
        nearest = order[: count + HELD_OUT[1]]
        others = np.linspace(1, len(nearest) - 1, len(nearest) - count).round().astype(int)
        held_out = nearest[3:] if count == 3 else [nearest[k] for k in others]
        sets[str(count)] = ([name for name in nearest if name not in held_out], held_out)
    return sets


def clip_to_picture(ends_px: np.ndarray, size_px: np.ndarray) -> np.ndarray:
    """(n, 2) start and end of each segment's part in the picture, as shares of its length."""
    first, along = ends_px[:, 0], ends_px[:, 1] - ends_px[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.stack([-first / along, (size_px - 1 - first) / along], axis=-1)
    end = np.nanmin(bounds.max(axis=-1), axis=1, initial=1.0)
    return np.stack([np.nanmax(bounds.min(axis=-1), axis=1, initial=0.0), end], axis=1)


def show_and_support(lines_mm: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Masks of the (n, 2, 3) lines that a view shows, and that its segments support."""
    image = lines_mm @ view.matrix_px[:, :3].T + view.matrix_px[:, 3]
    before = (image[..., 2] > 0).all(axis=1)
    ends = image[..., :2] / np.where(before[:, None], image[..., 2], 1.0)[..., None]
    part = clip_to_picture(ends, view.size_px)
    along, inside = ends[:, 1] - ends[:, 0], part[:, 1] - part[:, 0]
    shown = before & (inside >= HALF) & (inside * np.linalg.norm(along, axis=1) >= LEAST_PX)
    steps = part[:, :1] + np.linspace(0, 1, SAMPLES) * (part[:, 1:] - part[:, :1])
    pixels = np.rint(ends[:, :1] + np.where(shown[:, None], steps, 0)[..., None] * along[:, None])
    u, v = np.where(shown[:, None, None], pixels, 0).astype(int).clip(0, view.size_px - 1).T
    angle = np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 180
    bit = np.rint(angle * BINS / 180).astype(np.uint64) % np.uint64(BINS)
    on = (view.direction_bits[v, u] >> bit) & np.uint64(1)
    return shown, shown & (on.mean(axis=0) >= HALF)


def line_through(image: np.ndarray) -> np.ndarray:
    """(n, 3) lines through (n, 2, 3) homogeneous points, with normals of length 1."""
    line = np.cross(image[:, 0], image[:, 1])
    return line / np.linalg.norm(line[:, :2], axis=1, keepdims=True)


def sigma_across_px(matches: trinoc.Matches, view: View) -> np.ndarray:
    """(t,) standard deviation of a projected line across itself, at the less certain end.

    What a misfit adds to a covariance is taken out: else no track that fits badly is judged.
    """
    image = matches.lines_mm @ view.matrix_px[:, :3].T + view.matrix_px[:, 3]
    line = line_through(image)
    slope = (line @ view.matrix_px[:, :3])[:, None] / image[..., 2:]
    end_covariance = np.stack(
        [matches.covariance_mm2[:, :3, :3], matches.covariance_mm2[:, 3:, 3:]], axis=1
    )
    degrees = 2 * ((matches.index >= 0).sum(axis=1) - 2)
    excess = np.maximum(matches.misfit / np.maximum(degrees, 1), 1)
    return np.sqrt(np.einsum("tei,teij,tej->te", slope, end_covariance, slope).max(axis=1) / excess)


def judge(matches: trinoc.Matches, rig: trinoc.Rig, held_out_views: list[View]) -> Judged:
    """Support of each track in held-out views, against the support of copies moved in depth."""
    generator = np.random.default_rng(0)
    centres = np.array([rig[name].centre_world_mm for name in matches.views])
    sees = (matches.index >= 0)[..., None]
    origin = ((centres * sees).sum(axis=1) / sees.sum(axis=1))[:, None]
    shape = (COPIES + 1, len(matches))
    factor = 1 + generator.uniform(*MOVED, shape) * generator.choice([-1, 1], shape)
    factor = np.concatenate([np.ones((1, len(matches))), factor])[..., None, None]
    lines = (origin + factor * (matches.lines_mm - origin)).reshape(-1, 2, 3)
    shown, support = np.zeros((2, COPIES + 2, len(matches)), int)
    for view in held_out_views:
        showing, supporting = show_and_support(lines, view)
        certain = sigma_across_px(matches, view) < SURE_PX
        shown += showing.reshape(shown.shape) & certain
        support += supporting.reshape(support.shape) & certain
    limit = np.quantile(support[2:], SHARE, axis=0, method="inverted_cdf")
    decided = limit + 1 <= ENOUGH * shown[0]
    return Judged(support[0], shown[0], decided, support[0] > limit, support[1] > limit)


def member_distances(matches: trinoc.Matches, rig: trinoc.Rig) -> np.ndarray:
    """Distances of the ends of all members from their projected lines, px."""
    away = []
    for k, name in enumerate(matches.views):
        rows, matrix = matches.index[:, k] >= 0, np.asarray(rig[name].matrix_px)
        line = line_through(matches.lines_mm[rows] @ matrix[:, :3].T + matrix[:, 3])
        ends = np.asarray(matches.fragments_px)[rows, k]
        away.append(np.abs((ends * line[:, None, :2]).sum(axis=-1) + line[:, None, 2]).ravel())
    return np.concatenate(away) if len(matches) else np.zeros(1)


def groups(matches: trinoc.Matches) -> dict[str, np.ndarray]:
    """Masks of the tracks in each row of the table, by number of views and by misfit."""
    count = (matches.index >= 0).sum(axis=1)
    ratio = np.where(count > 3, matches.misfit / np.maximum(2 * (count - 2), 1), np.nan)
    by_views = {str(k): count == k for k in (2, 3, 4, 5)} | {"6+": count > 5, "all": count > 1}
    return by_views | {"fit": ratio < 1, "off": ratio > 10}


def print_group(name: str, rows: np.ndarray, posterior: np.ndarray, verdict: Judged) -> None:
    """Print one line of the table: the tracks of `rows`, and their support by posterior."""
    picked = rows & verdict.decided
    cells, error = [], 0.0
    for low, high in pairwise(EDGES):
        here = picked & (posterior >= low) & ((posterior < high) | (high == 1))
        cells.append("-")
        if here.any():
            right, mean_posterior = verdict.supported[here].mean(), posterior[here].mean()
            error += here.sum() / picked.sum() * abs(mean_posterior - right)
            cells[-1] = f"{right:.2f}/{mean_posterior:.2f} ({here.sum():4d})"
    chance = verdict.by_chance[picked].mean() if picked.any() else np.nan
    counts = f"{name:>6s} {rows.sum():6d} {picked.sum():6d}"
    print(counts, *(f"{cell:>15s}" for cell in cells), f" {error:.3f}  {chance:.3f}")


def judge_scene(scene: Path, wanted: list[str], save: Path | None) -> None:
    """Match the sets of a scene, test their tracks and print the table."""
    views, rig = load_views(scene)
    counts = np.quantile([len(view.segments) for view in views.values()], [0, 1]).astype(int)
    print(f"\n{scene.name}: {len(views)} views of {counts[0]} to {counts[1]} segments")
    for number, (names, others) in matching_sets(rig, wanted).items():
        start = time.process_time()
        matches = trinoc.match_segments({name: views[name].segments for name in names}, rig)
        seconds = time.process_time() - start
        verdict = judge(matches, rig, [views[name] for name in others])
        off = np.quantile(member_distances(matches, rig), [0.5, 0.95, 0.99])
        print(f" {number} matched ({' '.join(names)}), held out {' '.join(others)}")
        print(f" {matches.status.name}, members off by {np.round(off, 2)} px, {seconds:.1f} s")
        bins = " ".join(f"{f'{a:.2g} to {b:.2g}':>15s}" for a, b in pairwise(EDGES))
        print(f" views tracks judged {bins}  error chance")
        for name, rows in groups(matches).items():
            if rows.any():
                print_group(name, rows, matches.posterior, verdict)
        if save is not None:
            save.mkdir(parents=True, exist_ok=True)
            record = {field: getattr(matches, field) for field in KEPT} | verdict._asdict()
            np.savez(save / f"{scene.name}_{number}.npz", names=names, held=others, **record)


def main() -> None:
    """Judge all scenes of a folder, or those named by --only. A folder without any prints none."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--sets", nargs="*", default=["3", "6", "most"])
    parser.add_argument("--save", type=Path)
    options = parser.parse_args()
    for path in sorted(options.folder.glob("*/rig.json")):
        if not options.only or path.parent.name in options.only:
            judge_scene(path.parent, options.sets, options.save)


if __name__ == "__main__":
    main()
