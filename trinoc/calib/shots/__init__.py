"""A rig and its lenses from many shots of a board, by all cameras or some.

lens_start (a first lens and poses for each camera) -> chain (cameras in one frame, by the shots
that they share) -> state, residual, normal_equations, levenberg_marquardt (all together) ->
robust_fit -> covariance, halves, cross_validation, projection -> judged, result; `from_shots` is
the door that users take. candidate_shots -> foreseen -> advised_shot tell what to show next."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
