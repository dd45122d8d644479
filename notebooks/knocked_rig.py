# %% [markdown]
# # A knocked rig
#
# Somebody brushed against a camera. No sheet is at hand, but the rig still looks at a scene with
# straight edges. Do the edges still agree with the calibration, and if not, which camera moved?

# %%
import matplotlib.pyplot as plt
import numpy as np

import trinoc
from trinoc.cli.compile_cache import enable_compile_cache
from trinoc.geometry import Camera, Rig
from trinoc.io import demo_images
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
segments = {view: trinoc.find_segments(image) for view, image in demo_images("scene").items()}

# %% [markdown]
# ## The rig as it stands
# Matches of the scene are all that is needed for a small knock.

# %%
still = trinoc.check_rig(rig, trinoc.match_segments(segments, rig))
print(still.summary())

# %% [markdown]
# ## The camera on the left, turned by three hundredths of a degree
# The pictures stay; instead the rig file is wrong about that camera, which is the same.

# %%
left = rig["left"]
turned = Camera.from_degrees(
    left.intrinsics, pan_deg=left.pan_deg + 0.03, tilt_deg=left.tilt_deg,
    swing_deg=left.swing_deg, distance_mm=left.distance_mm,
)  # fmt: skip
cameras = {name: turned if name == "left" else camera for name, camera in rig.items()}
wrong = Rig(cameras, parameters=rig.parameters, covariance=rig.covariance)


knocked = trinoc.check_rig(wrong, trinoc.match_segments(segments, wrong))
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
mended = knocked.refined.rig
print(f"pan of left: {mended['left'].pan_deg:.3f} deg, by the sheet {left.pan_deg:.3f}")

# %% [markdown]
# Checks, run with the tests.

# %%
assert still.moved == ()
assert knocked.moved == ("left",)
assert abs(mended["left"].pan_deg - left.pan_deg) < 0.03
