"""The pictures of index.md and how-to.md: python docs/make_pictures.py"""

from pathlib import Path

import cv2
import numpy as np

import trinoc
from simulation.camera_picture.render import render_sheet
from trinoc import Camera, Pattern
from trinoc.io import demo_images, demo_pattern
from trinoc.match import wireframe
from trinoc.synth import table1_lens

FOLDER = Path(__file__).parent / "pictures"
PATTERN = Pattern.default()
GOOD = {"pan_deg": 20.0, "tilt_deg": 50.0, "swing_deg": 2.0, "distance_mm": 520.0}


def picture(noise: float = 2.0, **changed: float) -> np.ndarray:
    camera = Camera.from_degrees(table1_lens(), **(GOOD | changed))
    return render_sheet(PATTERN, camera, supersampling=4, noise_sigma=noise)


def examples() -> dict[str, np.ndarray]:
    good = picture()
    bright = np.clip(good.astype(float) * 1.9, 0, 255)
    dark = good.astype(float) * 0.12 + np.random.default_rng(1).normal(scale=2, size=good.shape)
    smear = np.zeros((1, 15))
    smear[:] = 1 / 15
    u, v = np.meshgrid(np.arange(good.shape[1]), np.arange(good.shape[0]))
    glare = 260 * np.exp(-((u - 300) ** 2 + (v - 190) ** 2) / 2600)
    return {
        "good": good,
        "far": picture(distance_mm=1500.0),
        "oblique": picture(tilt_deg=11.0),
        "unsharp": cv2.GaussianBlur(good, (0, 0), 5.0),
        "shaken": cv2.filter2D(good, -1, smear),
        "overexposed": bright,
        "dark": dark,
        "glare": np.clip(good + glare, 0, 255),
    }


def write_gallery() -> None:
    """Draw the results of the demo's pictures, as notebooks do."""
    import matplotlib as mpl

    mpl.use("agg")
    from matplotlib import pyplot as plt

    sheets, scenes = demo_images("sheet"), demo_images("scene")
    result = trinoc.calibrate(sheets, demo_pattern(), table1_lens())
    segments = {view: trinoc.find_segments(image) for view, image in scenes.items()}
    matches = trinoc.match_segments(segments, result.rig)
    drawn = {
        "sheet": lambda: result.pattern.plot(),
        "calibrated": lambda: result.plot(images=sheets),
        "segments": lambda: segments["upper"].plot(image=scenes["upper"]),
        "tracks": lambda: matches.plot(view="upper", image=scenes["upper"]),
        "space": lambda: matches.plot(rig=result.rig),
        "wireframe": lambda: wireframe(matches, result.rig).plot(),
    }
    for name, draw in drawn.items():
        drawing = np.atleast_1d(np.asarray(draw(), dtype=object)).ravel()[0]
        drawing.figure.savefig(
            FOLDER / f"{name}.png", dpi=70, bbox_inches="tight", facecolor="white"
        )
        plt.close("all")


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    write_gallery()
    for name, image in examples().items():
        small = np.clip(image, 0, 255).astype(np.uint8)
        cv2.imwrite(str(FOLDER / f"{name}.jpg"), small, [cv2.IMWRITE_JPEG_QUALITY, 70])
