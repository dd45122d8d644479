from .atomic import (
    atomic_write as atomic_write,
    expect_place as expect_place,
    write_text as write_text,
)
from .board_json import load_target as load_target, save_target as save_target
from .compile_cache import (
    COMPILE_CACHE_VARIABLE as COMPILE_CACHE_VARIABLE,
    enable_compile_cache as enable_compile_cache,
)
from .demo import (
    demo_images as demo_images,
    demo_paths as demo_paths,
    demo_pattern as demo_pattern,
    demo_truth as demo_truth,
    load_scene_truth as load_scene_truth,
    save_scene_truth as save_scene_truth,
)
from .formats import FORMATS as FORMATS, LOSSES as LOSSES, Format as Format
from .frames_files import (
    frames_ending as frames_ending,
    load_frames as load_frames,
    save_frames as save_frames,
)
from .images import (
    IMAGE_SUFFIXES as IMAGE_SUFFIXES,
    picture_digest as picture_digest,
    read_image as read_image,
    read_views as read_views,
    write_picture as write_picture,
)
from .intrinsics_json import (
    load_intrinsics as load_intrinsics,
    load_lens_covariance as load_lens_covariance,
)
from .json_text import parsed_json as parsed_json
from .known_shape import load_shape as load_shape
from .pattern_json import load_pattern as load_pattern, save_pattern as save_pattern
from .pattern_page import (
    PAPER_SIZES_MM as PAPER_SIZES_MM,
    drawing_room_mm as drawing_room_mm,
    drawing_size_mm as drawing_size_mm,
    lay_out as lay_out,
)
from .pattern_pdf import save_pattern_pdf as save_pattern_pdf
from .pattern_png import (
    pattern_picture as pattern_picture,
    save_pattern_png as save_pattern_png,
    screen_room_mm as screen_room_mm,
)
from .pattern_svg import save_pattern_svg as save_pattern_svg
from .rig_json import (
    load_rig as load_rig,
    load_rig_status as load_rig_status,
    rig_text as rig_text,
)
from .rig_status import CameraStatus as CameraStatus, RigStatus as RigStatus
from .saving import (
    expect_ending as expect_ending,
    load as load,
    load_matches as load_matches,
    save as save,
)
from .segment_table import load_segments as load_segments
from .shots import load_shots as load_shots
from .table_csv import save_table as save_table
from .usable_cameras import expect_lens as expect_lens, expect_pitch as expect_pitch
from .views_of_rig import expect_inside as expect_inside, expect_size as expect_size
from .whole_files import read_text as read_text
from .whole_picture import is_whole_picture as is_whole_picture
