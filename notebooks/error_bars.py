# %% [markdown]
# # What the error bars mean
#
# A sigma is a promise: of many repetitions, 68 of 100 lie within one sigma of the truth and 95 within
# 1.96. Here the promise is kept: the same sheet is looked at many times, each time with fresh noise, and
# the scatter of the answers is compared with what each answer claims.

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np

import trinoc
from trinoc import Systematics, calibrate_points
from trinoc.geometry import project
from trinoc.io import enable_compile_cache
from trinoc.synth import table1_rig

enable_compile_cache()
plt.rcParams.update({"figure.dpi": 80, "savefig.bbox": "tight"})

camera = table1_rig()["upper"]
pattern = trinoc.Pattern.cross_grid(rows=5, columns=5, pitch_mm=20, radius_mm=6)
points = np.column_stack([pattern.centres_mm, np.zeros(len(pattern))])
with jax.enable_x64(True):
    seen = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, points))

# %% [markdown]
# ## Noise alone
# Thirty calibrations of one camera, each from the same 25 points with noise of 0.02 px, through
# a lens that is exact.

# %%
random, sigma_px = np.random.default_rng(7), 0.02
fits = [
    calibrate_points(
        points,
        seen + random.normal(scale=sigma_px, size=seen.shape),
        camera.intrinsics,
        pose_model="aimed",
        systematics=Systematics(),
    )
    for _ in range(30)
]
truth = {"pan_deg": camera.pan_deg, "tilt_deg": camera.tilt_deg, "distance_mm": camera.distance_mm}
for name, true in truth.items():
    found = np.array([getattr(fit.camera, name) for fit in fits])
    claimed = np.array([fit.sigma(name) for fit in fits])
    print(
        f"{name:12s} scatter {found.std(ddof=1):.5f}, claimed {claimed.mean():.5f}, within 1.96 "
        f"sigma {np.mean(np.abs(found - true) < 1.96 * claimed):.0%}"
    )

# %% [markdown]
# Each dot is one answer with its own bar; most bars cross the line of the truth.

# %%
distance = np.array([fit.camera.distance_mm for fit in fits])
sigma = np.array([fit.sigma("distance_mm") for fit in fits])
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.errorbar(range(len(fits)), distance - camera.distance_mm, 1.96 * sigma, fmt=".", linewidth=1)
axes.axhline(0, color="gray")
axes.set(xlabel="repetition", ylabel="distance off (mm)")
plt.show()

# %% [markdown]
# ## What no residual shows
# The sheet was printed .1 % too large. The residuals do not know it: a larger sheet farther away looks
# the same. Only a sigma that includes the size of the print covers the error. This is why
# `trinoc.calibrate` assumes .2 % when nothing is said, and why a report says what its sigmas include.

# %%
wrong = calibrate_points(points * 1.001, seen, camera.intrinsics, pose_model="aimed")
off = wrong.camera.distance_mm - camera.distance_mm
print(f"distance off by {off:.3f} mm, which is {off / np.mean(sigma):.0f} sigmas of the noise")
print(f"residuals: {np.sqrt(np.mean(np.square(wrong.residuals_px))):.6f} px rms")
print(f"sigma with a print known to .2 %: {0.002 * camera.distance_mm:.3f} mm")

# %% [markdown]
# Checks, run with the tests.

# %%
inside = np.mean(np.abs(distance - camera.distance_mm) < 1.96 * sigma)
assert 0.85 <= inside <= 1.0
assert 0.75 < distance.std(ddof=1) / sigma.mean() < 1.3
assert abs(off) < 2 * 0.002 * camera.distance_mm
