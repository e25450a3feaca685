"""Before this software drives a robot: the first run, and the comparison with the fidelity table."""
