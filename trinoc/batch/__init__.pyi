from .results import RecordingMatches as RecordingMatches, load_recording as load_recording
from .run import (
    BatchOutcome as BatchOutcome,
    BatchProgress as BatchProgress,
    match_recording as match_recording,
)
