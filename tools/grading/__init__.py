"""Grading: holds what a run must show against what its log says."""
