"""What puts the other packages together: the ``hm`` command, sessions, live view, reports, checks."""
