"""Errors of the refinement against the bound of its own picture, under conditions of benches.

    python benchmarks/calibration_conditions.py [--poses N] [--seeds K] [--wide] [--only NAME ...]

Every condition is a sheet, a blur, a number of free parameters, perhaps a card over a third of
the circles. Error and bound are of the same picture; the bound is that of `picture_bound`, which
knows the ray caster and not the model, at the true noise, and of the pixels that show the sheet
where part of it is covered. Per parameter: rms of error / bound. Then the rms of error / claimed
sigma, the share within 1.96 sigma, and the claimed sigma of a clean bound: sigma / bound.
"""

import argparse
from typing import NamedTuple

import jax
import numpy as np
from calibration import LENS, NOISE, SHEET, TRUE_NOISE, by_picture, difference, labelled, poses
from picture_bound import Scene, bound_of_image

from simulation.camera_picture.layers import cover_card
from trinoc.calib import detect_pattern
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import DetectionError
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.pose import PoseModel


class Condition(NamedTuple):
    pattern: Pattern = SHEET
    blur_px: float = 0.7
    parameters: int = 4
    covered: bool = False


def sheet(rings: str, style: str) -> Pattern:
    return Pattern.cross_grid(
        rows=5,
        columns=5,
        pitch_mm=20.0,
        radius_mm=6.0,
        rings=rings,  # pyright: ignore[reportArgumentType]
        line_style=style,
        line_half_length_mm=SHEET.line_half_length_mm,
    )


CONDITIONS = {
    "reference": Condition(),
    "blur 0.5 px": Condition(blur_px=0.5),
    "blur 1 px": Condition(blur_px=1.0),
    "blur 2 px": Condition(blur_px=2.0),
    "six parameters": Condition(parameters=6),
    "rings": Condition(pattern=sheet("code", "stop")),
    "a third covered": Condition(pattern=sheet("code", "stop"), covered=True),
    "lines through": Condition(pattern=sheet("none", "through")),
    "white in circles": Condition(pattern=sheet("none", "white")),
}


class Outcome(NamedTuple):
    error: np.ndarray
    sigma: np.ndarray
    bound: np.ndarray


def outcomes(condition: Condition, truths: np.ndarray, seeds: int) -> tuple[list[Outcome], int]:
    results, missed = [], 0
    for k, truth in enumerate(truths):
        random = np.random.default_rng([7, k])
        aim = random.uniform(-8.0, 8.0, 2) if condition.parameters == 6 else np.zeros(2)
        scene = Scene(condition.pattern, LENS, np.concatenate([truth, aim]), condition.blur_px)
        exact, is_visible = scene.picture(16), None
        if condition.covered:
            cover = cover_card(
                random.uniform(-25, 25, 2),
                turn_deg=random.uniform(0, 180),
                size_mm=(62.0, 54.0),
                grey=150.0,
            )
            uncovered_image, exact = exact, scene.picture(16, covers=(cover,))
            is_visible = np.abs(uncovered_image - exact) < 1e-6
        bound = bound_of_image(scene, TRUE_NOISE, condition.parameters, pixel_mask=is_visible)
        for seed in range(seeds):
            noise = np.random.default_rng([k, seed]).normal(0.0, NOISE, exact.shape)
            picture = np.rint(np.clip(exact + noise, 0, 255)).astype(np.uint8)
            outcome = one_outcome(condition, scene, picture, bound)
            missed += outcome is None
            if outcome is not None:
                results.append(outcome)
    return results, missed


def one_outcome(
    condition: Condition, scene: Scene, picture: np.ndarray, bound: np.ndarray
) -> Outcome | None:
    pattern, count = condition.pattern, condition.parameters
    centres = jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0))(
        scene.camera, pattern.centres_mm, pattern.radius_mm
    )
    try:
        detection = labelled(detect_pattern(picture, pattern), np.asarray(centres))
    except DetectionError:
        return None
    model = PoseModel.AIMED if count == PoseModel.AIMED.size else PoseModel.AIM_FREE
    refined = by_picture(picture, detection, pattern, model)
    if refined.fits["a"].image is None:
        return None
    error = difference(refined.values.copy(), scene.values[:count])
    return Outcome(error, np.sqrt(np.diag(refined.covariance)), bound)


def report(name: str, results: list[Outcome], missed: int) -> None:
    error, sigma, bound = (np.array(field) for field in zip(*results, strict=True))
    by_bound = np.sqrt(np.mean((error / bound) ** 2, axis=0))
    by_sigma = np.sqrt(np.mean((error / sigma) ** 2, axis=0))
    overall = np.sqrt(np.mean((error / bound) ** 2))
    inside = np.mean(np.abs(error / sigma) < 1.96)
    model = np.sqrt(np.mean((sigma / bound) ** 2))
    print(
        f"{name:17s} {len(results):4d} ({missed}) {overall:6.3f}  "
        + " ".join(f"{value:5.3f}" for value in by_bound)
        + " | "
        + " ".join(f"{value:5.3f}" for value in by_sigma)
        + f" | {inside:6.1%} {model:6.3f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--poses", type=int, default=14)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--wide", action="store_true")
    parser.add_argument("--only", nargs="*", default=list(CONDITIONS), choices=list(CONDITIONS))
    options = parser.parse_args()
    print("condition         pictures (missed)   all  error / bound per parameter | error / sigma")
    print("per parameter | within 1.96 sigma, claimed sigma / bound")
    with jax.enable_x64(True):
        for name in options.only:
            truths = poses(options.poses, options.wide, seed=1)
            report(name, *outcomes(CONDITIONS[name], truths, options.seeds))


if __name__ == "__main__":
    main()
