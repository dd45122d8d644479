from .evaluations import evaluation_text as evaluation_text
from .html import write_report as write_report
from .parameter_table import parameter_errors as parameter_errors
from .text import (
    counts_text as counts_text,
    errors_text as errors_text,
    reasons_text as reasons_text,
)
