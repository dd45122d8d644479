# %% [markdown]
# # Accuracy of the measured shape
#
# Yokoi, Medioni and Nevatia (1986) matched the segments of three pictures to 3-D segments. They did
# not measure the accuracy of the shape, which errors of the segmentation reduce. In trinoc every
# segment has a covariance. This notebook uses scenes with known edges. It measures the errors and
# tests whether the reported sigmas are correct. The command `trinoc evaluate` does the same for any
# shape that you know.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import trinoc
from trinoc.io import enable_compile_cache
from trinoc import Rig
from trinoc.io import demo_images
from trinoc.io import demo_truth
from trinoc.report import plot
from trinoc.evaluation.lines_of_rig import independent_lines
from trinoc.evaluation.lines_of_rig import lines_of_rig
from trinoc.evaluation.distances import distance_to_segments_mm
from trinoc.evaluation.known_shape import KnownShape
from trinoc.evaluation.lines_on_edges import offsets_across
from trinoc.evaluation.lines_on_edges import select_lines
from trinoc.evaluation.normalised_errors import errors_in_sigmas
from simulation import Detector
from simulation import simulate_segments
from trinoc.synth.rigs import TABLE_1
from trinoc.synth import table1_lens
from trinoc.synth import table1_rig
from simulation import loose_segments

enable_compile_cache()
plt.rcParams.update({"figure.dpi": 64, "savefig.bbox": "tight", "axes.titlesize": 10})
rig, scene = table1_rig(), demo_images("scene")
shape = KnownShape.of_scene(demo_truth())

# %% [markdown]
# ## Distances
# The next cell uses the pictures of the demo and the exact cameras. For each tolerance it prints
#
# - precision: the share of the length of the measured lines that lies within the tolerance of an edge,
# - completeness: the share of the length of the straight edges visible in two or more pictures that
#   lies within the tolerance of a measured line.
#
# One pixel corresponds to about 0.5 mm on the table.

# %%
segments = {view: trinoc.find_segments(image) for view, image in scene.items()}
matches = trinoc.match_segments(segments, rig)
evaluation = trinoc.evaluate(matches, shape)
for tolerance_mm, precision, completeness in zip(
    evaluation.tolerances_mm, evaluation.precision, evaluation.completeness, strict=True
):
    print(f"within {tolerance_mm:4g} mm: precision {precision:.3f}, completeness {completeness:.3f}")
distance_mm, angle_deg = evaluation.distance_mm, evaluation.angle_deg
print(f"distance: median {distance_mm.median:.3f} mm, 90th percentile {distance_mm.at_90:.3f} mm")
print(f"angle: median {angle_deg.median:.2f} deg")

# %% [markdown]
# The next figure shows each track in the pictures. Its colour is the distance between its midpoint
# and the nearest true edge. Long edges that are visible in three views have errors of some
# hundredths of a millimetre.

# %%
midpoints_mm = matches.lines_mm.mean(axis=1)
errors_mm = distance_to_segments_mm(midpoints_mm, shape.edges_mm)
figure, axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
colours = plt.get_cmap("plasma")
for panel, (column, view) in zip(axes, enumerate(matches.views), strict=True):
    plot.draw_image(panel, scene[view], strength=0.3)
    panel.set_title(view)
    for fragment, error_mm in zip(matches.fragments_px[:, column], errors_mm, strict=True):
        colour = colours(np.clip((np.log10(error_mm) + 2.5) / 2.5, 0, 0.9))
        panel.plot(*fragment.T, color=colour, lw=2)
scale = plt.cm.ScalarMappable(plt.matplotlib.colors.LogNorm(10**-2.5, 1), colours)
figure.colorbar(scale, ax=axes, label="distance from the edge (mm)", shrink=0.8)
plt.show()

# %% [markdown]
# ## Are the sigmas correct?
# This test needs no pictures. It projects separate segments in space into the views, adds noise
# of known sigma, and matches them as usual. A measured line has four errors across its true edge: two
# directions at each of two ends. If the sigmas are correct, the normalised errors follow a standard
# normal distribution.
#
# The first test uses exact cameras. The next two use cameras with errors of 0.05 degrees and 0.5 mm
# (one sigma), as after a poor calibration. The covariance from the segments alone is then too small.
# You have to add the covariance of the rig. `lines_of_rig` does this, and `trinoc evaluate` uses it.

# %%
def normalised_errors(lines, edges_mm):
    """Normalised errors of the lines that lie on an edge, four for each line, as one array."""
    edge = trinoc.evaluate(lines, edges_mm, tolerances_mm=(2.0,)).lines
    on_edge = edge >= 0
    offsets = offsets_across(select_lines(lines, on_edge), edges_mm[edge[on_edge]])
    return errors_in_sigmas(offsets, lines.parameter_covariance).reshape(-1)


def lines_without_rig(matches):
    """Lines of the matches, with the covariance from the segments only."""
    return independent_lines(matches.lines_mm, matches.covariance_mm2)


edges = loose_segments(3, count=90, reach_mm=60.0)
noisy_segments, _ = simulate_segments(edges, rig, Detector(0.15, 0.0, 0.1, 0.1), seed=2)
sigma = np.tile([0.05, 0.05, 0.05, 0.5], 3)
camera_errors = sigma.reshape(3, 4) * np.random.default_rng(4).normal(size=(3, 4))
camera_parameters = np.array(list(TABLE_1.values())) + camera_errors
poor_rig = Rig(
    {
        view: trinoc.Camera.from_degrees(
            table1_lens(), pan_deg=p, tilt_deg=t, swing_deg=s, distance_mm=d
        )
        for view, (p, t, s, d) in zip(TABLE_1, camera_parameters.tolist(), strict=True)
    },
    parameters=[
        f"{view}.{name}" for view in TABLE_1
        for name in ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    ],
    covariance=np.diag(sigma**2),
)
exact_matches = trinoc.match_segments(noisy_segments, rig)
poor_matches = trinoc.match_segments(noisy_segments, poor_rig)
poor_lines = lines_of_rig(poor_matches, poor_rig)
image_lines = lines_without_rig(matches)
three_views = matches.stage == "trinocular"
errors = {
    "exact cameras": normalised_errors(lines_without_rig(exact_matches), edges.edges_mm),
    "poor cameras, without rig": normalised_errors(lines_without_rig(poor_matches), edges.edges_mm),
    "poor cameras, with rig": normalised_errors(poor_lines, edges.edges_mm),
    "pictures, three views": normalised_errors(
        select_lines(image_lines, three_views), shape.edges_mm
    ),
    "pictures, two views": normalised_errors(
        select_lines(image_lines, ~three_views), shape.edges_mm
    ),
}
within = {name: float(np.mean(np.abs(z) < 1.96)) for name, z in errors.items()}
for name, z in errors.items():
    print(f"{name:26s} {len(z):4d} errors, {within[name]:.3f} within 1.96 sigma")

figure, axes = plt.subplots(1, 5, figsize=(16, 3.2), layout="constrained", sharey=True)
grid = np.linspace(-5, 5, 201)
for panel, (name, z) in zip(axes, errors.items(), strict=True):
    panel.hist(np.clip(z, -5, 5), np.linspace(-5, 5, 41), density=True)
    panel.plot(grid, stats.norm.pdf(grid), "k", linewidth=1)
    panel.set_title(name)
    panel.set_xlabel("error / sigma")
plt.show()

# %% [markdown]
# For lines in three views the sigmas are correct: about 95 % of the errors are within 1.96 sigma. For
# lines in two views fewer errors are within it, for two reasons:
#
# - Two views always intersect in a line. No residual separates a wrong pair from a correct one with a
#   small error.
# - Some errors of an edge are not noise: a close neighbour, a shadow along the edge, or a curved rim.
#   They are similar in both views.
#
# Neither distribution is normal. Most lines have smaller errors than their sigmas predict, and a few
# have much larger ones.
#
# The tests of the project run these checks. The median error is below a tenth of a pixel. The test of
# the sigmas passes for correct covariances and fails for those that omit the rig.

# %%
assert evaluation.distance_mm.median < 0.04
assert evaluation.precision[-1] > 0.9
assert evaluation.completeness[-1] > 0.8
assert 0.9 < within["exact cameras"] < 0.98
assert within["poor cameras, without rig"] < 0.9
assert within["poor cameras, with rig"] > 0.9
