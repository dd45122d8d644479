# %% [markdown]
# # How the straight edges of a picture are found
#
# The chain of Nevatia and Babu (1980) step by step, on one picture of the demo: six masks,
# thinning, linking, polygonal approximation, then a line to sub-pixels through each piece, with
# a covariance that says what disturbed it. `trinoc.find_segments` does all of this in one call.

# %%
import matplotlib.pyplot as plt
import numpy as np

import trinoc
from trinoc.io import demo_images
from trinoc.segments import find_segments_lsd
from trinoc.segments.nevatia_babu.chains import order_chains, split_chains, successors
from trinoc.segments.nevatia_babu.masks import correlate_gradient
from trinoc.segments.nevatia_babu.masks import combined_kernel
from trinoc.segments import nevatia_babu_masks
from trinoc.image.noise import level_noise
from trinoc.segments.nevatia_babu.thinning import thin_pixels

plt.rcParams.update({"figure.dpi": 64, "savefig.bbox": "tight", "axes.titlesize": 10})
picture = demo_images("scene")["left"]
# A part of the picture, large enough to see its pixels.
PART = (slice(190, 290), slice(180, 310))


def show(axes, title, grey=picture, colours="gray"):
    """The part of a picture, with the axes in pixels of the whole."""
    rows, columns = PART
    extent = (columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5)
    axes.imshow(grey[PART], cmap=colours, extent=extent, interpolation="nearest")
    axes.set_title(title)
    axes.set_xlim(extent[:2])
    axes.set_ylim(extent[2:])


def pair():
    """Two axes side by side."""
    return plt.subplots(1, 2, figsize=(13, 5.2), layout="constrained")[1]


# %% [markdown]
# ## Six masks
# Each answers best to an edge of one direction, 30 degrees apart; its sign tells the brighter
# side.

# %%
figure, axes = plt.subplots(1, 6, figsize=(13, 2.4), layout="constrained")
for one, mask, angle in zip(axes, nevatia_babu_masks(), range(0, 180, 30), strict=True):
    one.imshow(mask, cmap="RdBu", vmin=-0.1, vmax=0.1)
    one.set_title(f"{angle} degrees")
    one.set_axis_off()
plt.show()

# %% [markdown]
# ## Magnitude and direction
# The answers of the six masks, each along its own direction, add up to one vector: the gradient.
# The noise of the picture tells which answers mean something.

# %%
grey = picture.astype(np.float32)
kernel = combined_kernel()
gradient = correlate_gradient(grey, kernel)
noise = level_noise(grey, quantum=1.0)
strength = np.sqrt(gradient.squared)
direction = np.arctan2(gradient.v, gradient.u)
print(f"noise {noise:.2f} grey levels, in the gradient {noise * kernel.noise_gain:.3f} per pixel")

left, right = pair()
show(left, "picture")
show(right, "gradient, grey levels per pixel", strength, "viridis")
plt.show()

# %% [markdown]
# ## Thinning and linking
# A pixel stays where the gradient is larger than at both neighbours across the edge (dots); a
# parabola through the logarithms of the three says where between pixels the peak is.
# Each point looks for its successor along the edge, and for the point that it is a successor of.

# %%
least = max(3 * noise * kernel.noise_gain, 0.9)
points = thin_pixels(grey, kernel, least)
following = successors(points, grey.shape)
linked = np.flatnonzero(following >= 0)
order, starts = order_chains(following)
print(f"{len(points.pixel)} points, {len(linked)} links, {len(starts)} chains")

left, right = pair()
show(
    left, "thinned: direction of the gradient", np.where(strength > least, direction, np.nan), "hsv"
)
left.plot(*points.uv_px.T, "k.", markersize=3)
show(right, "linked to chains")
right.plot(
    *np.stack([points.uv_px[linked], points.uv_px[following[linked]]]).transpose(2, 0, 1),
    color="tab:orange",
    linewidth=1.2,
)
plt.show()

# %% [markdown]
# ## Polygons, and lines to sub-pixels
# A chain is split where it is farthest from its chord, until nothing lies more than 1.6 pixels
# off. Then a line goes through the points of each piece; collinear pieces are merged, what noise
# may have made or what is too soft or too curved is dropped, what neighbouring edges pull is taken
# out, as is part of what shading does to an edge, and the ends go to the crossings with what stops
# them.

# %%
start, stop = split_chains(points.uv_px[order], starts, 1.6, 6)
segments = trinoc.find_segments(picture)
print(f"{len(start)} pieces become {len(segments)} segments")

left, right = pair()
show(left, "polygons")
for first, last in zip(start, stop, strict=True):
    left.plot(*points.uv_px[order[[first, last - 1]]].T, "o-", markersize=3, linewidth=1)
show(right, "segments and junctions")
for ends in segments.endpoints_px:
    right.plot(*ends.T, color="tab:orange", linewidth=1.5)
right.plot(*segments.junctions.uv_px.T, ".", color="cyan", markersize=7)
for place, kind in zip(segments.junctions.uv_px, segments.junctions.kind, strict=True):
    right.annotate(
        kind, place, color="cyan", size=11, xytext=(6, 6), textcoords="offset points",
        bbox={"facecolor": "black", "edgecolor": "none", "pad": 1}, clip_on=True,
    )  # fmt: skip
plt.show()

# %% [markdown]
# ## How well each one is known
# Across a segment its ends are known to hundredths of a pixel, or to tenths where something disturbs
# the edge: `reasons` says what. Along it they are known to half a pixel at a crossing, and to some
# pixels where the evidence just stops.

# %%
way = np.diff(segments.endpoints_px, axis=1)[:, 0]
normal = np.stack([-way[:, 1], way[:, 0]], axis=-1) / segments.length_px[:, None]
middle = np.concatenate([normal, normal], axis=1) / 2
sigma_px = np.sqrt(np.einsum("ni,nij,nj->n", middle, segments.covariance_px2, middle))
names, counts = np.unique(segments.reasons, return_counts=True)
for name, count in zip(names, counts, strict=True):
    of_these = sigma_px[segments.reasons == name]
    print(f"{name or 'noise alone':12s} {count:3d} segments, sigma {np.median(of_these):.3f} px")

lsd = find_segments_lsd(picture)
left, right = pair()
show(left, f"trinoc: {len(segments)} segments; magenta: sigma of 0.15 px and more")
for ends, sigma in zip(segments.endpoints_px, sigma_px, strict=True):
    left.plot(*ends.T, color=plt.get_cmap("cool")(min(sigma / 0.15, 1.0)), linewidth=2)
show(right, f"OpenCV's LSD: {len(lsd)} segments")
for ends in lsd.endpoints_px:
    right.plot(*ends.T, color="tab:green", linewidth=2)
plt.show()

# %% [markdown]
# Checks, run with the tests: the darker side is on the right of every segment, corners are
# found as junctions, covariances are positive, and across they are small.

# %%
unit = way / segments.length_px[:, None]
to_right = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
centre = segments.endpoints_px.mean(axis=1)
(u, v), (left_u, left_v) = (
    np.rint(centre + side * 2.5 * to_right).astype(int).T for side in (1, -1)
)
assert np.mean(grey[v, u] < grey[left_v, left_u]) > 0.9
assert len(start) > len(segments) > 30
assert len(segments.junctions) > 10
assert (np.linalg.eigvalsh(segments.covariance_px2) > 0).all()
assert np.median(sigma_px) < 0.1
