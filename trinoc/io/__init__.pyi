from .atomic import (
    save_table as save_table,
)
from .board_json import (
    load_target as load_target,
)
from .compile_cache import (
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
from .formats.registry import (
    FORMATS as FORMATS,
)
from .frames_files import (
    load_frames as load_frames,
)
from .images import (
    load_shots as load_shots,
    read_image as read_image,
    read_views as read_views,
    write_picture as write_picture,
)
from .intrinsics_json import (
    load_intrinsics as load_intrinsics,
)
from .known_shape import (
    load_shape as load_shape,
)
from .pattern_page import (
    save_pattern_pdf as save_pattern_pdf,
    save_pattern_svg as save_pattern_svg,
)
from .pattern_png import (
    save_pattern_png as save_pattern_png,
)
