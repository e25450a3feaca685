"""Studies: many sessions over methods, demonstrators, surfaces and parameters, and what they come to."""
