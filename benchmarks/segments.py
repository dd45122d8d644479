"""Line segments beside LSD, FLD and EDLines: recall, precision, accuracy, coverage, time, memory.

    python benchmarks/segments.py [--scenes DIR] [--photographs DIR] [--no-times]

DIR of --scenes holds what `benchmarks/render_pictures.py blocks` renders. Recall counts the
length of visible edges with a step of 8 grey levels or more, precision the length of segments
that lie on such an edge, or (weak) on one of 2 levels or more. What lies on the edge of a shadow
and on no edge of the scene counts neither for nor against: `shadow` is its share of all length.
`rims`, the chords of cylinders' rims, count as false. DIR of --photographs holds photographs and
their published segments, as `segment_truth.photographs` reads them. LSD runs as it comes and with
its bias of (-0.123, -0.119) px taken out.
FLD and EDLines take part where cv2 has `ximgproc` (opencv-contrib-python-headless, in an
environment of its own: it overwrites opencv-python-headless). Single edges are shown as cameras
deliver them too: sRGB, sharpened, saturated. Times are medians of warm calls, in
processor time, all detectors in turn on the same picture; peak memory is what the process of one
detector, fresh for each size, grows by during its first call.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr
from segment_truth import (
    Photograph,
    Picture,
    Score,
    covering,
    photographs,
    recall_of_published,
    rendered_images,
    score,
)

from simulation.camera_picture.delivery import SRGB
from trinoc.geometry.segments import Segments
from trinoc.image.response import ResponseLike
from trinoc.segments import find_segments
from trinoc.segments.lsd import LSD_BIAS_PX

SAME_STEP = 1 / 3
# Pictures in so much stronger light have saturated faces.
GAINS = (1.5, 2.2)
# The slope of an edge, seen through the masks, is about a quarter of its step per pixel.
SHADOW_SHARE = 0.04
# Pictures of single edges.
SIDE_PX, NOISE, EDGES = 64, 1.5, 24
# Blur of the lens; the pixel's box adds its variance.
BLURS_PX = (0.7, 1.0, 1.5)
_PIXEL_VARIANCE = 1 / 12
_EXTRA: Any = getattr(cv2, "ximgproc", None)
_LSD = cv2.createLineSegmentDetector()


def lsd_as_it_comes(grey: np.ndarray) -> np.ndarray:
    lines = _LSD.detect(grey)[0]
    return np.zeros((0, 4)) if lines is None else np.asarray(lines, dtype=float).reshape(-1, 4)


def lsd_corrected(grey: np.ndarray) -> np.ndarray:
    return lsd_as_it_comes(grey) - np.tile(LSD_BIAS_PX, 2)


def ours(grey: np.ndarray) -> np.ndarray:
    return np.asarray(find_segments(grey).endpoints_px).reshape(-1, 4)


def fast_line_detector(grey: np.ndarray) -> np.ndarray:
    lines = _EXTRA.createFastLineDetector().detect(grey)
    return np.zeros((0, 4)) if lines is None else np.asarray(lines, dtype=float).reshape(-1, 4)


def edge_drawing(grey: np.ndarray) -> np.ndarray:
    drawing = _EXTRA.createEdgeDrawing()
    drawing.detectEdges(grey)
    lines = drawing.detectLines()
    return np.zeros((0, 4)) if lines is None else np.asarray(lines, dtype=float).reshape(-1, 4)


DETECTORS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "LSD": lsd_as_it_comes,
    "LSD, bias out": lsd_corrected,
    **({"FLD": fast_line_detector, "EDLines": edge_drawing} if _EXTRA is not None else {}),
    "trinoc": ours,
}
TIMED = {name: detect for name, detect in DETECTORS.items() if name != "LSD, bias out"}


def scenes(folder: Path) -> None:
    pictures = list(rendered_images(folder))
    print(f"\n{len(pictures)} rendered pictures, {pictures[0].grey.shape[1]} px wide")
    print(
        "                recall  prec.  weak   rims shadow   across (length)  across (segment)"
        "  end px   ms"
    )
    for name, detect in DETECTORS.items():
        scores, times = [], []
        for picture in pictures:
            begin = time.perf_counter()
            lines = detect(picture.grey)
            times.append(time.perf_counter() - begin)
            scores.append(score(lines, picture))
        print(f"{name:15s} {_row(scores)} {1e3 * np.median(times):8.1f}")
    normalised = [_normalised(find_segments(p.grey), p) for p in pictures]
    reasons = np.concatenate([reason for _, reason in normalised])
    ratio = np.concatenate([z for z, _ in normalised])
    _ends(pictures)
    _print_normalised(ratio, reasons)
    for gain in GAINS:
        bright = [_overexposed(p, gain) for p in pictures if p.clean is not None]
        errors = [_normalised(find_segments(p.grey), p) for p in bright]
        if errors:
            print(f"light {gain:g} times as strong: saturated edges")
            _print_normalised(*(np.concatenate(of) for of in zip(*errors, strict=True)))


def _overexposed(picture: Picture, gain: float) -> Picture:
    """The picture without its noise in stronger light, clipped, and with a noise of 2 levels."""
    assert picture.clean is not None
    noise = np.random.default_rng(0).normal(0, 2, picture.clean.shape)
    grey = np.clip(np.rint(gain * picture.clean + noise), 0, 255).astype(np.uint8)
    edges = picture.edges.copy()
    edges[:, 4] *= gain
    return picture._replace(grey=grey, edges=edges, shadow_slope=gain * picture.shadow_slope)


def _print_normalised(ratio: np.ndarray, reasons: np.ndarray) -> None:
    print("normalised across-line error      n   variance  median-based   beyond 3 sigma")
    for reason in ("all", "", "neighbour", "saturated", "shaded", "bent"):
        z = ratio if reason == "all" else ratio[reasons == reason]
        if len(z):
            middle = np.square(np.median(np.abs(z)) / 0.6745)
            print(
                f"  {reason or 'noise only':28s} {len(z):6d} {np.mean(z**2):9.2f}"
                f" {middle:12.2f} {np.mean(np.abs(z) > 3):14.3f}"
            )


def _ends(pictures: list[Picture]) -> None:
    """Print the errors of the ends, along and across, and the share within their sigmas."""
    print("end px: along median / 90 %, share within 3 of its sigmas; across median / 90 %, same")
    parts: dict[str, list[np.ndarray]] = {"at a crossing": [], "free": []}
    for picture in pictures:
        segments = find_segments(picture.grey)
        ends = np.asarray(segments.endpoints_px)
        scored = score(ends.reshape(-1, 4), picture)
        directions = (ends[:, 1] - ends[:, 0])[scored.matched]
        directions = directions / np.linalg.norm(directions, axis=1)[:, None]
        normal = np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
        covariance = np.asarray(segments.covariance_px2)[scored.matched]
        blocks = np.stack([covariance[:, :2, :2], covariance[:, 2:, 2:]], axis=1)
        along, across = (
            np.sqrt(np.einsum("ni,neij,nj->ne", axis, blocks, axis))
            for axis in (directions, normal)
        )
        rows = np.stack(
            [np.abs(scored.ends_along), along, np.abs(scored.ends_across), across], axis=-1
        ).reshape(-1, 4)
        crossing = rows[:, 1] < 1
        parts["at a crossing"].append(rows[crossing])
        parts["free"].append(rows[~crossing])
    for name, part_rows in parts.items():
        error, sigma, off, sigma_off = np.concatenate(part_rows).T
        print(
            f"  {name:15s} {len(error):6d} {np.median(error):6.2f} / {np.quantile(error, 0.9):5.2f}"
            f"  {np.mean(error < 3 * sigma):.3f}   {np.median(off):.3f} / "
            f"{np.quantile(off, 0.9):.3f}  {np.mean(off < 3 * sigma_off):.3f}"
        )


def _row(scores: list[Score]) -> str:
    def total(name: str) -> float:
        return sum(getattr(one, name) for one in scores)

    length = np.concatenate([one.across_of_length for one in scores])
    segment = np.abs(np.concatenate([one.ends_across.mean(axis=1) for one in scores]))
    end = np.concatenate([one.end_error for one in scores])
    return (
        f"{total('found') / total('shown'):6.3f} {total('right') / total('put_out'):6.3f}"
        f" {total('right_weak') / total('put_out_weak'):6.3f}"
        f" {total('on_rims') / total('put_out_weak'):6.3f}"
        f" {total('on_shadows') / (total('put_out_weak') + total('on_shadows')):6.3f}"
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
    scored = score(ends.reshape(-1, 4), picture)
    directions = ends[:, 1] - ends[:, 0]
    normal = (
        np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
        / np.linalg.norm(directions, axis=1)[:, None]
    )
    half = np.concatenate([normal, normal], axis=1) / 2
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", half, np.asarray(segments.covariance_px2), half))
    assert segments.reasons is not None
    contrast = np.asarray(segments.contrast)[scored.matched]
    same = scored.alone & np.isfinite(scored.step)
    alike = np.abs(contrast + scored.step) < SAME_STEP * np.maximum(contrast, np.abs(scored.step))
    # Of a saturated step less is seen than there is.
    same &= alike | ((segments.reasons[scored.matched] == "saturated") & (scored.step < 0))
    samples_px = (
        ends[scored.matched, :1]
        + np.linspace(0.1, 0.9, 9)[:, None] * directions[scored.matched, None]
    )
    column, row = np.rint(samples_px).astype(int).clip(0).transpose(2, 0, 1)
    height, width = picture.grey.shape
    slope = picture.shadow_slope[row.clip(max=height - 1), column.clip(max=width - 1)]
    same &= slope.max(axis=1, initial=0.0) < SHADOW_SHARE * contrast
    ratio = scored.ends_across.mean(axis=1) / sigma[scored.matched]
    return ratio[same], segments.reasons[scored.matched[same]]


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
    print("\nsegments per megapixel  " + "".join(f"{name:>9s}" for name in TIMED))
    for name, grey in pictures.items():
        grey = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        counts = "".join(f"{len(detect(grey)):9d}" for detect in TIMED.values())
        print(f"  {name:22s}{counts}")
    v, u = np.mgrid[:side, :side]
    board = 60 + 120 * (((u // 40) + (v // 40)) % 2)
    board = cv2.GaussianBlur(board.astype(np.float32), (0, 0), 0.8)
    board = np.clip(np.rint(board + rng.normal(0, 2, board.shape)), 0, 255).astype(np.uint8)
    for name, detect in DETECTORS.items():
        lines = detect(board)
        middle = (lines[:, :2] + lines[:, 2:]) / 2
        # Its lines run at 39.5, 79.5, ... along u and v.
        off = np.abs((middle - 19.5) % 40 - 20)
        false = off.min(axis=1) > 1.5
        print(f"  checkerboard, {name:14s}: {len(lines)} segments, {false.sum()} off its lines")


class Delivery(NamedTuple):
    """Light of both sides and of full white, and the conversion to grey levels of 0 to 255."""

    name: str
    dark: float
    bright: float
    delivered: Callable[[np.ndarray], np.ndarray]
    responses: tuple[ResponseLike, ...]


def _linear(light: np.ndarray) -> np.ndarray:
    return 255 * light


def _srgb(light: np.ndarray) -> np.ndarray:
    return 255 * SRGB().encode(np.minimum(light, 1.0))


def _sharpened(levels: np.ndarray, amount: float) -> np.ndarray:
    return levels + amount * (levels - cv2.GaussianBlur(levels, (0, 0), 1.0))


def deliveries() -> Iterator[Delivery]:
    """The conditions of the table in docs/segments.md."""
    both: tuple[ResponseLike, ...] = ("linear", "srgb")
    for dark, bright in ((0.2, 0.4), (0.4, 0.9), (0.05, 0.5), (0.02, 0.9)):
        yield Delivery("sRGB", dark, bright, _srgb, both)
    yield Delivery("sharpened by 1", 0.25, 0.6, lambda x: _sharpened(_linear(x), 1.0), ("linear",))
    for amount in (0.5, 1.0):
        yield Delivery(
            f"sRGB, sharpened by {amount:g}",
            0.05,
            0.5,
            lambda x, amount=amount: _sharpened(_srgb(x), amount),
            both,
        )
    for over in (1.1, 1.25, 1.5, 2.0, 3.0):
        yield Delivery("saturated", 0.2, 0.2 + 0.8 * over, _linear, ("linear",))
    for over in (1.25, 2.0):
        yield Delivery("sRGB, saturated", 0.05, 0.05 + 0.95 * over, _srgb, both)


def table_of_deliveries() -> None:
    """Print the mean shift toward the bright side, and the normalised errors."""
    print("\nSingle edges: shift toward the bright side; mean square of the normalised error")
    print("                        light of the sides  response     blur px: px (widths)")
    for delivery in deliveries():
        for response in delivery.responses:
            cells = []
            for blur in BLURS_PX:
                errors = np.array(list(_errors(delivery, blur, response)))
                width = np.sqrt(blur**2 + _PIXEL_VARIANCE)
                shift, square = errors[:, 0].mean(), np.mean(np.square(errors[:, 1]))
                cells.append(f"{blur}: {shift:+.3f} ({shift / width:+.2f}) {square:7.2f}")
            sides = f"{delivery.dark:.2f} {delivery.bright:.2f}"
            print(f"  {delivery.name:24s} {sides:12s} {response!s:8s} {'   '.join(cells)}")


def _errors(one: Delivery, blur_px: float, response: ResponseLike) -> Iterator[tuple[float, float]]:
    """(px, claimed sigmas) of each edge toward its bright side, at angles all round."""
    width = np.sqrt(blur_px**2 + _PIXEL_VARIANCE)
    v, u = np.mgrid[:SIDE_PX, :SIDE_PX].astype(float)
    for seed in range(EDGES):
        rng = np.random.default_rng(seed)
        angle = 2 * np.pi * (seed + rng.uniform()) / EDGES
        middle, normal = rng.uniform(29, 34, 2), np.array([np.cos(angle), np.sin(angle)])
        across = (u - middle[0]) * normal[0] + (v - middle[1]) * normal[1]
        light = one.dark + (one.bright - one.dark) * ndtr(across / width)
        levels = one.delivered(light) + rng.normal(0, NOISE, light.shape)
        segments = find_segments(
            np.clip(np.rint(levels), 0, 255).astype(np.uint8), response=response
        )
        if len(segments) == 0:
            continue
        longest = int(np.argmax(segments.length_px))
        half = np.concatenate([normal, normal]) / 2
        off = ((np.asarray(segments.endpoints_px)[longest] - middle) @ normal).mean()
        yield off, off / np.sqrt(half @ np.asarray(segments.covariance_px2)[longest] @ half)


def photograph_rows(folder: Path) -> None:
    print("\nphotographs: share of published segments found, 80 % of each within 1.5 px; share of")
    print("their length; px across (median); segments a picture; ms")
    sets: dict[str, list[Photograph]] = {}
    for photograph in photographs(folder):
        sets.setdefault(photograph.name, []).append(photograph)
    for (name, pictures), (detector, detect) in product(sets.items(), DETECTORS.items()):
        rows = [_photograph_row(picture, detect) for picture in pictures]
        is_found, length, all_length, across, counts, passed = zip(*rows, strict=True)
        print(
            f"  {name:12s} {len(pictures):3d} {detector:14s} {np.concatenate(is_found).mean():.3f}"
            f"  {sum(length) / sum(all_length):.3f}  {np.median(np.concatenate(across)):.3f}"
            f" {np.mean(counts):8.1f} {1e3 * np.median(passed):8.0f} ms"
        )


def _photograph_row(
    picture: Photograph, detect: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, float, float, np.ndarray, int, float]:
    begin = time.perf_counter()
    lines = detect(picture.grey)
    passed = time.perf_counter() - begin
    hit, _, length, across = covering(picture.published, lines)
    is_found = recall_of_published(picture, lines)
    across_px = np.abs(across[hit >= 0])
    return is_found, length[hit >= 0].sum(), length.sum(), across_px, len(lines), passed


def times() -> None:
    """Print times on bright boxes on a dark ground, equally many per area at every size."""
    print("\nms (peak MiB)   " + "".join(f"{name:>17s}" for name in TIMED) + "   trinoc / LSD")
    for width, height, repeats in ((512, 480, 21), (2048, 1920, 7), (6000, 4000, 3)):
        middle = _medians(_boxes(width, height), repeats)
        row = "".join(
            f"{middle[name]:9.1f} ({_peak_mib(name, width, height):5.0f})" for name in TIMED
        )
        print(f"  {width:4d} x {height:4d}   {row} {middle['trinoc'] / middle['LSD']:9.2f}")


def _medians(grey: np.ndarray, repeats: int) -> dict[str, float]:
    for detect in TIMED.values():
        detect(grey)
    passed: dict[str, list[float]] = {name: [] for name in TIMED}
    for _ in range(repeats):
        for name, detect in TIMED.items():
            begin = time.process_time()
            detect(grey)
            passed[name].append(1e3 * (time.process_time() - begin))
    return {name: float(np.median(milliseconds)) for name, milliseconds in passed.items()}


def _peak_mib(name: str, width: int, height: int) -> float:
    command = [sys.executable, __file__, "--peak", name, str(width), str(height)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def _grown_mib(name: str, width: int, height: int) -> float:
    """Growth of this process's peak memory by one call, after a call on a small picture, MiB."""
    TIMED[name](_boxes(64, 64))
    grey = _boxes(width, height)
    # The peak counts from here, not from the making of the picture (Linux, "5" in man 5 proc).
    Path("/proc/self/clear_refs").write_text("5")
    before = _peak_so_far_kib()
    TIMED[name](grey)
    return (_peak_so_far_kib() - before) / 1024


def _peak_so_far_kib() -> int:
    # Not getrusage, whose peak counts that of the parent process too.
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0])


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
    parser.add_argument("--peak", nargs=3, metavar=("DETECTOR", "WIDTH", "HEIGHT"))
    options = parser.parse_args()
    if options.peak:
        print(_grown_mib(options.peak[0], int(options.peak[1]), int(options.peak[2])))
        return
    if "FLD" not in DETECTORS:
        print("FLD and EDLines are not here: this cv2 has no ximgproc.")
    for folder in options.scenes:
        scenes(folder)
    nothing_to_find()
    table_of_deliveries()
    if options.photographs:
        photograph_rows(options.photographs)
    if not options.no_times:
        times()


if __name__ == "__main__":
    main()
