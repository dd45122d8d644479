# %% [markdown]
# # Your own detector, cameras and boards
#
# Each part of trinoc takes arrays, so each can be replaced: segments of another detector, cameras that
# another tool calibrated, points of another board.

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
# ## Cameras from anywhere
# Any 3 x 4 projection matrices, in any unit. (`trinoc import` reads files of OpenCV, COLMAP, Kalibr and
# others.)

# %%
matrices = {name: camera.matrix_px for name, camera in table1_rig().items()}
rig = trinoc.Rig.from_matrices(matrices, image_size_px=(512, 480))
rig

# %% [markdown]
# ## Segments from anywhere
# An (n, 4) array x1 y1 x2 y2 for each picture. Here OpenCV's own detector, as its users call it; pixel
# (0, 0) is the centre of the first pixel, as in OpenCV.

# %%
detector = cv2.createLineSegmentDetector()
segments = {}
for name, image in scenes.items():
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found = detector.detect(grey)[0].reshape(-1, 4)
    segments[name] = found[np.linalg.norm(found[:, 2:] - found[:, :2], axis=1) > 12]
print({name: len(found) for name, found in segments.items()})

# %% [markdown]
# Of these nothing is known but where they are: `sigma_px` says how well.

# %%
matches = trinoc.match_segments(segments, rig, sigma_px=0.5)
matches

# %%
figure, axes = plt.subplots(1, 3, figsize=(12, 4), layout="constrained")
for one, (name, image) in zip(axes, scenes.items(), strict=True):
    matches.plot(one, view=name, image=image)
plt.show()

# %% [markdown]
# ## A board of your own
# Points with known places, found in the picture by your own code: the camera, with its lens. Here
# lens and board are exact, which `Systematics()` says; without it the sigmas include what a data
# sheet leaves open.

# %%
board = np.stack(np.meshgrid(np.arange(9) * 25.0, np.arange(6) * 25.0, [0.0]), -1).reshape(-1, 3)
board -= board.mean(axis=0)
camera = table1_rig()["left"]
with jax.enable_x64(True):
    corners = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, board))
corners = corners + np.random.default_rng(1).normal(scale=0.05, size=corners.shape)
exact = trinoc.Systematics()
fit = trinoc.calibrate_points(
    board, corners, camera.intrinsics, pose_model="aimed", systematics=exact
)
noise_px = fit.fits["camera"].sigma_factor
print(f"pan {fit.camera.pan_deg:.4f} +- {fit.sigma('pan_deg'):.4f} deg, noise {noise_px:.3f} px")

# %% [markdown]
# Checks, run with the tests.

# %%
assert (matches.stage == "trinocular").sum() >= 10
assert abs(fit.camera.pan_deg - camera.pan_deg) < 5 * fit.sigma("pan_deg")
assert 0.03 < noise_px < 0.07
