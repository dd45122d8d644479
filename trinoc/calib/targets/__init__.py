"""Descriptions of printed boards: point positions in mm, ink, and identification marks.

A board is the sheet of circles and crossed lines (`pattern`), a chessboard or ChArUco board
(`checkers`), a grid of AprilTags (`april_grid`), or several of these fixed together (`board_set`).
Detection, calibration and drawing read these values."""
