"""What a calibration said of its own cameras, kept in rig.json beside them."""

from typing import TYPE_CHECKING, Any, NamedTuple

from trinoc.io.json_document import Block

if TYPE_CHECKING:
    from trinoc.calib.result.calibration import CalibrationResult
    from trinoc.calib.rig_from_shots import RigFromShots

CONVERGED = "converged"


class CameraStatus(NamedTuple):
    """How the fit of a camera ended ("converged", "suspect"), and what its user should know."""

    status: str
    notes: tuple[str, ...]


class RigStatus(NamedTuple):
    """cameras : status of each that was calibrated. sigmas_include : the errors that the
    covariance holds, in words; both empty for rigs that no calibration wrote."""

    cameras: dict[str, CameraStatus]
    sigmas_include: tuple[str, ...]

    @property
    def doubts(self) -> dict[str, str]:
        """A sentence for each camera that is not to be trusted."""
        return {
            name: camera.notes[0] if camera.notes else "its calibration gives no reason."
            for name, camera in self.cameras.items()
            if camera.status != CONVERGED
        }


def status_to_block(result: "CalibrationResult") -> dict[str, Any]:
    """The "status" object of a file."""
    return {
        "cameras": {
            name: {
                "status": result.status[name].name.lower(),
                "notes": list(result.fits[name].notes),
            }
            for name in result.rig.names
        },
        "sigmas_include": ["noise", *result.systematics],
    }


def status_of_shots(result: "RigFromShots") -> dict[str, Any]:
    """The same of a rig from many shots, whose cameras were fitted together."""
    return {
        "cameras": {
            name: {"status": result.status.name.lower(), "notes": list(result.notes)}
            for name in result.cameras
        },
        "sigmas_include": ["noise", *result.systematics],
    }


def status_of_document(document: Block) -> RigStatus:
    """What stands under "status"; nothing where it is missing. Raises InputError."""
    if "status" not in document.values:
        return RigStatus({}, ())
    block = document.block("status")
    block.expect_keys(("cameras",), ("sigmas_include",))
    cameras = {}
    for name, camera in block.block("cameras").blocks():
        camera.expect_keys(("status",), ("notes",))
        notes = camera.texts("notes") if "notes" in camera.values else ()
        cameras[name] = CameraStatus(camera.text("status"), notes)
    included = block.texts("sigmas_include") if "sigmas_include" in block.values else ()
    return RigStatus(cameras, included)
