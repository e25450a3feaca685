"""Questions to a log, and new logs made of old ones."""
