"""Errors on their way from the loop's process to the application: class, arguments and data as text."""

import json

from hm_driver import errors
from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    HapticMasterError,
    LoopError,
    ProtocolError,
    SafetyTrip,
    TransportError,
)


def encode_error(error: HapticMasterError) -> tuple[str, str]:
    """Name of the error's class, and its arguments as JSON, with what an exchange was about."""
    data: dict[str, str] = {}
    if isinstance(error, ConfigurationError):
        arguments = [error.field, error.problem]
    elif isinstance(error, DeviceError):
        arguments = [error.command, error.reply]
    elif isinstance(error, SafetyTrip):
        arguments = [error.reason, error.detail]
    else:
        arguments = [str(error)]
        if isinstance(error, TransportError | ProtocolError):
            data = {"command": error.command[:200], "received": error.received[:200]}
    return type(error).__name__, json.dumps([[argument[:400] for argument in arguments], data])


def decode_error(kind: str, text: str) -> HapticMasterError:
    """The error that was encoded, or a `LoopError` with its text where the class is unknown."""
    error_class = getattr(errors, kind, None)
    try:
        arguments, data = json.loads(text)
        if isinstance(error_class, type) and issubclass(error_class, HapticMasterError):
            return error_class(*arguments, **data)
    except (TypeError, ValueError):
        pass
    return LoopError(f"the loop failed: {kind} {text}".rstrip())
