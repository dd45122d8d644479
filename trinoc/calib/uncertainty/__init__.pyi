from .systematics import (
    Systematics as Systematics,
    data_sheet_covariance as data_sheet_covariance,
)
