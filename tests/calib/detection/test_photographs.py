"""Detection in real photographs of circle grids, in the folder that TRINOC_DATA names."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from trinoc.calib import detect_pattern
from trinoc.calib.targets.pattern import Pattern

FOLDER = Path(os.environ.get("TRINOC_DATA", "")) / "circle_grids"
BOOFCV = Pattern.circle_grid(rows=8, columns=10, pitch_mm=25, radius_mm=7.5)
SQUARE = Pattern.circle_grid(rows=7, columns=7, pitch_mm=20, radius_mm=5)


def asymmetric(rows: int, columns: int) -> Pattern:
    return Pattern.asymmetric_circle_grid(rows=rows, columns=columns, spacing_mm=20, radius_mm=7)


PHOTOGRAPHS = {
    **{f"boofcv_image0000{k}.jpg": BOOFCV for k in range(6)},
    **{f"opencv_circles{k}.png": SQUARE for k in (1, 3, 5, 7, 9)},
    "opencv_acircles1.png": asymmetric(13, 7),
    "opencv_acircles4.png": asymmetric(5, 5),
    "opencv_acircles7.png": asymmetric(9, 3),
}


@pytest.mark.skipif("TRINOC_DATA" not in os.environ, reason="TRINOC_DATA names no folder of data")
@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_photograph(name):
    pattern = PHOTOGRAPHS[name]
    picture = cv2.imread(str(FOLDER / name), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    detection = detect_pattern(picture, pattern)
    assert len(detection) >= 0.9 * len(pattern)
    assert (detection.ambiguity is None) == name.startswith("opencv_acircles")
    # Neighbours on the sheet must be neighbours in the picture, whatever the lens.
    centres_px = np.full((len(pattern), 2), np.nan)
    centres_px[detection.circle_index] = detection.centres_px
    lattice_distance = np.abs(pattern.lattice[:, None] - pattern.lattice[None]).sum(axis=2)
    distance = np.linalg.norm(centres_px[:, None] - centres_px[None], axis=2)
    neighbours_px, thirds_px = distance[lattice_distance == 1], distance[lattice_distance == 3]
    assert np.nanmax(neighbours_px) < 2.5 * np.nanmin(neighbours_px)
    assert np.nanmedian(thirds_px) > 1.8 * np.nanmedian(neighbours_px)
