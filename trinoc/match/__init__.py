"""Match line segments of two or more views and return lines in space with posterior and covariance.

The method is that of Yokoi, Medioni and Nevatia, "A segment-based matching algorithm in trinocular
vision" (1986). Here it uses a likelihood that includes the covariance of every segment.

0. `observations`, `two_view`: segments in tables, the pencil of epipolar planes of two views, and
   the common part of a pair of segments.
1. `candidates`: the epipolar constraint restricts the partners of a segment to a zone of a second
   view. A pair predicts position and direction in the third view. A third segment near this
   prediction and nearly parallel to it completes a triple. All three orderings of the views are
   tried.
2. `selection`: each part of a segment belongs to at most one line, which excludes rivals
   (sum-product belief propagation). If a candidate is right, its neighbour is matched at the
   neighbouring position (junctions of 3-D ends).
3. `occlusion`: segments that only two views show are matched between those two, if they join
   matched lines.

`evidence` holds the log likelihood ratios that the steps share, and estimates their parameters
by EM. `tracks` merges more than three views and builds `Matches`. `line_map` joins collinear
tracks to one line and ends that meet to corners. `matcher` runs all steps. `tuning` holds the
constants that users may set.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
