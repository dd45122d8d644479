"""Cameras, rigs, images of circles, epipolar geometry, lines and triangulation.

Pure JAX for one item; `vmap` stands outside. The values that calibration and matching share
(`Camera`, `Rig`, `Segments`, `Junctions`, `LineObservations`) live here. Source: Hartley and
Zisserman, "Multiple View Geometry" (2003)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
