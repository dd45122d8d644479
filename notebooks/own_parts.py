# %% [markdown]
# # Your own detector, cameras and boards
#
# The functions of trinoc take arrays. You can therefore use segments of another detector, cameras
# from another calibration tool, and points of another board.

# %%
import cv2
import jax
import matplotlib.pyplot as plt
import numpy as np

import trinoc
from trinoc.io import enable_compile_cache
from trinoc.geometry import project
from trinoc.io import demo_images
from trinoc.synth import table1_rig

enable_compile_cache()
plt.rcParams.update({"figure.dpi": 80, "savefig.bbox": "tight"})

scenes = demo_images("scene")

# %% [markdown]
# ## Cameras from another tool
# `Rig.from_matrices` takes 3 x 4 projection matrices in any unit of length. To read files of OpenCV,
# COLMAP, Kalibr and others, use `trinoc import`.

# %%
matrices = {name: camera.matrix_px for name, camera in table1_rig().items()}
rig = trinoc.Rig.from_matrices(matrices, image_size_px=(512, 480))
rig

# %% [markdown]
# ## Segments of another detector
# Pass an (n, 4) array of x1, y1, x2, y2 for each picture. This example uses the detector of OpenCV.
# (0, 0) is the centre of the top-left pixel, as in OpenCV. The cell keeps segments longer than 12 px.

# %%
detector = cv2.createLineSegmentDetector()
segments = {}
for name, image in scenes.items():
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    ends_px = detector.detect(grey)[0].reshape(-1, 4)
    length_px = np.linalg.norm(ends_px[:, 2:] - ends_px[:, :2], axis=1)
    segments[name] = ends_px[length_px > 12]
print({name: len(ends_px) for name, ends_px in segments.items()})

# %% [markdown]
# These segments have coordinates but no covariance. `sigma_px` therefore provides the standard
# deviation of their ends.

# %%
matches = trinoc.match_segments(segments, rig, sigma_px=0.5)
matches

# %%
figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
for panel, (name, image) in zip(axes, scenes.items(), strict=True):
    matches.plot(panel, view=name, image=image)
plt.show()

# %% [markdown]
# ## A board of your own
# `calibrate_points` takes the positions of the board points, their pixels from your detector, and the
# lens. It returns the camera. In this example lens and board are exact, so the cell passes
# `Systematics()`. Without it, the sigmas include the typical error of a lens from its data sheet.

# %%
grid = np.meshgrid(np.arange(9) * 25.0, np.arange(6) * 25.0, [0.0])
board_mm = np.stack(grid, -1).reshape(-1, 3)
board_mm -= board_mm.mean(axis=0)
camera = table1_rig()["left"]
with jax.enable_x64(True):
    corners_px = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, board_mm))
corners_px = corners_px + np.random.default_rng(1).normal(scale=0.05, size=corners_px.shape)
fit = trinoc.calibrate_points(
    board_mm,
    corners_px,
    camera.intrinsics,
    pose_model="aimed",
    systematics=trinoc.Systematics(),
)
noise_px = fit.fits["camera"].sigma_factor
print(f"pan {fit.camera.pan_deg:.4f} +- {fit.sigma('pan_deg'):.4f} deg, noise {noise_px:.3f} px")

# %% [markdown]
# The tests of the project run these checks.

# %%
assert (matches.stage == "trinocular").sum() >= 10
assert abs(fit.camera.pan_deg - camera.pan_deg) < 5 * fit.sigma("pan_deg")
assert 0.03 < noise_px < 0.07
