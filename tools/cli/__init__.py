"""The ``hm`` command line."""
