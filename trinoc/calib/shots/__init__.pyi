from .from_shots import calibrate_rig as calibrate_rig
from .result import RigFromShots as RigFromShots
