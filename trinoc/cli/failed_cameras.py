"""Where some cameras of a calibration fail: the others are kept, and each picture says why."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trinoc.errors import CalibrationError

if TYPE_CHECKING:
    import numpy as np

    from trinoc.calib import CalibrationResult, Pattern


def kept_of_failure(
    error: CalibrationError,
    images: "Mapping[str, np.ndarray]",
    pattern: "Pattern",
    out: Path,
    *,
    refusal: Callable[["CalibrationResult"], str | None],
    provenance: Mapping[str, Any],
) -> CalibrationError:
    """The same error, which also says what was written beside `out`.

    `out` itself stays as it is: an incomplete rig must not take the place of a whole one.

    refusal : why what is known of the others may not be written, if so.
    """
    from trinoc.calib import CalibrationResult
    from trinoc.capture import failure_picture, judge
    from trinoc.io import save, write_picture

    said = [str(error)]
    for name in error.failures:
        faults = judge(name, images[name], pattern).faults
        in_name = re.sub(r"[^\w.-]", "_", name)
        place = out.with_name(f"{out.stem}-{in_name}-failed.png")
        write_picture(place, failure_picture(images[name], [error.failures[name], *faults]))
        causes = f" (there {'; '.join(faults)})" if faults else ""
        said.append(f'What was seen of "{name}" is in {place}{causes}.')
    result = error.result
    if isinstance(result, CalibrationResult):
        why = refusal(result)
        place = out.with_name(f"{out.stem}-incomplete.json")
        if why is None:
            save(result, place, provenance=provenance)
            others = ", ".join(result.rig.names)
            kept = "is as it was" if out.exists() else "was not written"
            why = f"{place} holds the others ({others}); {out} {kept}."
        said.append(why)
    return CalibrationError(" ".join(said), error.failures, result)
