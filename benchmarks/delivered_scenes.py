"""Effect of colour, exposure and JPEG on matching: scenes of coloured blocks, as delivered.

    python benchmarks/delivered_scenes.py FOLDER [--only WORD]

FOLDER holds scenes of `benchmarks/render_pictures.py colours`. Each row delivers the same light in
another way. Printed, over all scenes: precision (lines along shadows count as wrong) and recall of
length at 1 mm (edges of 8 grey levels), of edges that three views show and two, tracks in three
views of all, calibration error.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matching import _calibration_error as calibration_error
from matching_rendered import RenderedScene, score_scene
from shared_scenes import VIEWS

import trinoc
from simulation.camera_picture.delivery import SRGB, Processing, Sharpening
from simulation.camera_picture.render import delivered_picture
from simulation.camera_picture.sensor import Mosaic, Sensor
from trinoc.image.response import ResponseLike
from trinoc.io import load_scene_truth
from trinoc.io.rig_json import load_rig

# In light that is white to the camera the brightest face stays below saturation.
EXPOSURE = 1.2


class Delivery(NamedTuple):
    """Camera settings of a delivery; `exposures` and `balances` (red, green, blue) are per view."""

    name: str
    mosaic: Mosaic | None = None
    processing: Processing = Processing()
    exposures: tuple[float, ...] = (1.0, 1.0, 1.0)
    balances: tuple[tuple[float, float, float], ...] = ((1.0, 1.0, 1.0),) * 3
    response: ResponseLike = "linear"


_BAYER = Mosaic()
_UNLIKE = {
    "exposures": (1.0, 0.6, 1.3),
    "balances": ((1.0, 1.0, 1.0), (1.35, 1.0, 0.7), (0.75, 1.0, 1.3)),
}
DELIVERIES = (
    Delivery("grey, linear, 8 bits"),
    Delivery("grey, linear, 12 bits in 16", processing=Processing(bits=12)),
    Delivery("colour mosaic, bilinear", _BAYER),
    Delivery("colour mosaic, edge-aware", _BAYER, Processing(interpolation="edge-aware")),
    Delivery("mosaic, sRGB", _BAYER, Processing(response=SRGB()), response="srgb"),
    Delivery(
        "mosaic, sRGB, not told", _BAYER, Processing(response=SRGB()),
    ),
    Delivery(
        "sRGB, JPEG 90", _BAYER, Processing(response=SRGB(), jpeg_quality=90), response="srgb"
    ),
    Delivery(
        "sRGB, JPEG 60", _BAYER, Processing(response=SRGB(), jpeg_quality=60), response="srgb"
    ),
    Delivery(
        "sRGB, sharpened by .5, JPEG 90", _BAYER,
        Processing(response=SRGB(), sharpening=Sharpening(), jpeg_quality=90), response="srgb",
    ),
    Delivery("three unlike exposures and white balances", _BAYER, **_UNLIKE),
    Delivery(
        "these, sRGB, JPEG 90", _BAYER, Processing(response=SRGB(), jpeg_quality=90),
        response="srgb", **_UNLIKE,
    ),
)  # fmt: skip


def picture(light: np.ndarray, delivery: Delivery, view: int, *, seed: int) -> np.ndarray:
    """Picture that a camera delivers of (h, w, 3) light; 1 is a white face in full light."""
    tinted = light * np.array(delivery.balances[view])
    sensor = Sensor(
        exposure=EXPOSURE * delivery.exposures[view],
        read_levels=1.0,
        electrons_per_level=60.0,
        mosaic=delivery.mosaic,
    )
    if delivery.mosaic is None:
        signal = tinted.mean(axis=-1)
    else:
        rows, columns = (np.arange(side) % 2 for side in light.shape[:2])
        # Rows R G R G ... and G B G B ...
        channel = np.add.outer(rows, columns)[..., None]
        signal = np.take_along_axis(tinted, channel, axis=-1)[..., 0]
    return delivered_picture(signal, sensor, delivery.processing, seed=seed)


def of_delivery(delivery: Delivery, folders: list[Path]) -> str:
    """Row of one delivery: the figures over all scenes."""
    scores, views, outcomes, triples = [], np.zeros(4), [], 0
    for number, folder in enumerate(folders):
        pictures = {
            name: picture(_light(folder, name), delivery, view, seed=10 * number + view)
            for view, name in enumerate(VIEWS)
        }
        truth = load_scene_truth(folder / "truth.json")
        rig = load_rig(folder / "rig.json")
        scene = RenderedScene(folder.name, rig, truth, pictures, np.zeros((0, 3, 3)), None)
        segments = {
            name: trinoc.find_segments(image, response=delivery.response)
            for name, image in pictures.items()
        }
        matches = trinoc.match_segments(segments, rig)
        score, by_views, outcome = score_scene(scene, matches)
        scores.append(score)
        views += by_views
        outcomes += outcome
        triples += int((matches.stage == "trinocular").sum())
    precision, _, recall = np.mean(scores, axis=0)
    return (
        f"{precision:.3f}/{recall:.3f}, three views {views[0] / views[1]:.3f}, "
        f"two {views[2] / views[3]:.3f}, {triples} of {len(outcomes)} in three, "
        f"calibration error {calibration_error([(p, right) for p, right, _ in outcomes]):.3f}"
    )


def _light(folder: Path, view: str) -> np.ndarray:
    levels = cv2.imread(str(folder / f"light_{view}.png"), cv2.IMREAD_UNCHANGED)
    if levels is None:
        raise SystemExit(f"{folder} holds no light_{view}.png: render it with `colours`.")
    return levels[..., ::-1] / 65535.0


def main() -> None:
    """Print a row for each delivery."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="rows whose name holds this")
    options = parser.parse_args()
    trinoc.io.enable_compile_cache()
    folders = [path for path in sorted(options.folder.iterdir()) if (path / "truth.json").exists()]
    for delivery in DELIVERIES:
        if options.only in delivery.name:
            print(f"{delivery.name:45s} {of_delivery(delivery, folders)}", flush=True)


if __name__ == "__main__":
    main()
