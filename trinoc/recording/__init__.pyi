from .frame import OK as OK, Frame as Frame, FrameMatches as FrameMatches
from .frame_table import frames_of_table as frames_of_table
from .matched import matched_frames as matched_frames, unexpected as unexpected
from .name_templates import (
    depth_of as depth_of,
    fitting_template as fitting_template,
    frames_of_names as frames_of_names,
)
from .parts import Part as Part, parts_of as parts_of, share_of as share_of
