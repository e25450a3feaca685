"""The report's figures: each module draws one, without pyplot and its global state."""
