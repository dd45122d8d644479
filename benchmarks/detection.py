"""Detection of the sheet on pictures from a bench: rate, wrong labels, accuracy, time.

    [SUPERSAMPLING=16] python benchmarks/detection.py [--pictures N] [--only CONDITION ...]

Every condition renders N pictures of random poses with `simulation`, whose ray caster knows
nothing of the detector. A label is wrong when the circle lies more than a fifth of its own
size (at least 1.5 px) from where that circle's image is. `cv2.findCirclesGrid` runs on the
same pictures for its time; it is not made for rings and crossed lines, so its success is no
contest.
"""

import argparse
import sys
import time
from typing import NamedTuple

import cv2
import jax
import numpy as np
from detection_scenes import CONDITIONS, Scene

from trinoc.calib import detect_pattern
from trinoc.errors import DetectionError
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre


class Outcome(NamedTuple):
    is_detected: bool
    circles: int
    wrong: int
    error2_px2: float
    error_over_sigma2: float
    milliseconds: float
    opencv_milliseconds: float
    message: str


def truth(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    with jax.enable_x64(True):
        circles = scene.camera, scene.pattern.centres_mm, scene.pattern.radius_mm
        centres = np.asarray(jax.vmap(image_of_circle_centre, (None, 0, 0))(*circles))
        shapes = np.stack([shape_of_image(scene.camera, *circle) for circle in zip(*circles[1:])])
    return centres, shapes


def shape_of_image(camera: Camera, centre_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    """S of the ellipse (x - c)^T S^-1 (x - c) = 1, from the dual conic H C* H^T."""
    homography, centre = np.asarray(camera.matrix_px)[:, [0, 1, 3]], np.append(centre_mm, 1.0)
    circle = np.outer(centre, centre) - radius_mm**2 * np.diag([1.0, 1.0, 0.0])
    dual = homography @ circle @ homography.T / (homography @ circle @ homography.T)[2, 2]
    return np.outer(dual[:2, 2], dual[:2, 2]) - dual[:2, :2]


def run(scene: Scene) -> Outcome:
    picture = scene.picture
    start = time.perf_counter()
    try:
        detection, message = detect_pattern(picture, scene.pattern), ""
    except DetectionError as error:
        detection, message = None, str(error)
    milliseconds = 1e3 * (time.perf_counter() - start)
    start = time.perf_counter()
    eight_bit = picture if picture.dtype == np.uint8 else (picture / 257).astype(np.uint8)
    columns, rows = np.ptp(scene.pattern.lattice, axis=0) + 1
    cv2.findCirclesGrid(eight_bit, (int(columns), int(rows)))
    opencv = 1e3 * (time.perf_counter() - start)
    if detection is None:
        return Outcome(False, 0, 0, 0.0, 0.0, milliseconds, opencv, message)
    if scene.refused:
        return Outcome(True, len(detection), len(detection), 0.0, 0.0, milliseconds, opencv, "")
    centres, shapes = truth(scene)
    labellings = [detection.circle_index]
    if detection.ambiguity is not None:
        labellings += list(detection.ambiguity)
    offs = [detection.centres_px - centres[index] for index in labellings]
    off = min(offs, key=lambda offset: float(np.sum(offset**2)))
    size = np.sqrt(np.linalg.eigvalsh(shapes[labellings[0]])[:, 0])
    wrong = int(np.sum(np.linalg.norm(off, axis=1) > np.maximum(1.5, 0.2 * size)))
    scaled = np.einsum("ni,nij,nj->n", off, np.linalg.inv(detection.covariance_px2), off)
    return Outcome(
        True,
        len(detection),
        wrong,
        float(np.mean(off**2)),
        float(np.mean(scaled)) / 2,
        milliseconds,
        opencv,
        "",
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=100, help="of each condition")
    parser.add_argument("--only", nargs="*", choices=list(CONDITIONS), default=list(CONDITIONS))
    parser.add_argument("--messages", action="store_true", help="print why pictures were refused")
    arguments = parser.parse_args()
    print(
        f"{'condition':14}{'pictures':>9}{'found':>9}{'circles':>9}{'wrong':>7}"
        f"{'rms px':>9}{'err/sig':>9}{'ms':>8}{'cv2 ms':>8}"
    )
    wrong_labels = 0
    for name in arguments.only:
        outcomes = []
        for number in range(arguments.pictures):
            key = sum(map(ord, name))
            scene = CONDITIONS[name](np.random.default_rng([number, key]))
            outcomes.append(run(scene))
            if arguments.messages and (outcomes[-1].message or outcomes[-1].wrong):
                print(f"  {name} {number}: {outcomes[-1].wrong} wrong {outcomes[-1].message}")
        detected = [outcome for outcome in outcomes if outcome.is_detected]
        wrong = sum(outcome.wrong for outcome in outcomes)
        wrong_labels += wrong
        circles = np.mean([outcome.circles for outcome in detected]) if detected else 0.0
        rms = np.sqrt(np.median([o.error2_px2 for o in detected])) if detected else np.nan
        ratio = np.sqrt(np.median([o.error_over_sigma2 for o in detected])) if detected else np.nan
        print(
            f"{name:14}{len(outcomes):9}{len(detected):9}{circles:9.1f}{wrong:7}{rms:9.4f}{ratio:9.2f}"
            f"{np.median([o.milliseconds for o in outcomes]):8.1f}"
            f"{np.median([o.opencv_milliseconds for o in outcomes]):8.1f}",
            flush=True,
        )
    print(f"wrong labels: {wrong_labels}")
    return 1 if wrong_labels else 0


if __name__ == "__main__":
    sys.exit(main())
