"""Recording a session: ring in shared memory -> recorder process -> MCAP, and reading it back."""
