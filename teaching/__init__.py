"""Online teaching by demonstration: local learners, arbitration, accumulation and tasks, without a device."""
