# %% [markdown]
# # How accurate is the shape that segments give?
#
# Yokoi, Medioni and Nevatia (1986) matched segments of three pictures into 3-D segments, and left
# open how accurate the shape is, since segmentation degrades it. Here every segment has a
# covariance, and scenes are known. This notebook measures the errors, and tests whether the sigmas
# are true. The command `trinoc evaluate` does the same for any shape that you know.

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
# The demo's pictures, with the cameras known exactly. Precision is the share of the length put out
# that lies within a distance of an edge, completeness the share of the straight edges that two
# pictures show which lies within it of a line. A pixel is about half a millimetre on the table.

# %%
segments = {view: trinoc.find_segments(picture) for view, picture in scene.items()}
matches = trinoc.match_segments(segments, rig)
found = trinoc.evaluate(matches, shape)
for at, precision, completeness in zip(
    found.tolerances_mm, found.precision, found.completeness, strict=True
):
    print(f"within {at:4g} mm: precision {precision:.3f}, completeness {completeness:.3f}")
print(
    f"distance: median {found.distance_mm.median:.3f} mm, 90 % {found.distance_mm.at_90:.3f} mm\n"
    f"angle: median {found.angle_deg.median:.2f} deg"
)

# %% [markdown]
# Where the errors are: each track at its place in a picture, coloured by the distance of its middle
# from the nearest edge. Long edges seen by three cameras are known to hundredths of a millimetre.

# %%
middles = matches.lines_mm.mean(axis=1)
off_mm = distance_to_segments_mm(middles, shape.edges_mm)
figure, axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
colours = plt.get_cmap("plasma")
for one, (column, view) in zip(axes, enumerate(matches.views), strict=True):
    plot.draw_image(one, scene[view], strength=0.3)
    one.set_title(view)
    for fragment, off in zip(matches.fragments_px[:, column], off_mm, strict=True):
        one.plot(*fragment.T, color=colours(np.clip((np.log10(off) + 2.5) / 2.5, 0, 0.9)), lw=2)
scale = plt.cm.ScalarMappable(plt.matplotlib.colors.LogNorm(10**-2.5, 1), colours)
figure.colorbar(scale, ax=axes, label="mm off", shrink=0.8)
plt.show()

# %% [markdown]
# ## Do the sigmas say the truth?
# A scene without pictures: loose segments in space, their images with noise that is known, matched
# as always. Each line that lies on its edge is off by four numbers, two directions at two ends; in
# units of the sigmas they should be normal. First the cameras are exact; then they are off by
# 0.05 degrees and 0.5 mm, as after a poor calibration. The segments' own covariance then claims too
# much, and that of the rig has to be added (`lines_of_rig`, which `trinoc evaluate` does).

# %%
def sigmas_of(lines, edges_mm):
    """Normalised errors of the lines that lie on an edge, one number after the other."""
    edge = trinoc.evaluate(lines, edges_mm, tolerances_mm=(2.0,)).lines
    on = edge >= 0
    offsets = offsets_across(select_lines(lines, on), edges_mm[edge[on]])
    return errors_in_sigmas(offsets, lines.parameter_covariance).reshape(-1)


def own(matches):
    """The lines of matches as those of cameras that are exact."""
    return independent_lines(matches.lines_mm, matches.covariance_mm2)


loose = loose_segments(3, count=90, reach_mm=60.0)
seen, truth = simulate_segments(loose, rig, Detector(0.15, 0.0, 0.1, 0.1), seed=2)
sigma = np.tile([0.05, 0.05, 0.05, 0.5], 3)
rows_of_rig = np.array(list(TABLE_1.values())) + sigma.reshape(3, 4) * np.random.default_rng(
    4
).normal(size=(3, 4))
poor = Rig(
    {
        view: trinoc.Camera.from_degrees(
            table1_lens(), pan_deg=p, tilt_deg=t, swing_deg=s, distance_mm=d
        )
        for view, (p, t, s, d) in zip(TABLE_1, rows_of_rig.tolist(), strict=True)
    },
    parameters=[
        f"{view}.{name}" for view in TABLE_1
        for name in ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    ],
    covariance=np.diag(sigma**2),
)
exact_matches = trinoc.match_segments(seen, rig)
poor_matches = trinoc.match_segments(seen, poor)
three = matches.stage == "trinocular"
errors = {
    "made segments, exact cameras": sigmas_of(own(exact_matches), loose.edges_mm),
    "poor cameras, segments' own sigma": sigmas_of(own(poor_matches), loose.edges_mm),
    "poor cameras, cameras' sigma too": sigmas_of(lines_of_rig(poor_matches, poor), loose.edges_mm),
    "pictures, seen in three": sigmas_of(select_lines(own(matches), three), shape.edges_mm),
    "pictures, seen in two": sigmas_of(select_lines(own(matches), ~three), shape.edges_mm),
}
within = {name: float(np.mean(np.abs(z) < 1.96)) for name, z in errors.items()}
for name, z in errors.items():
    print(f"{name:36s} {len(z):4d} numbers, {within[name]:.3f} within 1.96 sigma")

figure, axes = plt.subplots(1, 5, figsize=(16, 3.2), layout="constrained", sharey=True)
grid = np.linspace(-5, 5, 201)
for one, (name, z) in zip(axes, errors.items(), strict=True):
    one.hist(np.clip(z, -5, 5), np.linspace(-5, 5, 41), density=True)
    one.plot(grid, stats.norm.pdf(grid), "k", linewidth=1)
    one.set_title(name)
    one.set_xlabel("error / sigma")
plt.show()

# %% [markdown]
# They do for lines that three cameras see. Of lines that only two see, too few errors are within 1.96
# sigma: two views always agree, so that nothing tells a wrong pair from a right one that is a little
# off, and what a picture does to an edge beyond its noise (a neighbour near by, a shadow along it, a
# rim that is no straight line) is in both. Neither is a normal distribution: most lines are better
# than they claim, and a few are much worse.
#
# Checks, run with the tests: half of the shape is accurate to a tenth of a pixel, true sigmas are
# found true and false ones false.

# %%
assert found.distance_mm.median < 0.04
assert found.precision[-1] > 0.9
assert found.completeness[-1] > 0.8
assert 0.9 < within["made segments, exact cameras"] < 0.98
assert within["poor cameras, segments' own sigma"] < 0.9
assert within["poor cameras, cameras' sigma too"] > 0.9
