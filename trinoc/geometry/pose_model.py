"""Which parameters of a pose are free."""

from enum import Enum

from trinoc.errors import InputError


class PoseModel(Enum):
    """What a fit may change of a camera's pose, with the names of the parameters.

    AIMED : pan, tilt, swing and distance; the point of the sheet that the optical axis meets is
        held, at the origin unless something else is said.
    AIM_FREE : these and the aim, so any pose whose axis meets the sheet Z = 0.
    RIGID : any rigid motion, as a rotation and a displacement from where the camera was.

    The angles come first in each, and there are three of them.
    """

    AIMED = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
    AIM_FREE = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm", "aim_x_mm", "aim_y_mm")
    RIGID = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "centre_x_mm", "centre_y_mm", "centre_z_mm")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names, with units, of the parameters of one camera."""
        return self.value

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.value)

    @property
    def word(self) -> str:
        """The model as options spell it: "aimed", "aim-free" or "rigid"."""
        return self.name.lower().replace("_", "-")

    @classmethod
    def of(cls, given: "PoseModel | str") -> "PoseModel":
        """A model from itself or its word. Raises InputError for anything else."""
        for model in cls:
            if given is model or given == model.word:
                return model
        words = ", ".join(f'"{model.word}"' for model in cls)
        raise InputError(f"pose_model is {given!r}, but must be one of {words}, or a PoseModel.")


def pose_model_over_sheet(pose_model: PoseModel | str | None, parameters: int | None) -> PoseModel:
    """The model of cameras that a sheet places, by itself or by its number of parameters.

    AIMED unless one is given. Raises InputError for RIGID, another number, or two that differ.
    """
    by_count = {model.size: model for model in (PoseModel.AIMED, PoseModel.AIM_FREE)}
    if parameters is not None and parameters not in by_count:
        raise InputError(f"parameters is {parameters}, but must be 4 (aim held) or 6 (free).")
    if pose_model is None:
        return PoseModel.AIMED if parameters is None else by_count[parameters]
    model = PoseModel.of(pose_model)
    if model is PoseModel.RIGID:
        raise InputError(
            'pose_model is "rigid", but a camera over the sheet is described by its aim: give '
            '"aim-free", which is any pose that looks at the sheet.'
        )
    if parameters not in (None, model.size):
        raise InputError(
            f'pose_model "{model.word}" has {model.size} parameters, but parameters is '
            f"{parameters}: give one of the two."
        )
    return model
