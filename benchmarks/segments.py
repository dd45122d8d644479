"""Line segments beside OpenCV's LSD: recall, precision, accuracy, coverage, time.

    python benchmarks/segments.py [--scenes DIR] [--photographs DIR] [--no-times]

DIR of --scenes holds what `benchmarks/render_pictures.py blocks` renders; recall counts the
length of visible edges with a step of 8 grey levels or more, precision the length of segments
that lie on such an edge, or (weak) on one of 2 levels or more. The edges of shadows are no
edges of the scene and count as false for everybody. DIR of --photographs holds merton1.npz and
its pictures (VGG, Oxford). LSD runs as it comes and with its bias of (-0.123, -0.119) px taken
out. Times are medians of warm calls, ours and LSD's in turn on the same picture.
"""

import argparse
import resource
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from segment_truth import Picture, Score, covering, rendered_pictures, score

from trinoc.geometry.segments import Segments
from trinoc.match.find_segments import find_segments
from trinoc.match.lsd import LSD_BIAS_PX

SAME_STEP = 1 / 3
# The slope of an edge, seen through the masks, is about a quarter of its step per pixel.
SHADOW_SHARE = 0.04
_LSD = cv2.createLineSegmentDetector()


def lsd_as_it_comes(grey: np.ndarray) -> np.ndarray:
    lines = _LSD.detect(grey)[0]
    return np.zeros((0, 4)) if lines is None else np.asarray(lines, dtype=float).reshape(-1, 4)


def lsd_corrected(grey: np.ndarray) -> np.ndarray:
    return lsd_as_it_comes(grey) - np.tile(LSD_BIAS_PX, 2)


def ours(grey: np.ndarray) -> np.ndarray:
    return np.asarray(find_segments(grey).endpoints_px).reshape(-1, 4)


DETECTORS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "LSD": lsd_as_it_comes,
    "LSD, bias out": lsd_corrected,
    "trinoc": ours,
}


def scenes(folder: Path) -> None:
    pictures = list(rendered_pictures(folder))
    print(f"\n{len(pictures)} rendered pictures, {pictures[0].grey.shape[1]} px wide")
    print("                recall  prec.  weak   across (length)  across (segment)  end px   ms")
    for name, detect in DETECTORS.items():
        scores, times = [], []
        for picture in pictures:
            begin = time.perf_counter()
            lines = detect(picture.grey)
            times.append(time.perf_counter() - begin)
            scores.append(score(lines, picture.edges))
        print(f"{name:15s} {_row(scores)} {1e3 * np.median(times):8.1f}")
    normalised = [_normalised(find_segments(p.grey), p) for p in pictures]
    reasons = np.concatenate([reason for _, reason in normalised])
    ratio = np.concatenate([z for z, _ in normalised])
    print("normalised across-line error      n   variance  median-based   beyond 3 sigma")
    for reason in ("all", "", "neighbour", "wide", "saturated", "bent"):
        z = ratio if reason == "all" else ratio[reasons == reason]
        if len(z):
            middle = np.square(np.median(np.abs(z)) / 0.6745)
            print(
                f"  {reason or 'noise only':28s} {len(z):6d} {np.mean(z**2):9.2f}"
                f" {middle:12.2f} {np.mean(np.abs(z) > 3):14.3f}"
            )


def _row(scores: list[Score]) -> str:
    def total(name: str) -> float:
        return sum(getattr(one, name) for one in scores)

    length = np.concatenate([one.across_of_length for one in scores])
    segment = np.abs(np.concatenate([one.ends_across.mean(axis=1) for one in scores]))
    end = np.concatenate([one.end_error for one in scores])
    return (
        f"{total('found') / total('shown'):6.3f} {total('right') / total('put_out'):6.3f}"
        f" {total('right_weak') / total('put_out'):6.3f}"
        f"   {np.median(length):.3f} / {np.quantile(length, 0.9):.3f}"
        f"    {np.median(segment):.3f} / {np.quantile(segment, 0.9):.3f}"
        f"   {np.median(end):6.2f}"
    )


def _normalised(segments: Segments, picture: Picture) -> tuple[np.ndarray, np.ndarray]:
    """(z, reason) of the middles of the segments that are the edge they lie on.

    A shadow's edge may run a pixel or two beside an edge of the scene. So a segment counts
    only where no steep slope of a shadow is near, as the noise-free rendering shows it, where
    its step has the sign and, within a third, the size of the edge's, and where no second edge
    is within 1.5 px, the reach of the comparison.
    """
    ends = np.asarray(segments.endpoints_px)
    found = score(ends.reshape(-1, 4), picture.edges)
    way = ends[:, 1] - ends[:, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=-1) / np.linalg.norm(way, axis=1)[:, None]
    half = np.concatenate([normal, normal], axis=1) / 2
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", half, np.asarray(segments.covariance_px2), half))
    assert segments.reasons is not None
    contrast = np.asarray(segments.contrast)[found.matched]
    same = found.alone & np.isfinite(found.step)
    same &= np.abs(contrast + found.step) < SAME_STEP * np.maximum(contrast, np.abs(found.step))
    places = ends[found.matched, :1] + np.linspace(0.1, 0.9, 9)[:, None] * way[found.matched, None]
    column, row = np.rint(places).astype(int).clip(0).transpose(2, 0, 1)
    height, width = picture.grey.shape
    slope = picture.shadow_slope[row.clip(max=height - 1), column.clip(max=width - 1)]
    same &= slope.max(axis=1, initial=0.0) < SHADOW_SHARE * contrast
    ratio = found.ends_across.mean(axis=1) / sigma[found.matched]
    return ratio[same], segments.reasons[found.matched[same]]


def nothing_to_find() -> None:
    """Pictures without edges, and one of edges only."""
    side = 1000
    rng = np.random.default_rng(0)
    white = np.full((side, side), 255.0)
    pictures = {
        "blank": np.full((side, side), 128.0),
        "noise 2": rng.normal(128, 2, (side, side)),
        "noise 20": rng.normal(128, 20, (side, side)),
        "saturated, noise 10": white + rng.normal(0, 10, (side, side)),
    }
    print("\nsegments per megapixel      LSD   trinoc")
    for name, grey in pictures.items():
        grey = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        print(f"  {name:22s} {len(lsd_as_it_comes(grey)):8d} {len(ours(grey)):8d}")
    v, u = np.mgrid[:side, :side]
    board = 60 + 120 * (((u // 40) + (v // 40)) % 2)
    board = cv2.GaussianBlur(board.astype(np.float32), (0, 0), 0.8)
    board = np.clip(np.rint(board + rng.normal(0, 2, board.shape)), 0, 255).astype(np.uint8)
    for name, detect in (("LSD", lsd_corrected), ("trinoc", ours)):
        lines = detect(board)
        middle = (lines[:, :2] + lines[:, 2:]) / 2
        # Its lines run at 39.5, 79.5, ... along u and v.
        off = np.abs((middle - 19.5) % 40 - 20)
        false = off.min(axis=1) > 1.5
        print(f"  checkerboard, {name:8s}: {len(lines)} segments, {false.sum()} off its lines")


def photographs(folder: Path) -> None:
    published = np.load(folder / "merton1.npz")
    print("\nMerton: share of the published length found again within 1.5 px, across px, count")
    for view in (0, 1, 2):
        grey = np.asarray(cv2.imread(str(folder / f"view{view}.jpg"), cv2.IMREAD_GRAYSCALE))
        truth = published[f"segments_{view}"].astype(float)
        truth = truth[np.hypot(*(truth[:, 2:4] - truth[:, :2]).T) >= 15]
        for name, detect in DETECTORS.items():
            begin = time.perf_counter()
            lines = detect(grey)
            passed = time.perf_counter() - begin
            hit, _, length, across = covering(truth[:, :4], lines)
            print(
                f"  view {view} {name:14s} {length[hit >= 0].sum() / length.sum():.3f}"
                f"  {np.median(np.abs(across[hit >= 0])):.3f} {len(lines):6d}"
                f" {1e3 * passed:8.0f} ms"
            )


def times() -> None:
    """Boxes of light on a dark ground, as many per area at every size."""
    print("\n                 LSD ms  trinoc ms   ratio   peak MiB so far")
    for width, height, repeats in ((512, 480, 21), (2048, 1920, 7), (6000, 4000, 3)):
        grey = _boxes(width, height)
        for detect in (lsd_as_it_comes, ours):
            detect(grey)
        passed: dict[str, list[float]] = {"lsd": [], "ours": []}
        for _ in range(repeats):
            for name, detect in (("lsd", lsd_as_it_comes), ("ours", ours)):
                begin = time.perf_counter()
                detect(grey)
                passed[name].append(1e3 * (time.perf_counter() - begin))
        lsd, own = np.median(passed["lsd"]), np.median(passed["ours"])
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"  {width} x {height:5d} {lsd:9.1f} {own:9.1f} {own / lsd:8.2f} {peak:10.0f}")


def _boxes(width: int, height: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    grey = np.full((height, width), 70, dtype=np.uint8)
    size = 12 * np.sqrt(width * height / (512 * 480))
    for _ in range(60):
        centre = rng.uniform([0, 0], [width, height])
        box = cv2.boxPoints(
            (centre.tolist(), rng.uniform(size, 5 * size, 2).tolist(), rng.uniform(0, 90))
        )
        cv2.fillPoly(
            grey, [np.rint(box * 16).astype(np.int32)], int(rng.integers(20, 220)), cv2.LINE_AA, 4
        )
    grey = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.8)
    noise = rng.normal(0, 3, grey.shape).astype(np.float32)
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", type=Path, action="append", default=[])
    parser.add_argument("--photographs", type=Path)
    parser.add_argument("--no-times", action="store_true")
    given = parser.parse_args()
    for folder in given.scenes:
        scenes(folder)
    nothing_to_find()
    if given.photographs:
        photographs(given.photographs)
    if not given.no_times:
        times()


if __name__ == "__main__":
    main()
