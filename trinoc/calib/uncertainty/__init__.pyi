from .lens_response import lens_spreads as lens_spreads
from .systematics import Systematics as Systematics, with_spreads as with_spreads
