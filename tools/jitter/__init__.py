"""The jitter suite: runs the real loop beside loads, and judges its punctuality by paired canaries."""
