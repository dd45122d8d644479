# %% [markdown]
# # A knocked rig
#
# Somebody knocked against a camera after the calibration. You have no sheet at hand, but the rig still
# takes images of a scene with straight edges. This notebook tests whether the edges agree with the
# calibration. If they do not, it determines which camera has moved, and its new pose.

# %%
import matplotlib.pyplot as plt
import numpy as np

import trinoc
from trinoc.io import enable_compile_cache
from trinoc import Camera, Rig
from simulation import Detector, block_scene, simulate_segments
from trinoc.synth import table1_rig

enable_compile_cache()
plt.rcParams.update({"figure.dpi": 80, "savefig.bbox": "tight"})

# A rig with the covariance of a calibration. For your rig: `trinoc.load_rig("rig.json")`.
names = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
cameras = dict(table1_rig().items())
rig = Rig(
    cameras,
    parameters=[f"{camera}.{name}" for camera in cameras for name in names],
    covariance=np.diag(np.square(np.tile([0.001, 0.001, 0.001, 0.005], len(cameras)))),
)
# A synthetic scene, whose true edges are exact. For your images: `trinoc.find_segments(image)`.
scene = block_scene(3, count=8)
segments, _ = simulate_segments(scene, rig, Detector(end_sigma_px=0.1), seed=1)
segments["left"]

# %% [markdown]
# ## Before the knock
# `check_rig` needs only the matches of the scene to detect a small motion.

# %%
check_before = trinoc.check_rig(rig, trinoc.match_segments(segments, rig, sigma_px=0.1))
print(check_before.summary())

# %% [markdown]
# ## After the left camera has moved by 0.2 degrees of pan, 1.3 mm
# The next cell keeps the images and changes the pan of this camera in the rig. The disagreement
# between rig and images is the same as after a real motion.

# %%
left_camera = rig["left"]
turned_camera = Camera.from_degrees(
    left_camera.intrinsics, pan_deg=left_camera.pan_deg + 0.2, tilt_deg=left_camera.tilt_deg,
    swing_deg=left_camera.swing_deg, distance_mm=left_camera.distance_mm,
)  # fmt: skip
cameras = {name: turned_camera if name == "left" else camera for name, camera in rig.items()}
wrong_rig = Rig(cameras, parameters=rig.parameters, covariance=rig.covariance)


check_after = trinoc.check_rig(wrong_rig, trinoc.match_segments(segments, wrong_rig, sigma_px=0.1))
print(check_after.summary())

# %% [markdown]
# The chart compares both tests. Each bar is the significance of a camera's motion, in sigma, under the
# assumption that only this camera has moved.

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
views = [motion.name for motion in check_after.motions]
ticks = np.arange(len(views))
axes.bar(ticks - 0.2, [motion.sigmas for motion in check_before.motions], 0.4, label="before")
axes.bar(ticks + 0.2, [motion.sigmas for motion in check_after.motions], 0.4, label="after")
axes.axhline(3, color="gray", linestyle="--")
axes.set_xticks(ticks, views)
axes.set_ylabel("motion (sigma)")
axes.legend()
plt.show()

# %% [markdown]
# ## The corrected rig
# `check_after.refined.rig` contains the new pose of the camera. You can save and use it. A large motion
# also breaks the matching. Then pass matchers to `check_rig` (`match_again=`), or run `trinoc check` on
# the images.

# %%
corrected_camera = check_after.refined.rig["left"]
lines = check_after.refined.lines
ends = np.concatenate([lines.ends_mm.reshape(-1, 3).T, np.ones((1, 2 * len(lines)))])


def rms_error_px(camera):
    """Rms distance between the ends of the lines as projected by `camera` and by the true camera."""
    projected, true = camera.matrix_px @ ends, left_camera.matrix_px @ ends
    offset_px = projected[:2] / projected[2] - true[:2] / true[2]
    return np.sqrt(np.mean(np.sum(np.square(offset_px), axis=0)))


print(f"rms error before {rms_error_px(turned_camera):.3f} px, after {rms_error_px(corrected_camera):.3f} px")

# %% [markdown]
# The tests of the project run these checks.

# %%
assert check_before.moved == ()
assert check_after.moved == ("left",)
assert rms_error_px(corrected_camera) < 0.5 * rms_error_px(turned_camera)
