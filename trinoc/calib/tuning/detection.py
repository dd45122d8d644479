"""Tuned constants of the detection of boards."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectionTuning:
    """From a picture to labelled places of a board. Shown by benchmarks/detection.py: pictures
    found and wrong labels of each condition. By hand on these and on photographs of grids of
    circles (tests/calib/detection/test_photographs.py), where nothing else is said."""

    # Circles or corners that a picture must show, and blobs that a lattice must have.
    fewest_places: int = 6

    # Blobs are looked for in pictures of about so many px a side.
    search_side_px: int = 1200
    # The ways to look for them, the likeliest to succeed first: see `BlobScale`. The last looks at
    # the picture doubled.
    blob_scales: tuple[tuple[float, int, int, int], ...] = (
        (0.8, 8, 0, 0),
        (0.8, 3, 0, 0),
        (2.0, 8, 0, 0),
        (0.8, 20, 0, 0),
        (0.8, 8, 5, 0),
        (0.8, 8, 0, 5),
        (3.0, 20, 0, 0),
        (1.2, 5, 0, 0),
    )
    # The threshold is taken in blocks of this side, px.
    block_px: int = 8
    # Least and largest area over that of the ellipse with the same second moments: 1 for any
    # ellipse, less for all that is dented or stretched.
    roundness: tuple[float, float] = (0.8, 1.1)
    # Of more blobs than this, the largest are kept: for time.
    most_blobs: int = 700

    # Neighbours may be off the expected distance by this factor, in the mean of both frames, and
    # differ in area by this one: perspective and a blob's coarse shape account for it.
    distance_factor: float = 1.38
    largest_area_ratio: float = 3.0
    # A grown blob may miss its predicted place by so many of its own radii, and its predicted area
    # by this factor.
    miss_radii: float = 0.7
    area_factor: float = 2.2
    # Points from which on a lens bends the plane, and the ridge, relative to their number, that
    # keeps the bend from following noise.
    bend_points: int = 16
    bend_damping: float = 1e-3

    # How far a fitted hole may be from 0 (disc) or 1 (ring), beyond its own sigma.
    hole_sigma: float = 0.2
    # Log likelihood by which a labelling must beat every other: more than one misread circle gives.
    margin: float = 16.0
    # Log likelihood that a circle costs where the pattern has none: one must not decide a
    # labelling, two may; a circle misread as a ring or a disc costs about 25.
    outside_cost: float = 10.0
    # Log odds from which on a circle is clearly a ring.
    clear_log_odds: float = 4.0
    # Share of the circles that may contradict the labelling; of a tag's border that may be light.
    most_wrong: float = 0.1
    # An earlier camera must fit one way round of a sheet so many times better than any other.
    orientation_ratio: float = 3.0

    # Pixels of a circle that its first fit looks at, and how far all fits look, in its radii.
    coarse_pixels: int = 150
    outer_radii: float = 1.45
    # Relative width of the prior that holds each circle's blur to that of the sheet.
    blur_width: float = 0.3
    # Share of the contrast beyond which a residual says nothing of how well the model fits.
    largest_misfit: float = 0.5
    # Places along a crossed line that must be seen.
    fewest_stations: int = 10

    # What a corner is missed by in images of real cameras beyond what the residuals of its window
    # show, per axis, px: chosen so that the residuals of corners are 1.0 to 1.3 of their sigmas in
    # the median of 13 public sets (webcams, phone, industrial cameras; benchmarks/public_sets.py).
    corner_floor_px: float = 0.025
    # A corner that its neighbours put elsewhere by this share of the distance to the next one, and
    # by so many times the image's median, is none: right ones of 13 public sets miss by .035 and 6
    # at most where the other of both is small. Before corners are refined, they may be farther off.
    out_of_place_share: float = 0.03
    out_of_place_medians: float = 8.0
    first_out_of_place_share: float = 0.15
    # A search of which fewer corners are in place found something else than the board.
    least_right_share: float = 0.8
    # Boards are searched in images of no more pixels; corners are refined in the image itself.
    most_searched_px: int = 1_500_000
    # Half the window in which a corner is refined, as a share of the distance to the next thing,
    # and its limits, px: no other edge is in it.
    refined_share: float = 0.45
    refined_half_px: tuple[int, int] = (2, 11)
    # How far from a corner its four fields are looked at, over the gap, and by how much, over the
    # contrast, two fields of one ink may differ: more where something covers one.
    field_share: float = 0.3
    alike_share: float = 0.35
    # A tag that is not where the others have it, by this share of its side, was read wrongly.
    most_off_sides: float = 0.25
    # How often a picture with tags is enlarged, and the width in its pixels by which light is
    # widened: fine tags need the one, soft corners the other. No more than so many px are enlarged.
    tag_scales: tuple[tuple[int, int], ...] = ((1, 3), (1, 7), (2, 5))
    most_enlarged_px: int = 4_000_000

    @property
    def fewest_tags(self) -> int:
        """The fewest tags that have `fewest_places` corners."""
        return -(-self.fewest_places // 4)
