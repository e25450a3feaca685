"""What all tests share: hypothesis without a deadline, as machines are shared, and no collection of fuzzers."""

from hypothesis import settings

collect_ignore = ["fuzz"]

settings.register_profile("shared-machine", deadline=None)
settings.load_profile("shared-machine")
