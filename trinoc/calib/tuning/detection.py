"""Tuned constants of the detection of boards."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectionTuning:
    """Tuned constants of the detection, from an image to labelled points of a board.

    Check with benchmarks/detection.py (numbers of detected images and of wrong labels, by
    condition). Unless a comment gives another source, values were chosen by hand on this benchmark
    and on photographs of circle grids (tests/calib/detection/test_photographs.py).
    """

    # Fewest points (circle centres or corners) in a detection, and fewest blobs in a lattice.
    fewest_places: int = 6

    # Side of the image in which blobs are searched, px: larger images are reduced to about this.
    search_side_px: int = 1200
    # Settings of the blob search (`BlobScale`), in the order in which they are tried: the most
    # often successful first. The last one uses the image enlarged twice.
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
    # Side of the blocks in which the threshold is computed, px.
    block_px: int = 8
    # Smallest and largest roundness of a blob: its area over the area of the ellipse with equal
    # second moments. It is 1 for every ellipse, and smaller for dented or elongated shapes.
    roundness: tuple[float, float] = (0.8, 1.1)
    # Largest number of blobs; of more, the largest are used. Limits the computing time.
    most_blobs: int = 700

    # Largest factor between the distance of two neighbouring blobs and the expected distance
    # (mean of both blobs' frames), and between their areas. Perspective and the coarse shape of
    # blobs cause these.
    distance_factor: float = 1.38
    largest_area_ratio: float = 3.0
    # Largest distance of a blob from its position predicted by the lattice, in its own radii, and
    # largest factor between its area and the prediction.
    miss_radii: float = 0.7
    area_factor: float = 2.2
    # Fewest points with which the plane mapping includes bending by the lens, and the ridge of
    # that bending relative to the number of points, which keeps it from following noise.
    cubic_points: int = 16
    cubic_damping: float = 1e-3

    # Standard deviation of the relative hole radius about 0 (disc) or 1 (ring), beyond the sigma
    # of the fit.
    hole_sigma: float = 0.2
    # Fewest units of log likelihood between the best labelling and any other. One misread circle
    # changes it by less.
    margin: float = 16.0
    # Log likelihood lost by a circle outside the pattern. One such circle must not decide a
    # labelling, two may. A ring misread as a disc, or the reverse, costs about 25.
    outside_cost: float = 10.0
    # Log odds above which a circle is clearly a ring (or, negative, clearly a disc).
    clear_log_odds: float = 4.0
    # Largest share of circles that may contradict the labelling, and of light cells in a tag's
    # border.
    most_wrong: float = 0.1
    # Smallest ratio between the misfits of the second best and the best orientation of a symmetric
    # sheet, for an earlier calibration of the camera to decide it.
    orientation_ratio: float = 3.0

    # Largest number of pixels in the first fit of a circle.
    coarse_pixels: int = 150
    # Radius of the region around a circle used by all fits, in its radii.
    outer_radii: float = 1.45
    # Relative standard deviation of each circle's blur about that of the sheet (prior).
    blur_width: float = 0.3
    # Residuals are clipped to this share of the contrast when the quality of a fit is measured.
    largest_misfit: float = 0.5
    # Fewest positions along a crossed line at which the line is visible.
    fewest_stations: int = 10

    # Additional standard deviation of a corner per axis, px, for errors that the residuals of its
    # window do not show. With it, the residuals of corners are 1.0 to 1.3 of their sigmas, in the
    # median of 13 public sets (webcams, phone, industrial cameras; benchmarks/public_sets.py).
    corner_floor_px: float = 0.025
    # A corner is wrong if it deviates from the prediction of its neighbours by more than both
    # limits: a share of the distance to the next corner, and a multiple of the image's median
    # deviation. Where one of both is small, correct corners of 13 public sets reach .035 and 6 in
    # the other.
    out_of_place_share: float = 0.03
    out_of_place_medians: float = 8.0
    # The same share before corners are refined.
    first_out_of_place_share: float = 0.15
    # Smallest share of consistent corners in the result of a search. Below it, the search located
    # something else than the board.
    least_right_share: float = 0.8
    # Largest number of pixels of the image in which a chessboard is searched. The corners are
    # refined in the full image.
    most_searched_px: int = 1_500_000
    # Half the side of the window in which a corner is refined, as a share of the distance to the
    # nearest other feature, and its limits, px. The window then contains no other edge.
    refined_share: float = 0.45
    refined_half_px: tuple[int, int] = (2, 11)
    # Distance from a tag corner at which the levels of its four fields are read, over the gap
    # between tags. Largest difference between two fields of equal ink, over the contrast: it is
    # larger where an object covers one of them.
    field_share: float = 0.3
    alike_share: float = 0.35
    # Largest deviation of a tag from the position predicted by most tags, in its sides. Above it,
    # the number of the tag was misread.
    most_off_sides: float = 0.25
    # Settings of the tag search: enlargement of the image, and width in its pixels by which light
    # regions are dilated. Small tags need the enlargement, blurred corners need the dilation.
    tag_scales: tuple[tuple[int, int], ...] = ((1, 3), (1, 7), (2, 5))
    # Largest image that is enlarged, in pixels.
    most_enlarged_px: int = 4_000_000

    @property
    def fewest_tags(self) -> int:
        """Smallest number of tags that together have `fewest_places` corners."""
        return -(-self.fewest_places // 4)
