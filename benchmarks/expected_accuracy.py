"""Expected accuracy of cameras and 3-D lines by distance, sheet and knowledge of the lens.

    python benchmarks/expected_accuracy.py [--distances-mm 500 1000 3000] [--paper a4]

Three cameras (1280 x 960 px, field of view 30 degrees) look at the sheet that `trinoc pattern
--camera` chooses for the distance, from 35 to 50 degrees above its plane. Rendered images, noise of
2 grey levels. Rows: the lens of the data sheet with an unmeasured print (the defaults of `trinoc
calibrate`); and a calibrated lens, assumed exact, with both scale bars measured.

Columns: size of the sheet; reported sigma of the distance of a camera and of its pan and tilt
(largest); sigma across the edges of a box on the sheet (median; segments with a sigma of .05 px)
from segment noise alone, and with the errors of the rig; relative sigma of the lengths of these
edges from the rig alone. The sigmas are those that trinoc reports; `calibration_conditions.py` and
`real_pictures.py` compare them with errors.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import trinoc
from simulation.camera_picture.render import render_sheet
from trinoc.calib.targets.printing import propose_sheet
from trinoc.geometry.camera import Camera
from trinoc.io.pattern_page import drawing_room_mm

SIZE_PX, FIELD_DEG, PITCH_MM = (1280, 960), 30.0, 0.004
# Pan and tilt of each camera.
AIMS_DEG = {"left": (-25.0, 50.0), "middle": (0.0, 35.0), "right": (25.0, 50.0)}
# Corners of a unit box on the sheet, and its edges.
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], dtype=float)
EDGES = np.array(
    [(a, b) for a in range(8) for b in range(a) if (CORNERS[a] != CORNERS[b]).sum() == 1]
)
SEGMENT_SIGMA_PX = 0.05
# Half the width of the box over the distance of the cameras.
BOX_SIZE = 0.08


def make_cameras(distance_mm: float) -> tuple[trinoc.Intrinsics, dict[str, Camera]]:
    """The lens and the three cameras at a distance from the sheet."""
    focal_length_mm = SIZE_PX[0] * PITCH_MM / 2 / np.tan(np.radians(FIELD_DEG / 2))
    lens = trinoc.Intrinsics(
        focal_length_mm=float(focal_length_mm),
        pixel_pitch_mm=(PITCH_MM, PITCH_MM),
        image_size_px=SIZE_PX,
    )
    cameras = {
        name: Camera.from_degrees(
            lens, pan_deg=pan_deg, tilt_deg=tilt_deg, swing_deg=0.0, distance_mm=distance_mm
        )
        for name, (pan_deg, tilt_deg) in AIMS_DEG.items()
    }
    return lens, cameras


def make_sheet(distance_mm: float, paper: Any) -> trinoc.Pattern:
    """The sheet that `trinoc pattern --camera` chooses."""
    width_mm = 2 * distance_mm * np.tan(np.radians(FIELD_DEG / 2))
    proposal = propose_sheet(
        field_mm=(width_mm, width_mm * SIZE_PX[1] / SIZE_PX[0]),
        size_px=SIZE_PX,
        room_mm=drawing_room_mm(paper),
    )
    return trinoc.Pattern.cross_grid(
        rows=proposal.count,
        columns=proposal.count,
        pitch_mm=proposal.pitch_mm,
        radius_mm=proposal.radius_mm,
    )


def match_box(cameras: dict[str, Camera], rig: trinoc.Rig, size_mm: float) -> trinoc.Matches:
    """Matches of the edges of a box, with noise, and their covariances by segments and by rig."""
    generator = np.random.default_rng(1)
    corners_mm = np.c_[CORNERS * size_mm, np.ones(8)]
    segments = {}
    for name, camera in cameras.items():
        corners_px = corners_mm @ np.asarray(camera.matrix_px).T
        ends_px = (corners_px[:, :2] / corners_px[:, 2:])[EDGES]
        segments[name] = ends_px + generator.normal(0, SEGMENT_SIGMA_PX, ends_px.shape)
    matches = trinoc.match_segments(segments, rig, sigma_px=SEGMENT_SIGMA_PX)
    return trinoc.with_rig_covariance(matches, rig)


def across_mm(lines_mm: np.ndarray, covariance_mm2: np.ndarray) -> float:
    """Median sigma of the first end of lines (t, 2, 3) across the line, from (t, 6, 6)."""
    direction = lines_mm[:, 1] - lines_mm[:, 0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    of_end = across @ covariance_mm2[:, :3, :3] @ across
    return float(np.median(np.sqrt(np.trace(of_end, axis1=1, axis2=2) / 2)))


def relative_length_sigma(lines_mm: np.ndarray, covariance_mm2: np.ndarray) -> float:
    """Median of sigma over length, from the covariance of both ends."""
    direction = lines_mm[:, 1] - lines_mm[:, 0]
    length_mm = np.linalg.norm(direction, axis=1)
    gradient = np.concatenate([-direction, direction], axis=1) / length_mm[:, None]
    variance = np.einsum("ti,tij,tj->t", gradient, covariance_mm2, gradient)
    return float(np.median(np.sqrt(variance) / length_mm))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--distances-mm", type=float, nargs="+", default=[500.0, 1000.0, 3000.0])
    parser.add_argument("--paper", default="a4")
    options = parser.parse_args()
    print(f"{'':36}{'sigma of':>20}{'sigma across lines mm':>28}{'relative sigma':>17}")
    print(
        f"{'distance':>9}{'sheet mm':>10} {'lens and print':16}{'distance mm':>12}{'angle deg':>10}"
        f"{'segments':>12}{'with rig':>13}{'of length':>17}"
    )
    for distance_mm in options.distances_mm:
        sheet = make_sheet(distance_mm, options.paper)
        lens, cameras = make_cameras(distance_mm)
        images = {
            name: render_sheet(sheet, camera, noise_sigma=2.0, seed=seed, supersampling=8)
            for seed, (name, camera) in enumerate(cameras.items())
        }
        typical = trinoc.Systematics.typical(dict.fromkeys(cameras, lens))
        measured = typical._replace(
            lens_covariance=None, print_scale_sigma=(0.0005, 0.0005), print_size_sigma=0.0
        )
        size_mm = float(np.ptp(np.asarray(sheet.centres_mm), axis=0).max() + 2 * sheet.radius_mm[0])
        for knowledge, systematics in (("data sheet", typical), ("calibrated", measured)):
            result = trinoc.calibrate(images, sheet, lens, systematics=systematics)
            with tempfile.TemporaryDirectory() as folder:
                trinoc.save(result, Path(folder, "rig.json"))
                rig = trinoc.load_rig(Path(folder, "rig.json"))
            matches = match_box(cameras, rig, BOX_SIZE * distance_mm)
            lines_mm, noise_mm2, rig_mm2 = map(
                np.asarray, (matches.lines_mm, matches.covariance_mm2, matches.rig_covariance_mm2)
            )
            sigmas = {name: result.sigma(name) for name in result.parameters}
            largest = {
                unit: max(s for name, s in sigmas.items() if any(part in name for part in parts))
                for unit, parts in (("mm", ("distance",)), ("deg", ("pan", "tilt")))
            }
            print(
                f"{distance_mm:9.0f}{size_mm:10.0f} {knowledge:16}"
                f"{largest['mm']:12.2f}{largest['deg']:10.4f}"
                f"{across_mm(lines_mm, noise_mm2):12.4f}"
                f"{across_mm(lines_mm, noise_mm2 + rig_mm2):13.4f}"
                f"{relative_length_sigma(lines_mm, rig_mm2):17.5f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
