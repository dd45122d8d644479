# %% [markdown]
# # From three pictures of a sheet to 3-D segments with error bars
#
# The rig has three fixed cameras: upper, left and right. Each camera took one picture of a printed
# sheet of circles, and later one picture of a table with blocks. This notebook
#
# 1. calibrates the cameras from the pictures of the sheet,
# 2. detects the straight edges in the pictures of the table,
# 3. matches them to segments in space,
# 4. compares the results with the truth.
#
# The truth is exact because the pictures are synthetic. They were rendered for the rig of Table 1 of
# Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular vision" (1986). The
# command `trinoc demo` runs the same steps.

# %%
import matplotlib.pyplot as plt
import numpy as np

import trinoc
from trinoc.io import enable_compile_cache
from trinoc.io import demo_pattern
from trinoc.io import demo_images
from trinoc.io import demo_truth
from trinoc.report import plot
from trinoc.report import parameter_errors
from trinoc.report import counts_text
from trinoc.report import errors_text
from trinoc.report import reasons_text
from trinoc.synth import table1_lens
from trinoc.synth import table1_rig
from trinoc.evaluation.scoring import score_lengths

enable_compile_cache()
plt.rcParams.update({"figure.dpi": 64, "savefig.bbox": "tight", "axes.titlesize": 10})


def make_axes(title):
    """Three axes side by side, one for each view."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
    figure.suptitle(title)
    return axes


# %% [markdown]
# ## Calibration
# The sheet has 64 circles and two crossed lines along X and Y. Some of the circles are rings. They
# show the orientation of the sheet. The lens is given: focal length 16 mm, pixels of
# 0.0162 x 0.0134 mm. The result has four parameters for each camera: pan, tilt, swing and the
# distance from the sheet's centre.
#
# By default `calibrate` assumes a typical error of the lens and of the print. In these synthetic
# pictures both are exact, so the next cell sets their sigmas to zero. It keeps the default sigmas
# for the flatness of the sheet and for the aim of the cameras.

# %%
sheets = demo_images("sheet")
typical = trinoc.Systematics.typical({})
exact_print = typical._replace(print_size_sigma=0.0, print_scale_sigma=(0.0, 0.0))
result = trinoc.calibrate(sheets, demo_pattern(), table1_lens(), systematics=exact_print)
print(result.summary())

# %% [markdown]
# The next table lists the error of each parameter and the normalised error, which is the error
# divided by its reported sigma. If the sigmas are correct, the normalised errors follow a standard
# normal distribution: about 95 % of them lie between -1.96 and 1.96.

# %%
errors = parameter_errors(result.rig, table1_rig())
print(errors_text(errors, "Table 1"))

# %% [markdown]
# The next figure shows the ellipse of every circle (blue), the cross lines (green) and the residual
# of each circle, magnified 5000 times (orange). Residuals should look random. A pattern in them
# means that the model of lens or sheet is wrong.

# %%
for axes, (view, fit) in zip(make_axes("residuals x 5000"), result.fits.items(), strict=True):
    plot.draw_detection(axes, sheets[view], fit, magnification=5000)
    axes.set_title(f"{view}: {fit.rms_px:.4f} px rms")
plt.show()

# %% [markdown]
# ## Segments
# `find_segments` uses the method of Nevatia and Babu: six edge masks, thinning, linking and
# polygonal approximation. It then fits a line with sub-pixel accuracy to each piece. Each segment
# has the covariance of its ends. The figure corresponds to figure 6 of the paper.

# %%
scenes = demo_images("scene")
segments = {view: trinoc.find_segments(image) for view, image in scenes.items()}

for axes, (view, view_segments) in zip(make_axes("segments"), segments.items(), strict=True):
    plot.draw_segments(axes, scenes[view], view_segments)
    axes.set_title(f"{view}: {len(view_segments)} segments")
plt.show()

# %% [markdown]
# ## Matching
# Matching has four steps:
#
# 1. The epipolar lines limit the positions of a corresponding segment in the other views.
# 2. A pair of segments predicts the position and direction of the segment in the third view.
# 3. Neighbouring segments decide between rival candidates.
# 4. Segments that are visible in two views only are matched last, near accepted triples.
#
# The figure corresponds to figure 7 of the paper. Each track has one colour in all three views.

# %%
matches = trinoc.match_segments(segments, result.rig)
print(counts_text(matches), "", reasons_text(matches), sep="\n")

for stage in ("trinocular", "binocular"):
    if (matches.stage == stage).any():
        for axes, view in zip(make_axes(stage), scenes, strict=True):
            plot.draw_tracks(axes, scenes[view], matches, view, stage)
            axes.set_title(view)
        plt.show()

# %% [markdown]
# ## Segments in space
# Each track is a 3-D segment with the 6 x 6 covariance of its two ends. Blue tracks are visible in
# three views, orange tracks in two.

# %%
figure = plt.figure(figsize=(11, 5), layout="constrained")
plot.draw_space(figure.add_subplot(1, 2, 1, projection="3d"), matches)
plot.draw_space(figure.add_subplot(1, 2, 2, projection="3d"), matches, result.rig)
plt.show()

# %% [markdown]
# ## Comparison with the truth
# - Precision is the share of the length of all tracks that lies within 1 mm of a true edge.
# - Recall is the share of the true length that lies within 1 mm of a track. It counts straight edges
#   that are visible in two or more views and whose two sides differ by at least 8 grey levels.

# %%
score = score_lengths(
    matches.lines_mm, demo_truth(), tolerance_mm=1.0, grey_step=8.0, kinds=("edge",)
)
print(f"precision {score.precision:.3f}, recall {score.recall:.3f}")

# %% [markdown]
# The tests of the project run these checks. Every parameter has an error below 0.005 degrees or
# 0.03 mm and below five of its sigmas. Precision is above 0.85 and recall above 0.6.

# %%
for error in errors:
    limit = 0.03 if error.parameter.endswith("_mm") else 0.005
    assert abs(error.error) < limit, error
    assert abs(error.over_sigma) < 5, error
assert all(fit.rms_px < 0.01 for fit in result.fits.values())
assert (matches.stage == "trinocular").sum() > 0
assert np.isfinite(matches.lines_mm).all()
assert score.precision > 0.85
assert score.recall > 0.6
