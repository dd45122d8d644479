"""Tests whether estimated quantities contradict their priors.

Let theta be the unknowns with a prior of mean mu and covariance P_0, and P their covariance after
the fit. If model and priors are right, theta - mu has the covariance P_0 - P. Then

    (theta - mu)^T (P_0 - P)^+ (theta - mu)

has a chi-square distribution. Directions that the images do not determine have P = P_0 and are
omitted. If the images determine only one combination of two unknowns, the correlation of these is 1
in P_0 - P, and both differ from their priors by the same number of sigmas. The images then cannot
show which of them is wrong.

Reference: J. A. Hausman, "Specification tests in econometrics", Econometrica 46(6), 1978.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment, prior_weights
from trinoc.calib.problem.sheet import BentPaper
from trinoc.calib.tuning.every_group import TUNING, AnswerTuning
from trinoc.numerics.tails import chi_square_tail, normal_limit

# numerical: variances of a prior below this share of its largest are rounding.
_ROUNDING = 1e-10


class Unknown(NamedTuple):
    """A quantity with a prior, such as a focal length, as a linear function of the estimated
    parameters.

    Attributes
    ----------
    kind : "focal length", "aspect", "principal point", "distortion", "aim", "print size", "print
        aspect", "bend", or "all".
    views : indices of the cameras to which the lens or the aim belongs; empty for the sheet.
    by_step : (k, f) derivative of the k components of the quantity with respect to the f estimated
        parameters. A component is relative, or its unit is px or mm.
    """

    kind: str
    views: tuple[int, ...]
    by_step: Float[np.ndarray, "k f"]


class PriorPull(NamedTuple):
    """Difference between the estimate of a quantity and the mean of its prior, with a test.

    Attributes
    ----------
    unknown : the tested quantity.
    offset : (k,) estimate minus prior mean, in the unit of the quantity.
    freedom : number of directions of the quantity that the images determine.
    p_value : probability of an equal or larger difference if model and priors are right.
    partners : other contradicted quantities that the images cannot distinguish from this one. Only
        one of them need be wrong.
    largest_sigmas : number of sigmas above which the prior is contradicted.
    """

    unknown: Unknown
    offset: Float[np.ndarray, "k"]
    freedom: int
    p_value: float
    partners: tuple[Unknown, ...] = ()
    largest_sigmas: float = TUNING.answer.strain_sigmas

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The tested quantity and its `partners`."""
        return (self.unknown, *self.partners)

    @property
    def views(self) -> frozenset[int]:
        """Indices of the cameras whose given lens or aim is contradicted.

        Empty if the sheet may be the cause.
        """
        if not all(unknown.views for unknown in self.unknowns):
            return frozenset()
        return frozenset(view for unknown in self.unknowns for view in unknown.views)

    def concerns_aim(self, view: int) -> bool:
        """True if the images contradict the prior of the aim of the camera with index `view`.

        The aim is the point where the optical axis meets the sheet.
        """
        return any(unknown.kind == "aim" and view in unknown.views for unknown in self.unknowns)

    @property
    def sigmas(self) -> float:
        """Difference in sigmas: two-sided deviation of a standard normal variable with the same
        p-value.
        """
        return float(normal_limit(max(0.5 * self.p_value, 1e-300)))

    @property
    def is_refuted(self) -> bool:
        """True if the images contradict the prior of the quantity."""
        return self.sigmas > self.largest_sigmas


def refuted_priors(adjustment: Adjustment) -> list[PriorPull]:
    """Quantities whose priors the images contradict, with the largest contradiction first.

    Quantities that the images cannot distinguish are one entry; all but one are its `partners`.
    """
    space = PriorSpace.of(adjustment)
    pulls = [space.pull(unknown) for unknown in unknowns_with_priors(adjustment)]
    refuted = sorted(
        (pull for pull in pulls if pull.is_refuted), key=lambda pull: pull.sigmas, reverse=True
    )
    if any(pull.unknown.kind != "all" for pull in refuted):
        refuted = [pull for pull in refuted if pull.unknown.kind != "all"]
    entries: list[PriorPull] = []
    while refuted:
        first, *others = refuted
        partners = [pull for pull in others if space.are_inseparable(first, pull)]
        entries.append(first._replace(partners=tuple(pull.unknown for pull in partners)))
        refuted = [pull for pull in others if not any(pull is partner for partner in partners)]
    return entries


class PriorSpace(NamedTuple):
    """Differences of all estimated parameters from their prior means, with their expected
    covariance.

    Attributes
    ----------
    weights : (f,) inverse prior sigma of each parameter; 0 without a prior.
    offset : (f,) estimate minus prior mean of each parameter, in prior sigmas.
    expected : (f, f) covariance of `offset` if model and priors are right: prior covariance minus
        posterior covariance, in prior sigmas.
    tuning : limits of the tests.
    """

    weights: Float[np.ndarray, "f"]
    offset: Float[np.ndarray, "f"]
    expected: Float[np.ndarray, "f f"]
    tuning: AnswerTuning = TUNING.answer

    @classmethod
    def of(cls, adjustment: Adjustment) -> "PriorSpace":
        """Compute differences and expected covariance from an adjustment."""
        weights = prior_weights(adjustment.problem)[adjustment.free]
        posterior = weights[:, None] * adjustment.covariance * weights
        expected = np.diag((weights > 0).astype(float)) - posterior
        tuning = adjustment.problem.tuning.answer
        return cls(weights, weights * _offsets(adjustment), expected, tuning)

    def pull(self, unknown: Unknown) -> PriorPull:
        """Test the difference of one quantity from its prior mean."""
        combinations = self._determined(unknown)
        squared, freedom = float(np.sum((combinations @ self.offset) ** 2)), len(combinations)
        p_value = float(chi_square_tail(squared, freedom)) if freedom else 1.0
        return PriorPull(
            unknown,
            self._by_sigma(unknown) @ self.offset,
            freedom,
            p_value,
            largest_sigmas=self.tuning.strain_sigmas,
        )

    def are_inseparable(self, first: PriorPull, second: PriorPull) -> bool:
        """True if the images cannot decide which of two contradicted quantities is wrong.

        The images then determine only one combination of both, and both have similar differences in
        sigmas. The criterion is the largest canonical correlation in `expected`.

        References
        ----------
        H. Hotelling, "Relations between two sets of variates", Biometrika 28, 1936.
        """
        largest = self.tuning.inseparable
        if second.sigmas < largest * first.sigmas:
            return False
        rows, columns = (self._determined(pull.unknown) for pull in (first, second))
        across = rows @ self.expected @ columns.T
        return bool(np.linalg.norm(across, 2) > largest)

    def _by_sigma(self, unknown: Unknown) -> Float[np.ndarray, "k f"]:
        """Derivative, (k, f), of a quantity's k components with respect to the f estimated
        parameters, each in units of its prior sigma.

        Columns of parameters without a prior are 0.
        """
        has_prior = self.weights > 0
        return np.where(has_prior, unknown.by_step / np.where(has_prior, self.weights, 1.0), 0.0)

    def _determined(self, unknown: Unknown) -> Float[np.ndarray, "r f"]:
        """Linear combinations, (r, f), of a quantity's components that the images determine.

        They are scaled to unit expected covariance.
        """
        by_sigma = self._by_sigma(unknown)
        scale = np.linalg.norm(by_sigma, axis=1)
        unit = by_sigma[scale > 0] / scale[scale > 0, None]
        _, values, right = np.linalg.svd(unit, full_matrices=False)
        # Combinations with unit prior covariance.
        whitened = right[values > _ROUNDING * values.max(initial=0.0)]
        shares, axes = np.linalg.eigh(whitened @ self.expected @ whitened.T)
        is_determined = shares > self.tuning.least_share_of_prior
        return (axes[:, is_determined] / np.sqrt(shares[is_determined])).T @ whitened


def unknowns_with_priors(adjustment: Adjustment) -> list[Unknown]:
    """All quantities whose priors are tested: parameters of lenses, aims, print and bend of the
    sheet.

    The last quantity combines all of them.
    """
    size = len(adjustment.free)
    weights = prior_weights(adjustment.problem)[adjustment.free]
    unknowns = [*_of_lenses(adjustment), *_of_aims(adjustment), *_of_sheet(adjustment)]
    unknowns.append(Unknown("all", (), np.eye(size)[weights > 0]))
    return [unknown for unknown in unknowns if np.any(unknown.by_step[:, weights > 0])]


def _offsets(adjustment: Adjustment) -> Float[np.ndarray, "f"]:
    """Estimate minus prior mean of each parameter in local coordinates, (f,); 0 without a prior."""
    problem = adjustment.problem
    head_offset, parametrization = np.zeros(len(problem.free)), problem.parametrization
    head_offset[problem.slices.sheets] = (
        np.asarray(problem.state.sheet) / parametrization.sheet_scale
    )
    offset = head_offset[adjustment.free]
    for view in range(len(adjustment.used)):
        rows = adjustment.lens_rows(view)
        if len(rows):
            offset[rows] = adjustment.lens_steps(view)
        aim = adjustment.rows(view)[4:6]
        if len(aim):
            offset[aim] = adjustment.parameters(view)[4:6] / float(parametrization.unit_mm)
    return offset


def _of_lenses(adjustment: Adjustment) -> list[Unknown]:
    parametrization, unknowns = adjustment.problem.parametrization, []
    count = len(adjustment.used)
    lens_of_camera = np.asarray(parametrization.lens_of_camera)[:count]
    for lens_index in dict.fromkeys(lens_of_camera.tolist()):
        views = tuple(np.flatnonzero(lens_of_camera == lens_index).tolist())
        rows = adjustment.lens_rows(views[0])
        by_step = np.zeros((parametrization.lens_basis.shape[1], len(adjustment.free)))
        by_step[:, rows] = np.asarray(parametrization.lens_basis)[lens_index][:, : len(rows)]
        focal_px = np.asarray(adjustment.lens(views[0]).focal_length_px)
        relative = by_step[:2] / focal_px[:, None]
        by_step_of_kind = {
            "focal length": relative.mean(axis=0, keepdims=True),
            "aspect": relative[:1] - relative[1:],
            "principal point": by_step[2:4],
            "distortion": by_step[4:],
        }
        unknowns += [
            Unknown(kind, views, derivative) for kind, derivative in by_step_of_kind.items()
        ]
    return unknowns


def _of_aims(adjustment: Adjustment) -> list[Unknown]:
    unknowns, unit_mm = [], float(adjustment.problem.parametrization.unit_mm)
    for view in range(len(adjustment.used)):
        rows = adjustment.rows(view)[4:6]
        by_step = np.zeros((len(rows), len(adjustment.free)))
        by_step[np.arange(len(rows)), rows] = unit_mm
        unknowns.append(Unknown("aim", (view,), by_step))
    return unknowns


def _of_sheet(adjustment: Adjustment) -> list[Unknown]:
    sheet_scale = adjustment.problem.parametrization.sheet_scale
    first = adjustment.problem.slices.sheets.start
    position = {int(step): k for k, step in enumerate(adjustment.free)}
    by_name = np.zeros((len(BentPaper.names), len(adjustment.free)))
    for k, _ in enumerate(BentPaper.names):
        if first + k in position:
            by_name[k, position[first + k]] = sheet_scale[k]
    size, along_x, along_y, *heights = by_name
    return [
        Unknown("print size", (), (size + 0.5 * (along_x + along_y))[None]),
        Unknown("print aspect", (), (along_x - along_y)[None]),
        *(Unknown("bend", (), height[None]) for height in heights),
    ]


def list_kinds(pull: PriorPull) -> tuple[str, ...]:
    """Kinds of a contradicted quantity and its partners, without repetition.

    Of several quantities of one lens, only the first is listed: one wrong lens explains all of
    them.
    """
    by_owner: dict[tuple[str, tuple[int, ...]], str] = {}
    for unknown in pull.unknowns:
        of_lens = unknown.kind not in ("aim", "bend", "print size", "print aspect", "all")
        by_owner.setdefault(("lens" if of_lens else unknown.kind, unknown.views), unknown.kind)
    return tuple(dict.fromkeys(by_owner.values()))
