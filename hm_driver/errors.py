"""The one tree of errors. Each says what happened, where, the value and the limit, and what to do next.

::

    HapticMasterError
    ├── ConfigurationError (ValueError)       a field of a configuration, an option or an argument is wrong
    ├── TransportError (ConnectionError)      the link to the device
    │   ├── TransportTimeout (TimeoutError)   no answer in time
    │   └── TransportClosed                   the peer is gone, or the link was closed
    ├── ProtocolError (ValueError)            bytes or text that are not what the protocol allows
    ├── DeviceError (RuntimeError)            the device answered a command with an error
    ├── DeviceFault (RuntimeError)            the device is in no state to go on; the arm was made safe
    │   └── SafetyTrip                        one of our own limits tripped; the arm was made safe
    ├── LoopError (RuntimeError)              the driver loop could not start or died
    └── RecordingError (OSError)              a log could not be written or read
"""

from typing import Self

_LONGEST_SHOWN = 80


class HapticMasterError(Exception):
    """Every error that this software raises on purpose."""


class ConfigurationError(HapticMasterError, ValueError):
    """A value that a user gave is wrong.

    Args:
        field: Dotted name of the field, as the user wrote it (``learner.w_gen``).
        problem: What is wrong, with the value, the limit and the next step.
        source: File or option that the value came from.
    """

    def __init__(self, field: str, problem: str, *, source: str = "") -> None:
        self.field = field
        self.problem = problem
        self.source = source
        super().__init__(f"{source}: {field}: {problem}" if source else f"{field}: {problem}")


class TransportError(HapticMasterError, ConnectionError):
    """The link to the device failed.

    Args:
        message: What happened, and what to do next.
        command: The command that was not answered; empty where the link failed outside an exchange.
        received: What had come of a reply until then.
    """

    def __init__(self, message: str, *, command: str = "", received: str = "") -> None:
        self.command = command
        self.received = received
        super().__init__(message)

    @property
    def reply(self) -> str:
        """What had come of a reply, as `DeviceError.reply`."""
        return self.received

    def about(self, command: str, *, received: str = "") -> Self:
        """The same error, which says what the command was; this one where it says so already."""
        if self.command:
            return self
        return type(self)(_naming(self, command), command=command, received=received or self.received)


class TransportTimeout(TransportError, TimeoutError):
    """The peer did not answer in time."""


class TransportClosed(TransportError):
    """The link is closed: by the peer, by a cut, or by ourselves."""


class ProtocolError(HapticMasterError, ValueError):
    """Bytes or text that the protocol does not allow.

    Args:
        message: What is wrong and what would have been right.
        command: The command that was answered so; empty outside an exchange.
        received: What was received.
    """

    def __init__(self, message: str, *, command: str = "", received: str = "") -> None:
        self.command = command
        self.received = received
        super().__init__(message)

    @property
    def reply(self) -> str:
        """What was received, as `DeviceError.reply`."""
        return self.received

    def about(self, command: str) -> Self:
        """The same error, which says what the command was; this one where it says so already."""
        if self.command:
            return self
        return type(self)(_naming(self, command), command=command, received=self.received)


class DeviceError(HapticMasterError, RuntimeError):
    """The device refused a command.

    Args:
        command: The command as sent.
        reply: The reply as received; it contains ``--- ERROR``.
    """

    def __init__(self, command: str, reply: str) -> None:
        self.command = command
        self.reply = reply
        super().__init__(f"the device refused {command!r}: {reply}")


class DeviceFault(HapticMasterError, RuntimeError):
    """The device is in no state to go on."""


class SafetyTrip(DeviceFault):
    """One of the limits below every mode tripped, and the arm was brought to a safe state.

    Args:
        reason: The limit, as the log names it.
        detail: The value and the limit with their unit, and what to do next.
    """

    def __init__(self, reason: str, detail: str) -> None:
        self.reason = reason
        self.detail = detail
        super().__init__(f"{reason}: {detail}")


class LoopError(HapticMasterError, RuntimeError):
    """The driver loop could not start, or died."""


class RecordingError(HapticMasterError, OSError):
    """A log could not be written or read."""


def _naming(error: Exception, command: str) -> str:
    shown = command if len(command) <= _LONGEST_SHOWN else f"{command[: _LONGEST_SHOWN - 3]}..."
    return f"{error}; the command was {shown!r}"
