"""Result of every calibration: rig, covariance, status, and the quality of each fit."""
