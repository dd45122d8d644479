from .advised_shot import NextShot as NextShot, next_shot as next_shot
from .from_shots import calibrate_rig as calibrate_rig
from .grey_lens import lens_of_rig as lens_of_rig
from .result import RigFromShots as RigFromShots
