"""Links that carry bytes: one contract, opened by URL."""
