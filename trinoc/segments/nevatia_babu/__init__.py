"""The chain of Nevatia and Babu, in the order of the work.

masks, gradient -> pyramid -> thinning -> linking, chains -> polygon, straight_runs,
two_scale -> edge_points, line_fit -> bridge_gaps -> edge_interference -> nfa, shading, accept ->
covariance, edge_errors -> endpoints. Source: R. Nevatia, K. R. Babu, "Linear feature extraction
and description" (1980)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
