# %% [markdown]
# # What the error bars mean
#
# A sigma states a frequency: in 68 of 100 repetitions the error is at most one sigma, and in 95 of 100 at
# most 1.96 sigma. This notebook tests that. It calibrates one camera many times, each time with new noise,
# and compares the scatter of the results with their reported sigmas.

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
points_mm = np.column_stack([pattern.centres_mm, np.zeros(len(pattern))])
with jax.enable_x64(True):
    exact_px = np.asarray(jax.vmap(project, in_axes=(None, 0))(camera, points_mm))

# %% [markdown]
# ## Noise alone
# The next cell calibrates one camera thirty times. Each time it uses the same 25 points with new noise of
# 0.02 px in each coordinate. The lens is exact.

# %%
random, noise_px = np.random.default_rng(7), 0.02
fits = [
    calibrate_points(
        points_mm,
        exact_px + random.normal(scale=noise_px, size=exact_px.shape),
        camera.intrinsics,
        pose_model="aimed",
        systematics=Systematics(),
    )
    for _ in range(30)
]
truth = {"pan_deg": camera.pan_deg, "tilt_deg": camera.tilt_deg, "distance_mm": camera.distance_mm}
for name, true_value in truth.items():
    estimates = np.array([getattr(fit.camera, name) for fit in fits])
    sigmas = np.array([fit.sigma(name) for fit in fits])
    print(
        f"{name:12s} scatter {estimates.std(ddof=1):.5f}, mean sigma {sigmas.mean():.5f}, within 1.96 "
        f"sigma {np.mean(np.abs(estimates - true_value) < 1.96 * sigmas):.0%}"
    )

# %% [markdown]
# Each dot is the error of one estimate of the distance. Its bar is 1.96 sigma long on each side. Most bars
# cross the line of zero error.

# %%
distances_mm = np.array([fit.camera.distance_mm for fit in fits])
sigmas_mm = np.array([fit.sigma("distance_mm") for fit in fits])
errors_mm = distances_mm - camera.distance_mm
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.errorbar(range(len(fits)), errors_mm, 1.96 * sigmas_mm, fmt=".", linewidth=1)
axes.axhline(0, color="gray")
axes.set(xlabel="repetition", ylabel="error of the distance (mm)")
plt.show()

# %% [markdown]
# ## An error that no residual shows
# Assume that the sheet was printed 0.1 % too large. A larger sheet farther away gives the same image, so
# the residuals do not change. Only a sigma that includes the size of the print covers this error.
# `trinoc.calibrate` therefore assumes a sigma of 0.2 % for the size unless you provide another one. The
# summary of a result lists what its sigmas include.

# %%
scaled = calibrate_points(points_mm * 1.001, exact_px, camera.intrinsics, pose_model="aimed")
error_mm = scaled.camera.distance_mm - camera.distance_mm
print(f"error of the distance {error_mm:.3f} mm: {error_mm / np.mean(sigmas_mm):.0f} sigma of the noise")
residuals_px = scaled.fits["camera"].residuals_px
print(f"residuals: {np.sqrt(np.mean(np.square(residuals_px))):.6f} px rms")
print(f"sigma for a print size of 0.2 % sigma: {0.002 * camera.distance_mm:.3f} mm")

# %% [markdown]
# The tests of the project run these checks.

# %%
share_within = np.mean(np.abs(errors_mm) < 1.96 * sigmas_mm)
assert 0.85 <= share_within <= 1.0
assert 0.75 < distances_mm.std(ddof=1) / sigmas_mm.mean() < 1.3
assert abs(error_mm) < 2 * 0.002 * camera.distance_mm
assert len(residuals_px) == len(points_mm) and np.abs(residuals_px).max() < 1e-3
