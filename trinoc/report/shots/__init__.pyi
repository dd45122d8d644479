from .page import (
    render_shots_report as render_shots_report,
    write_shots_report as write_shots_report,
)
