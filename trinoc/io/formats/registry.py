"""All formats, in the order in which people use them."""

from trinoc.io.formats.aniposelib_toml import anipose, caliscope
from trinoc.io.formats.colmap_model import colmap, colmap_text
from trinoc.io.formats.cv_storage import opencv
from trinoc.io.formats.easymocap_yml import easymocap
from trinoc.io.formats.format import Format
from trinoc.io.formats.json_of_wireframe import wireframe_json
from trinoc.io.formats.kalibr_camchain import kalibr
from trinoc.io.formats.limap_tracks import limap
from trinoc.io.formats.line_drawings import dxf, gltf, obj
from trinoc.io.formats.lines_tables import csv, parquet, ply
from trinoc.io.formats.matlab_stereo import matlab
from trinoc.io.formats.mc_calib import mc_calib
from trinoc.io.formats.metashape_xml import metashape
from trinoc.io.formats.mrcal_cameramodel import mrcal
from trinoc.io.formats.multical_json import multical
from trinoc.io.formats.nerfstudio_transforms import nerfstudio
from trinoc.io.formats.ros_camera_info import ros
from trinoc.io.formats.segments_text import elsed, limap_segments, lsd
from trinoc.io.formats.tf_static import tf

_CAMERAS = (opencv, ros, kalibr, colmap, colmap_text, mrcal, matlab, nerfstudio, anipose, caliscope,
            multical, mc_calib, easymocap, metashape, tf)  # fmt: skip
_LINES = (ply, obj, gltf, dxf, csv, parquet, limap, wireframe_json)
_SEGMENTS = (lsd, elsed, limap_segments)
FORMATS: dict[str, Format] = {each.name: each for each in (*_CAMERAS, *_LINES, *_SEGMENTS)}
