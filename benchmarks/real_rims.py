"""Rims on photographs: a plate of 100 known circles, and walls without circles.

    TRINOC_DATA=DIR python benchmarks/real_rims.py [--shots N] [--merton]

DIR holds stereo_circle_plate: shots of a plate of 10 x 10 dark circles at 30 mm, by two cameras.
Each shot is calibrated by the plate, so that the plate is the plane z = 0 and its circles have
known centres; then `find_rims` is asked for circles in space, and told nothing of the plate.
With --merton also vgg_merton1, photographs of a college building, whose only round things are
the arches over two doors, at (1.2, -0.1, 5.6) and (1.0, 1.2, 0.1). Printed per shot:

found      rims that lie on a circle of the plate, each circle once
wrong      other rims
ambiguous  rims not put out, since another circle explains one of the views as well
centre     median distance of their centres from those of the plate, mm; in its plane, and from it
z          rms of those distances over their standard deviations, all three axes
radius     median, and median absolute deviation, mm
turned     median angle between their planes and the plate, degrees
"""

import argparse
import os
import time
from pathlib import Path

import cv2
import numpy as np
from real_rig import CAMERAS, measured_radius_mm, pictures, plate

import trinoc
from trinoc.geometry.rig import Rig
from trinoc.match import Rims

AMBIGUOUS = "rims of two views that fit another as well"


def of_plate(name: str, rims: Rims, centres_mm: np.ndarray, radius_mm: float) -> None:
    off = rims.centre_mm[:, None] - np.append(centres_mm, np.zeros((len(centres_mm), 1)), axis=1)
    nearest = np.linalg.norm(off, axis=2).argmin(axis=1)
    error = off[np.arange(len(rims)), nearest]
    right = np.linalg.norm(error, axis=1) < radius_mm / 2
    sigma = np.sqrt(np.diagonal(rims.covariance_mm2, axis1=1, axis2=2)[:, :3])
    radius = rims.radius_mm[right]
    turned = np.degrees(np.arccos(np.abs(rims.normal[right, 2]).clip(0, 1)))
    print(
        f"{name:18s} found {len(np.unique(nearest[right])):3d}  wrong {int((~right).sum()):2d}"
        f"  ambiguous {rims.counts[AMBIGUOUS]:2d}",
        end="\n" if not right.any() else "",
    )
    if not right.any():
        return
    print(
        f"  centre {np.median(np.linalg.norm(error[right, :2], axis=1)):.3f}"
        f" {np.median(np.abs(error[right, 2])):.3f}"
        f"  z {np.sqrt(np.mean((error[right] / sigma[right]) ** 2)):.2f}"
        f"  radius {np.median(radius):.3f} ± {np.median(np.abs(radius - np.median(radius))):.3f}"
        f"  turned {np.median(turned):.2f}"
    )


def rims_of(views: dict[str, np.ndarray], rig: Rig) -> tuple[Rims, float]:
    """Rims of the views, and the processor time in seconds."""
    chords = {view: trinoc.find_segments(image, arcs=True) for view, image in views.items()}
    matches = trinoc.match_segments(chords, rig)
    start = time.process_time()
    return trinoc.match.find_rims(matches, chords, rig), time.process_time() - start


def plates(folder: Path, shots: int) -> None:
    images = {camera: pictures(folder, camera, shots) for camera in CAMERAS}
    radius_mm = measured_radius_mm(images["left"][0])
    sheet = plate(radius_mm)
    print(f"radius by area {radius_mm:.3f} mm")
    lenses = {}
    for camera, camera_images in images.items():
        lens = trinoc.calibrate_intrinsics(camera_images, sheet).lens
        assert lens is not None
        lenses[camera] = lens
    for number, pair in enumerate(zip(*images.values(), strict=True)):
        views: dict[str, np.ndarray] = dict(zip(CAMERAS, pair, strict=True))
        systematics = trinoc.Systematics(aim_sigma_mm=1000.0)
        rig = trinoc.calibrate(
            views, sheet, lenses, systematics=systematics, orientation="upright"
        ).rig
        rims, seconds = rims_of(views, rig)
        of_plate(f"shot {number} ({seconds:.1f} s)", rims, sheet.centres_mm, radius_mm)


def merton(folder: Path) -> None:
    cameras = np.load(folder / "merton1.npz")["projection"]
    files = {f"view{k}": str(folder / f"view{k}.jpg") for k in range(len(cameras))}
    views = {view: np.asarray(cv2.imread(file, 0)) for view, file in files.items()}
    rig = Rig.from_matrices(dict(zip(views, cameras, strict=True)), image_size_px=(1024, 768))
    rims, seconds = rims_of(views, rig)
    print(f"Merton College ({seconds:.1f} s): {len(rims)} at {rims.centre_mm.round(1).tolist()}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shots", type=int, default=6)
    parser.add_argument("--merton", action="store_true")
    options = parser.parse_args()
    data = Path(os.environ["TRINOC_DATA"])
    plates(data / "stereo_circle_plate", options.shots)
    if options.merton:
        merton(data / "vgg_merton1")


if __name__ == "__main__":
    main()
