from .camera_picture import Cells as Cells, render_sheet as render_sheet
from .observations import Detector as Detector, simulate_segments as simulate_segments
from .rigs import random_rig as random_rig, table1_lens as table1_lens, table1_rig as table1_rig
from .scenes import (
    Scene as Scene,
    block_scene as block_scene,
    demo_scene as demo_scene,
    loose_segments as loose_segments,
    points_along as points_along,
    see_through_boxes as see_through_boxes,
)
from .truth import (
    NOT_SCORED as NOT_SCORED,
    SceneTruth as SceneTruth,
    SeenParts as SeenParts,
    SegmentTruth as SegmentTruth,
    parts_in_views_mm as parts_in_views_mm,
    shown_parts_mm as shown_parts_mm,
    shown_parts_of_segments_mm as shown_parts_of_segments_mm,
)
from .visibility import visible_parts as visible_parts
