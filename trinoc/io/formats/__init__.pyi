from .format import Format as Format
from .losses import LOSSES as LOSSES
from .registry import FORMATS as FORMATS
