from .refinement import Matched as Matched
from .refinement import Matcher as Matcher
from .refinement import refine as refine
from .result import RefineResult as RefineResult
from .result import RefineStatus as RefineStatus
