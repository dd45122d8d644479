"""Has a camera been knocked since the rig was calibrated? Asked of scene pictures alone.

Each camera in turn is freed of what the sheet once said of it, while the others keep it. The
fall of the joint chi-square is the evidence that this camera moved; without motion it is
distributed as chi-square with as many degrees of freedom as the camera has parameters.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy import stats

from trinoc.calib.joint.refine import Matched, Matcher, refine
from trinoc.calib.joint.result import RefineResult, RefineStatus
from trinoc.errors import CalibrationError
from trinoc.geometry.line_observations import LineObservations
from trinoc.geometry.rig import Rig

# Below this many sigmas a motion is not told from chance; with three cameras asked, one rig
# in 120 that stands still is suspected all the same.
SUSPECT_SIGMAS = 3.0


class CameraMotion(eqx.Module):
    """How far the scene's segments place one camera from where the sheet had placed it.

    Fields
    ------
    name : of the camera.
    sigmas : significance of the motion, as sigmas of a normal distribution (two-sided).
    parameters : names, such as "pan_deg".
    change : (p,) of the parameters, scene minus sheet, in degrees and mm.
    sigma : (p,) of the change, both sides' errors together.
    """

    name: str = eqx.field(static=True)
    sigmas: float = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    change: Float[np.ndarray, "p"]
    sigma: Float[np.ndarray, "p"]


class RigCheck(eqx.Module):
    """Whether a rig still stands as it was calibrated.

    Fields
    ------
    motions : per camera, were it the only one that moved.
    moved : names of the cameras to suspect, the most significant first; others follow where
        freeing the first does not explain the scene.
    refined : the rig with the suspect camera mended by the segments; None where nothing
        moved, or where more moved than segments can mend.
    """

    motions: tuple[CameraMotion, ...]
    moved: tuple[str, ...] = eqx.field(static=True)
    refined: RefineResult | None

    def summary(self) -> str:
        """One sentence of verdict, and one line per camera."""
        if not self.moved:
            verdict = "No camera has moved by more than the error bars allow."
        elif self.refined is not None:
            verdict = f'Camera "{self.moved[0]}" has moved; the segments tell where it is now.'
        elif len(self.moved) == 1:
            verdict = (
                f'A camera has moved, most likely "{self.moved[0]}", but the segments do not tell '
                "where it is now: calibrate the rig again with the sheet."
            )
        else:
            verdict = (
                "More than one camera has moved, which segments alone cannot mend: "
                "calibrate the rig again with the sheet."
            )
        rows = [verdict]
        for motion in self.motions:
            changes = ", ".join(
                f"{name} {change:+.4f} +- {sigma:.4f}"
                for name, change, sigma in zip(
                    motion.parameters, motion.change, motion.sigma, strict=True
                )
            )
            rows.append(f"{motion.name}: {motion.sigmas:.1f} sigma if it alone moved ({changes})")
        return "\n".join(rows)


def check_rig(
    rig: Rig,
    matches: Matched | LineObservations,
    *,
    match_again: Matcher | Sequence[Matcher] | None = None,
) -> RigCheck:
    """Ask the segments of a scene whether each camera still stands where `rig` says.

    `rig` needs the covariance of its calibration, since motion is measured against it. With
    `match_again`, as `refine` takes it, a knock that hid most of the scene from the matcher is
    found too: the scene is matched again with each camera freed, and asked where that is most
    probable. Raises CalibrationError where the rig has no covariance or where fewer than three
    cameras see the scene: two views of lines agree with any motion.
    """
    if not rig.parameters or len(rig) < 3:
        raise CalibrationError(
            "Whether a camera moved can be told only for three or more cameras with the "
            "covariance of their calibration: give the rig.json that `trinoc calibrate` wrote."
        )
    motions, freed = _motions(rig, matches)
    strongest = max(motions, key=lambda motion: motion.sigmas).name
    if max(motion.sigmas for motion in motions) < SUSPECT_SIGMAS:
        return RigCheck(motions, (), None)
    mended = freed[strongest]
    if match_again is not None:
        found = [refine(rig, matches, moved=(name,), match_again=match_again) for name in rig.names]
        settled = [result for result in found if result.status is RefineStatus.CONVERGED]
        if not settled:
            return RigCheck(motions, (strongest,), None)
        best = max(settled, key=lambda result: result.log_posterior)
        mended, matches = best, best.tracks
        motions, _ = _motions(rig, matches)
        strongest = rig.names[found.index(best)]
    others = [name for name in rig.names if name != strongest]
    noise = max(mended.segment_sigma_factor, 1.0)
    further = {
        name: _significance(mended, refine(rig, matches, moved=(strongest, name)), noise)
        for name in others
    }
    also = tuple(name for name in others if further[name] >= SUSPECT_SIGMAS)
    if also or mended.status is RefineStatus.NOT_CONVERGED:
        return RigCheck(motions, (strongest, *also), None)
    return RigCheck(motions, (strongest,), mended)


def _motions(
    rig: Rig, matches: Matched | LineObservations
) -> tuple[tuple[CameraMotion, ...], dict[str, RefineResult]]:
    """The motion of each camera were it the only one, and the rig with it freed."""
    at_rest = refine(rig, matches)
    freed = {name: refine(rig, matches, moved=(name,)) for name in rig.names}
    # The best explanation sets the noise; a moved camera would inflate it otherwise.
    noise = min(result.segment_sigma_factor for result in (at_rest, *freed.values()))
    noise = max(noise, 1.0)
    motions = tuple(_motion(rig, name, at_rest, freed[name], noise) for name in rig.names)
    return motions, freed


def _motion(
    rig: Rig, name: str, at_rest: RefineResult, freed: RefineResult, noise: float
) -> CameraMotion:
    rows = [i for i, parameter in enumerate(freed.parameters) if parameter.startswith(name + ".")]
    own = tuple(freed.parameters[i].removeprefix(name + ".") for i in rows)
    sheet = np.array([np.nan_to_num(rig.sigma(f"{name}.{parameter}")) for parameter in own])
    before = np.array([_value(rig, name, parameter) for parameter in own])
    change = freed.values[rows] - before
    angles = np.array([parameter.endswith("_deg") for parameter in own])
    change = np.where(angles, (change + 180) % 360 - 180, change)
    variance = np.diag(freed.covariance)[rows] + sheet**2
    sigmas = _significance(at_rest, freed, noise)
    return CameraMotion(name, sigmas, own, change, np.sqrt(variance))


def _value(rig: Rig, name: str, parameter: str) -> float:
    camera = rig[name]
    if parameter.startswith("aim_"):
        return camera.aim_mm[0 if parameter == "aim_x_mm" else 1]
    return float(getattr(camera, parameter))


def _significance(held: RefineResult, freed: RefineResult, noise: float) -> float:
    """Sigmas by which the scene prefers one more camera freed of the sheet's word."""
    freed_parameters = len(freed.parameters) // len(freed.rig)
    gain = max(held.chi_square[0] - freed.chi_square[0], 0.0) / noise**2
    return _sigmas(gain, freed_parameters)


def _sigmas(chi_square: float, freedom: int) -> float:
    """Sigmas of a normal distribution, two-sided, of as small a probability."""
    log_tail = stats.chi2.logsf(chi_square, freedom)
    return float(stats.norm.isf(np.exp(max(log_tail, -700.0)) / 2))
