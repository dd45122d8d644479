from .lens_response import lens_spreads as lens_spreads
from .systematics import Systematics as Systematics
from .systematics import with_spreads as with_spreads
