"""The device as an object: one command in flight, values with units, errors as exceptions."""
