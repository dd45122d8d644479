"""Boards: the printed sheet of circles and crossed lines, boards of squares and tags, and sets."""
