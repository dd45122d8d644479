from .colmap_model import colmap as colmap, colmap_text as colmap_text
from .cv_storage import opencv as opencv
from .dxf_lines import dxf as dxf
from .format import Format as Format
from .gltf_lines import gltf as gltf
from .json_of_wireframe import wireframe_json as wireframe_json
from .kalibr_camchain import kalibr as kalibr
from .limap_tracks import limap as limap
from .lines_tables import csv as csv, parquet as parquet
from .losses import LOSSES as LOSSES
from .matlab_stereo import matlab as matlab
from .mrcal_cameramodel import mrcal as mrcal
from .nerfstudio_transforms import nerfstudio as nerfstudio
from .obj_lines import obj as obj
from .ply_edges import ply as ply
from .registry import FORMATS as FORMATS
from .ros_camera_info import ros as ros
from .segments_text import elsed as elsed, limap_segments as limap_segments, lsd as lsd
from .tf_static import tf as tf
