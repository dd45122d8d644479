"""The sentence in every file that tells its reader, without this program, what numbers mean."""

CONVENTIONS = (
    "World: right-handed, mm, Z up out of the sheet Z = 0. Camera: x right, y down, z forward; "
    "x_cam = cam_from_world (X, Y, Z, 1). Pixel (u, v) = (column, row), (0, 0) is the centre of "
    "the top-left pixel. Pan is the azimuth of the camera from -Y toward +X, tilt its elevation "
    "above Z = 0, swing turns the picture's x toward its y, distance is from the point aim of the "
    "sheet, on the optical axis, to the camera's centre. Distortion brown_conrady: k1, k2, p1, "
    "p2, k3 on normalised coordinates; rational and thin_prism: OpenCV's 8 and 12 coefficients; "
    "kannala_brandt: k1 to k4 of OpenCV's fisheye; splined_ before a name: its coefficients, then "
    "the logarithms of half the extent of a grid in focal lengths, and 10 rows of 12 control "
    "points (px) of a cubic B-spline for du, and for dv, by which its pixels are moved. "
    "Covariance: degrees and mm."
)
