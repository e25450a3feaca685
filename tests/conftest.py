"""What all tests share: hypothesis without a deadline, as machines are shared; fuzzers are not collected."""

from hypothesis import settings

collect_ignore = ["fuzz"]

settings.register_profile("shared-machine", deadline=None)
settings.load_profile("shared-machine")
