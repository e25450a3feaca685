"""Pytest fixtures that start the emulated HapticMASTER."""
