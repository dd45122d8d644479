from .refinement import Matched as Matched, Matcher as Matcher, refine as refine
from .result import RefineResult as RefineResult, RefineStatus as RefineStatus
