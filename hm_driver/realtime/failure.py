"""Errors on their way from the loop's process to the application: class and arguments as text."""

import json

from hm_driver import errors
from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    HapticMasterError,
    LoopError,
    SafetyTrip,
)


def encode_error(error: HapticMasterError) -> tuple[str, str]:
    """Name of the error's class, and its arguments as JSON."""
    if isinstance(error, ConfigurationError):
        arguments = [error.field, error.problem]
    elif isinstance(error, DeviceError):
        arguments = [error.command, error.reply]
    elif isinstance(error, SafetyTrip):
        arguments = [error.reason, error.detail]
    else:
        arguments = [str(error)]
    return type(error).__name__, json.dumps([argument[:400] for argument in arguments])


def decode_error(kind: str, text: str) -> HapticMasterError:
    """The error that was encoded, or a `LoopError` with its text where the class is unknown."""
    error_class = getattr(errors, kind, None)
    try:
        arguments = json.loads(text)
        if isinstance(error_class, type) and issubclass(error_class, HapticMasterError):
            return error_class(*arguments)
    except (TypeError, ValueError):
        pass
    return LoopError(f"the loop failed: {kind} {text}".rstrip())
