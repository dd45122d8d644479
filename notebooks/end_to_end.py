# %% [markdown]
# # From three pictures of a sheet to 3-D segments with error bars
#
# Three fixed cameras, upper, left and right, each took one picture of a printed sheet of
# circles, and later one picture of a table with blocks. This notebook calibrates the cameras
# from the first three pictures, finds the straight edges in the other three, matches them, and
# compares everything with what is known: the pictures were made on a computer for the rig of
# Table 1 of Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
# vision" (1986). The command `trinoc demo` does the same in one line.

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


def three(title):
    """Three axes side by side, one for each view."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
    figure.suptitle(title)
    return axes


# %% [markdown]
# ## Calibration
# The sheet has 64 circles, some of them rings that tell which way up it lies, and two crossed
# lines along X and Y. The lens is known: 16 mm, pixels of 0.0162 x 0.0134 mm. Four numbers are
# left for each camera: pan, tilt, swing and the distance from the sheet's centre.
#
# These pictures were made, so that lens and print are exactly what is said of them; real ones are
# not, and without a word `calibrate` allows for that. What it assumes of the flatness of the sheet
# and of the aim is left as usual.

# %%
sheets = demo_images("sheet")
usual = trinoc.Systematics.typical({})
known = usual._replace(print_size_sigma=0.0, print_scale_sigma=(0.0, 0.0))
result = trinoc.calibrate(sheets, demo_pattern(), table1_lens(), systematics=known)
print(result.summary())

# %% [markdown]
# The errors against the truth, and those errors in units of the sigma that the fit claims. If
# the sigmas are honest, the last column holds numbers like those of a normal distribution.

# %%
errors = parameter_errors(result.rig, table1_rig())
print(errors_text(errors, "Table 1"))

# %% [markdown]
# What was found: the ellipse of every circle (blue), the cross lines (green), and the residual
# of each circle, drawn 5000 times as long (orange). Residuals should look random: a pattern in
# them would mean that the model is wrong.

# %%
for axes, (view, fit) in zip(three("residuals x 5000"), result.fits.items(), strict=True):
    plot.draw_detection(axes, sheets[view], fit, magnification=5000)
    axes.set_title(f"{view}: {fit.rms_px:.4f} px rms")
plt.show()

# %% [markdown]
# ## Segments
# Six edge masks, thinning, linking and polygonal approximation, as Nevatia and Babu have it,
# then a sub-pixel line through each piece: the paper's figure 6. Each segment carries the
# covariance of its ends.

# %%
scenes = demo_images("scene")
segments = {view: trinoc.find_segments(picture) for view, picture in scenes.items()}

for axes, (view, found) in zip(three("segments"), segments.items(), strict=True):
    plot.draw_segments(axes, scenes[view], found)
    axes.set_title(f"{view}: {len(found)} segments")
plt.show()

# %% [markdown]
# ## Matching
# The epipolar lines restrict where a segment can lie in the other views; a pair predicts place
# and direction in the third; neighbours decide between rivals; what only two views see is
# matched last, next to accepted triples. The paper's figure 7: each track has one colour in all
# three views.

# %%
matches = trinoc.match_segments(segments, result.rig)
print(counts_text(matches), "", reasons_text(matches), sep="\n")

for stage in ("trinocular", "binocular"):
    if (matches.stage == stage).any():
        for axes, view in zip(three(stage), scenes, strict=True):
            plot.draw_tracks(axes, scenes[view], matches, view, stage)
            axes.set_title(view)
        plt.show()

# %% [markdown]
# ## In space
# Each track is a 3-D segment with a 6 x 6 covariance of its two ends: how well an edge is known
# is part of the answer. Blue: seen in three views; orange: in two.

# %%
figure = plt.figure(figsize=(11, 5), layout="constrained")
plot.draw_space(figure.add_subplot(1, 2, 1, projection="3d"), matches)
plot.draw_space(figure.add_subplot(1, 2, 2, projection="3d"), matches, result.rig)
plt.show()

# %% [markdown]
# ## Against the truth
# Precision: the share of the length put out that lies within 1 mm of a true edge. Recall: the
# share that was found of the straight edges that two pictures or more show, with grey levels that
# differ by at least 8 across them.

# %%
score = score_lengths(
    matches.lines_mm, demo_truth(), tolerance_mm=1.0, grey_step=8.0, kinds=("edge",)
)
print(f"precision {score.precision:.3f}, recall {score.recall:.3f}")

# %% [markdown]
# Checks, run with the tests: every parameter within 0.005 deg or 0.03 mm of Table 1 and within
# five of its own sigmas; most of what is put out is right.

# %%
for found in errors:
    aim = 0.03 if found.parameter.endswith("_mm") else 0.005
    assert abs(found.error) < aim, found
    assert abs(found.over_sigma) < 5, found
assert all(fit.rms_px < 0.01 for fit in result.fits.values())
assert (matches.stage == "trinocular").sum() > 0
assert np.isfinite(matches.lines_mm).all()
assert score.precision > 0.85
assert score.recall > 0.6
