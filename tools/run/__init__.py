"""The composition of a session: options, real time, lock-step, and what is logged."""
