# %% [markdown]
# # A knocked rig
#
# Somebody brushed against a camera. No sheet is at hand, but the rig still looks at a scene with
# straight edges. Do the edges still agree with the calibration, and if not, which camera moved?

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

# The rig as a calibration would give it, with its sigmas; `trinoc.load_rig("rig.json")` for yours.
names = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
cameras = dict(table1_rig().items())
rig = Rig(
    cameras,
    parameters=[f"{camera}.{name}" for camera in cameras for name in names],
    covariance=np.diag(np.square(np.tile([0.001, 0.001, 0.001, 0.005], len(cameras)))),
)
# A made scene, so that the truth is known; `trinoc.find_segments(image)` for your pictures.
scene = block_scene(3, count=8)
segments, _ = simulate_segments(scene, rig, Detector(end_sigma_px=0.1), seed=1)
segments["left"]

# %% [markdown]
# ## The rig as it stands
# Matches of the scene are all that is needed for a small knock.

# %%
still = trinoc.check_rig(rig, trinoc.match_segments(segments, rig, sigma_px=0.1))
print(still.summary())

# %% [markdown]
# ## The camera on the left, carried round the scene by a fifth of a degree, 1.7 mm
# The pictures stay; instead the rig file is wrong about that camera, which is the same.

# %%
left = rig["left"]
turned = Camera.from_degrees(
    left.intrinsics, pan_deg=left.pan_deg + 0.2, tilt_deg=left.tilt_deg,
    swing_deg=left.swing_deg, distance_mm=left.distance_mm,
)  # fmt: skip
cameras = {name: turned if name == "left" else camera for name, camera in rig.items()}
wrong = Rig(cameras, parameters=rig.parameters, covariance=rig.covariance)


knocked = trinoc.check_rig(wrong, trinoc.match_segments(segments, wrong, sigma_px=0.1))
print(knocked.summary())

# %% [markdown]
# How many sigmas each camera would have moved, were it the only one.

# %%
figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
views = [motion.name for motion in knocked.motions]
places = np.arange(len(views))
axes.bar(places - 0.2, [motion.sigmas for motion in still.motions], 0.4, label="as calibrated")
axes.bar(places + 0.2, [motion.sigmas for motion in knocked.motions], 0.4, label="left knocked")
axes.axhline(3, color="gray", linestyle="--")
axes.set_xticks(places, views)
axes.set_ylabel("sigmas")
axes.legend()
plt.show()

# %% [markdown]
# ## Put right
# The scene says where the camera is now; `knocked.refined.rig` can be saved and used. For a large knock
# give `check_rig` ways to match again (`match_again=`), or run `trinoc check` on the pictures.

# %%
mended = knocked.refined.rig["left"]
lines = knocked.refined.lines
ends = np.concatenate([lines.ends_mm.reshape(-1, 3).T, np.ones((1, 2 * len(lines)))])


def off_px(camera):
    """How far from the truth a camera places the ends of the scene's lines in its picture, rms."""
    here, there = camera.matrix_px @ ends, left.matrix_px @ ends
    return np.sqrt(np.mean(np.sum(np.square(here[:2] / here[2] - there[:2] / there[2]), axis=0)))


print(f"before {off_px(turned):.3f} px off, after {off_px(mended):.3f} px")

# %% [markdown]
# Checks, run with the tests.

# %%
assert still.moved == ()
assert knocked.moved == ("left",)
assert off_px(mended) < 0.5 * off_px(turned)
