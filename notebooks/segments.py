# %% [markdown]
# # Detection of the straight edges of a picture
#
# This notebook runs the method of Nevatia and Babu (1980) step by step on one picture of the demo:
#
# 1. six edge masks,
# 2. thinning of the edges to points,
# 3. linking of the points to chains,
# 4. polygonal approximation of the chains,
# 5. a line with sub-pixel accuracy and a covariance for each piece.
#
# `trinoc.find_segments` runs all steps in one call.

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
image = demo_images("scene")["left"]
# Rows and columns of the region that the figures show. Its pixels are large enough to see.
REGION = (slice(190, 290), slice(180, 310))


def draw_region(axes, title, values=image, colours="gray"):
    """Draw the region of an image, with axes in pixels of the whole image."""
    rows, columns = REGION
    extent = (columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5)
    axes.imshow(values[REGION], cmap=colours, extent=extent, interpolation="nearest")
    axes.set_title(title)
    axes.set_xlim(extent[:2])
    axes.set_ylim(extent[2:])


def make_two_axes():
    """Two axes side by side."""
    return plt.subplots(1, 2, figsize=(13, 5.2), layout="constrained")[1]


# %% [markdown]
# ## Six masks
# Each mask has its largest response at edges of one direction. The directions differ by 30 degrees.
# The sign of the response shows the brighter side.

# %%
figure, axes = plt.subplots(1, 6, figsize=(13, 2.4), layout="constrained")
for panel, mask, angle_deg in zip(axes, nevatia_babu_masks(), range(0, 180, 30), strict=True):
    panel.imshow(mask, cmap="RdBu", vmin=-0.1, vmax=0.1)
    panel.set_title(f"{angle_deg} degrees")
    panel.set_axis_off()
plt.show()

# %% [markdown]
# ## Magnitude and direction
# The response of each mask is a vector along the direction of the mask. The sum of the six vectors is
# the gradient. The noise of the picture determines which gradients are significant.

# %%
grey = image.astype(np.float32)
kernel = combined_kernel()
gradient = correlate_gradient(grey, kernel)
noise = level_noise(grey, quantum=1.0)
gradient_noise = noise * kernel.noise_gain
magnitude = np.sqrt(gradient.squared)
direction_rad = np.arctan2(gradient.v, gradient.u)
print(f"noise: {noise:.2f} grey levels; of the gradient: {gradient_noise:.3f} grey levels per pixel")

left, right = make_two_axes()
draw_region(left, "picture")
draw_region(right, "gradient, grey levels per pixel", magnitude, "viridis")
plt.show()

# %% [markdown]
# ## Thinning and linking
# Thinning keeps a pixel if its gradient is larger than at both neighbours across the edge (dots). A
# parabola through the logarithms of the three magnitudes locates the peak between the pixels. Linking
# then joins each point to its successor and its predecessor along the edge.

# %%
min_gradient = max(3 * noise * kernel.noise_gain, 0.9)
points = thin_pixels(grey, kernel, min_gradient)
successor = successors(points, grey.shape)
linked = np.flatnonzero(successor >= 0)
order, starts = order_chains(successor)
print(f"{len(points.pixel)} points, {len(linked)} links, {len(starts)} chains")

left, right = make_two_axes()
direction_of_edges = np.where(magnitude > min_gradient, direction_rad, np.nan)
draw_region(left, "edge points and direction of the gradient", direction_of_edges, "hsv")
left.plot(*points.uv_px.T, "k.", markersize=3)
draw_region(right, "links")
right.plot(
    *np.stack([points.uv_px[linked], points.uv_px[successor[linked]]]).transpose(2, 0, 1),
    color="tab:orange",
    linewidth=1.2,
)
plt.show()

# %% [markdown]
# ## Polygons and sub-pixel lines
# A chain is split at the point that is farthest from its chord, until no point is more than 1.6 px
# from the chord of its piece. `find_segments` then
#
# - fits a line to the points of each piece,
# - merges collinear pieces,
# - removes lines that may be noise, soft shadows or curves,
# - corrects the shift by neighbouring edges, and a part of the shift by shading,
# - moves an end near another line to the crossing of the two lines.

# %%
piece_starts, piece_stops = split_chains(points.uv_px[order], starts, 1.6, 6)
segments = trinoc.find_segments(image)
print(f"{len(piece_starts)} pieces, {len(segments)} segments")

left, right = make_two_axes()
draw_region(left, "polygons")
for start, stop in zip(piece_starts, piece_stops, strict=True):
    left.plot(*points.uv_px[order[[start, stop - 1]]].T, "o-", markersize=3, linewidth=1)
draw_region(right, "segments and junctions")
for ends in segments.endpoints_px:
    right.plot(*ends.T, color="tab:orange", linewidth=1.5)
right.plot(*segments.junctions.uv_px.T, ".", color="cyan", markersize=7)
for junction_px, kind in zip(segments.junctions.uv_px, segments.junctions.kind, strict=True):
    right.annotate(
        kind, junction_px, color="cyan", size=11, xytext=(6, 6), textcoords="offset points",
        bbox={"facecolor": "black", "edgecolor": "none", "pad": 1}, clip_on=True,
    )  # fmt: skip
plt.show()

# %% [markdown]
# ## Uncertainty of each segment
# Across the segment, the sigma of its position is some hundredths of a pixel. If a neighbouring edge,
# shading, a bend or a wide blur disturbs the edge, the sigma is some tenths. `reasons` names the largest
# contribution. Along the segment, the sigma of an end is half a pixel at a crossing. It is some pixels
# if the edge fades out.

# %%
vector_px = np.diff(segments.endpoints_px, axis=1)[:, 0]
normal = np.stack([-vector_px[:, 1], vector_px[:, 0]], axis=-1) / segments.length_px[:, None]
# Derivative of the midpoint's position across the segment with respect to the four end coordinates.
gradient_of_midpoint = np.concatenate([normal, normal], axis=1) / 2
variance_px2 = np.einsum(
    "ni,nij,nj->n", gradient_of_midpoint, segments.covariance_px2, gradient_of_midpoint
)
sigma_px = np.sqrt(variance_px2)
reasons, counts = np.unique(segments.reasons, return_counts=True)
for reason, count in zip(reasons, counts, strict=True):
    median_px = np.median(sigma_px[segments.reasons == reason])
    print(f"{reason or 'noise only':12s} {count:3d} segments, median sigma {median_px:.3f} px")

lsd = find_segments_lsd(image)
left, right = make_two_axes()
draw_region(left, f"trinoc: {len(segments)} segments; magenta: sigma of 0.15 px or more")
for ends, sigma in zip(segments.endpoints_px, sigma_px, strict=True):
    left.plot(*ends.T, color=plt.get_cmap("cool")(min(sigma / 0.15, 1.0)), linewidth=2)
draw_region(right, f"OpenCV's LSD: {len(lsd)} segments")
for ends in lsd.endpoints_px:
    right.plot(*ends.T, color="tab:green", linewidth=2)
plt.show()

# %% [markdown]
# The tests of the project run these checks. The darker side is on the right of more than 90 % of the
# segments. There are more than 10 junctions. All covariances are positive definite. The median sigma
# across the segments is below 0.1 px.

# %%
# The normal points to the right of the direction from the first to the second end.
midpoint_px = segments.endpoints_px.mean(axis=1)
(right_u, right_v), (left_u, left_v) = (
    np.rint(midpoint_px + side * 2.5 * normal).astype(int).T for side in (1, -1)
)
assert np.mean(grey[right_v, right_u] < grey[left_v, left_u]) > 0.9
assert len(piece_starts) > len(segments) > 30
assert len(segments.junctions) > 10
assert (np.linalg.eigvalsh(segments.covariance_px2) > 0).all()
assert np.median(sigma_px) < 0.1
