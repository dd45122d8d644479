# %% [markdown]
# # A new rig from your own pictures
#
# One picture of the printed sheet per camera, and the lens's data sheet: that is all a rig needs.
# Put the names of your files in the next cell; as it stands it takes the pictures that trinoc brings.

# %%
import matplotlib.pyplot as plt

import trinoc
from trinoc.io import enable_compile_cache
from trinoc.io import demo_paths, demo_pattern, read_views

enable_compile_cache()
plt.rcParams.update({"figure.dpi": 80, "savefig.bbox": "tight"})

files = demo_paths("sheet")  # {"upper": "upper.png", "left": "left.png", "right": "right.png"}
pattern = demo_pattern()  # trinoc.load_pattern("sheet.json")
images = read_views(files)
pattern

# %% [markdown]
# ## The lens
# Focal length and size of a pixel, from the data sheet of lens and camera. Nobody's lens is exactly
# what its data sheet says, so trinoc corrects it as far as the pictures tell, and lets the rest widen
# the sigmas. `trinoc intrinsics` calibrates it properly.

# %%
height, width = images["upper"].shape[:2]
lens = trinoc.Intrinsics(
    focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(width, height)
)

# %% [markdown]
# ## Calibrate
# What is said of the result comes with it: status, sigmas, and what the sigmas include.

# %%
result = trinoc.calibrate(images, pattern, lens)
result

# %% [markdown]
# Residuals should point anywhere. A swirl or a fan would be the lens, one side alone a bent sheet.

# %%
result.plot(images=images)
plt.show()

# %% [markdown]
# ## Where the cameras stand

# %%
result.rig.plot()
plt.show()

# %% [markdown]
# ## How well is a place known?
# One sigma of a point that all cameras see, along its worst direction. By a lens from its data sheet
# and an unmeasured print it is some tenths of a millimetre away from the middle. Measure the bars of
# the sheet, and calibrate the lens, and it falls to micrometres.

# %%
import numpy as np


def worst_sigma_mm(point_mm):
    covariance = trinoc.calib.point_covariance(result.rig, np.array(point_mm))
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


for place in ((0.0, 0.0, 0.0), (60.0, 60.0, 0.0), (0.0, 0.0, 60.0)):
    print(f"{place} mm: {worst_sigma_mm(place):.4f} mm")

# %% [markdown]
# `trinoc.save(result, "rig.json")` keeps it, with its covariance. Checks, run with the tests:

# %%
assert all(status.name == "CONVERGED" for status in result.status.values())
assert worst_sigma_mm((0.0, 0.0, 0.0)) < worst_sigma_mm((60.0, 60.0, 0.0)) < 1.0
assert result.to_frame()["sigma"].notna().all()
