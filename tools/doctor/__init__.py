"""The doctor: what this machine allows the loop, a measurement, and what to change."""
