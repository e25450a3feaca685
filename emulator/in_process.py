r"""The emulator in this process, in lock-step: its time passes when it is told to, and by as much.

>>> from emulator.in_process import LockstepEmulator
>>> emulator = LockstepEmulator(init_seconds=0.5)
>>> emulator.handle(b"get state; get inertia\n")
b'off;3;\n'
>>> emulator.handle(b"set state init\n")
b"state set to 'init';\n"
>>> emulator.advance_to_ns(2_000_000_000)
>>> emulator.handle(b"get state\n")
b'stop;\n'
"""

import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from emulator.device import EmulatedDevice
from emulator.faults import FaultInjector
from emulator.interpreter import Interpreter
from emulator.parameters import ArmParameters, load_parameters
from emulator.phrases import Book
from emulator.reply_faults import spoil
from emulator.world import Truth
from emulator.world_service import LocalWorld, WorldService
from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.framing import Dialect, RequestDecoder, encode_reply, render_value
from hm_driver.protocol.vocabulary import error_reply
from hm_driver.transport.in_process import InProcessTransport
from hm_driver.transport.urls import DeviceUrl


class Arm(NamedTuple):
    """Arrays of the arm, as `emulator.kernels.advance` takes them."""

    state: npt.NDArray[np.float64]
    params: npt.NDArray[np.float64]
    effects: npt.NDArray[np.float64]
    active: npt.NDArray[np.int64]
    outputs: npt.NDArray[np.float64]


class Inside(NamedTuple):
    """What a compiled client needs to run and ask the emulator without Python; good until Python has it."""

    arm: Arm
    active_effects: int
    """How many entries of ``arm.active`` count."""
    book: Book
    """The requests that `emulator.phrases.answer` carries out."""
    next_step: int
    """Step at which something is due that only Python does."""
    is_plain: bool
    """Whether every request gets its reply, at once and whole."""


class LockstepEmulator:
    """An emulated HapticMASTER and its world on a virtual clock; fulfils the in-process transport's peer.

    Two emulators of one seed that are told the same answer the same, byte for byte. Faults of the link act
    as far as they can without time passing: a lost reply, or one of a frozen device, is empty; delays,
    splits and merges are not seen.

    Args:
        parameters: The arm; the default one if None.
        seed: Of the sensors' noise.
        init_seconds: Device time that an initialisation takes [s].
    """

    def __init__(
        self, parameters: ArmParameters | None = None, *, seed: int = 0, init_seconds: float = 3.0
    ) -> None:
        self.device = EmulatedDevice(parameters or load_parameters(), seed=seed, init_seconds=init_seconds)
        self.faults = FaultInjector(self.device, seed=seed)
        self._interpreter = Interpreter(self.device)
        self._service = WorldService(self.device, self.faults, is_lockstep=True)
        self.world = LocalWorld(self._service)
        """The hand's way to the arm; the same methods as `emulator.world.WorldClient`."""
        self._link = self.faults.link
        arm = self.device.arm
        self._arm = Arm(arm.state, arm.params, arm.effects.flat, arm.effects.active, arm.outputs)
        self._decoder = RequestDecoder()
        self._is_between_requests = True

    def handle(self, data: bytes) -> bytes:
        """Answer what a client sent; empty while a request is incomplete, or where a fault eats the reply."""
        is_plain = data[:1] > b"\x1f" and data.find(b"\n") == len(data) - 1
        if is_plain and self._is_between_requests and not self._link.is_active:
            try:
                return self._interpreter.answer(data[:-1].decode("ascii")).encode("ascii")
            except UnicodeDecodeError:
                pass
        return self._handle_carefully(data)

    def advance_to_ns(self, time_ns: int) -> None:
        """Let time pass until `time_ns` after the start [ns]: floor(t * 2500) steps in all."""
        self._service.advance_to_ns(time_ns)

    def inside(self) -> Inside:
        """The emulator as a kernel sees it; `ran_to` tells what was done with it."""
        return Inside(
            self._arm,
            self.device.arm.effects.n_active,
            self._interpreter.phrases.book(),
            self.device.agenda.next_step,
            self._is_between_requests and not self._link.is_active,
        )

    def ran_to(self, step: int, requests: int) -> None:
        """Note that a kernel ran the arm up to a step, and answered so many requests."""
        self.device.ran_to(step)
        self._interpreter.answered += requests

    def truth(self) -> Truth:
        """What is true now."""
        return self._service.truth()

    def _handle_carefully(self, data: bytes) -> bytes:
        decoder = self._decoder
        try:
            requests = decoder.feed(data)
        except ProtocolError as error:
            dialect = decoder.dialect or Dialect.TEXT
            self._begin_anew()
            return encode_reply(dialect, [render_value(error_reply(str(error)), dialect)])
        dialect = decoder.dialect or Dialect.TEXT
        self._is_between_requests = False
        if requests:
            self._begin_anew()
        if self._link.is_frozen:
            return b""
        replies = []
        for request in requests:
            reply = self._interpreter.reply(request, dialect)
            replies.append(
                spoil(reply, dialect, self._link, self.faults.random) if self._link.is_active else reply
            )
        return b"".join(replies)

    def _begin_anew(self) -> None:
        self._decoder = RequestDecoder()
        self._is_between_requests = True


class WallClockPeer:
    """A lock-step emulator whose time catches up with the wall clock whenever it is asked something.

    Args:
        emulator: The emulator.
    """

    def __init__(self, emulator: LockstepEmulator) -> None:
        self.emulator = emulator
        self._start_ns = time.monotonic_ns()

    def handle(self, data: bytes) -> bytes:
        """Let the time pass that went by since the last request, then answer."""
        self.emulator.advance_to_ns(time.monotonic_ns() - self._start_ns)
        return self.emulator.handle(data)


def open_sim(url: DeviceUrl, *, timeout_s: float) -> InProcessTransport:  # noqa: ARG001 - an opener's signature
    """Open ``sim://[?seed=0&init_seconds=3]``: an emulator of one's own in this process, on the wall clock.

    It needs neither process nor socket; what it cannot do is move on its own while nobody asks.

    Raises:
        ConfigurationError: An unknown option, or a value that is no number or out of range.
    """
    options = dict(url.options)
    seed = _parse_option(url, "seed", options.pop("seed", "0"))
    init_seconds = _parse_option(url, "init_seconds", options.pop("init_seconds", "3"))
    if options:
        known = "dialect, seed, init_seconds"
        raise ConfigurationError("device", f"{url.url}: unknown option {min(options)}; sim knows: {known}")
    emulator = LockstepEmulator(seed=int(seed), init_seconds=init_seconds)
    return InProcessTransport(WallClockPeer(emulator), url=url.url)


def _parse_option(url: DeviceUrl, name: str, text: str) -> float:
    try:
        return float(text) if name == "init_seconds" else int(text)
    except ValueError:
        raise ConfigurationError("device", f"{url.url}: {name} {text!r} is no number") from None
