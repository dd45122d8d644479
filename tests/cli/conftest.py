"""Run commands in this process without the user's compile cache and without a trace."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

import trinoc
from simulation.camera_picture.render import render_sheet
from trinoc.io.compile_cache import COMPILE_CACHE_VARIABLE
from trinoc.synth import table1_rig

# Corners of a box, and pairs of corners that its edges join.
BOX_MM = np.array([[x, y, z] for x in (-30, 35) for y in (-25, 20) for z in (0, 30)], dtype=float)
EDGES = [(a, b) for a in range(8) for b in range(a) if (BOX_MM[a] != BOX_MM[b]).sum() == 1]


@pytest.fixture(scope="session")
def sheet_pictures() -> tuple[trinoc.Pattern, dict[str, np.ndarray]]:
    """A sheet, and an image of it by each camera of the reference rig."""
    pattern = trinoc.Pattern.cross_grid(rows=6, columns=6, pitch_mm=24.0, radius_mm=7.0)
    return pattern, {
        name: render_sheet(pattern, camera, supersampling=4, noise_sigma=1.0)
        for name, camera in table1_rig().items()
    }


@pytest.fixture(scope="module")
def sheet_and_box(sheet_pictures, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `sheet.json`, images of the sheet, and segments of a box as CSV."""
    folder = tmp_path_factory.mktemp("sheet")
    pattern, pictures = sheet_pictures
    trinoc.save(pattern, folder / "sheet.json")
    for name, camera in table1_rig().items():
        cv2.imwrite(str(folder / f"{name}.png"), pictures[name])
        ends = np.concatenate([BOX_MM, np.ones((8, 1))], axis=1) @ camera.matrix_px.T
        ends = (ends[:, :2] / ends[:, 2:])[np.array(EDGES)].reshape(-1, 4)
        np.savetxt(folder / f"{name}.csv", ends, delimiter=",")
    return folder


@pytest.fixture(autouse=True)
def _no_traces(monkeypatch):
    monkeypatch.setenv(COMPILE_CACHE_VARIABLE, "off")
    logger = logging.getLogger("trinoc")
    before = logger.handlers[:], logger.level, logger.propagate
    yield
    logger.handlers[:], logger.level, logger.propagate = before
