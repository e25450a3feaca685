"""The emulator on the network: one thread that runs the arm at 2500 Hz and answers in between.

The next tick of the grid is the time-out of every wait. At a tick the physics come first, then requests
until the following tick is due, at least one of them; what is left waits. Any client may command: requests
are carried out in the order in which they arrived, one at a time, each answered in one write. Whatever a
peer sends or omits costs bounded memory: it is not listened to while it leaves replies unread or has
requests waiting.
"""

import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from emulator.address import Address
from emulator.connection import Connection, LineDecoder
from emulator.device import EmulatedDevice
from emulator.faults import FaultInjector
from emulator.grid import TickGrid
from emulator.interpreter import Interpreter
from emulator.reply_faults import LateReplies
from emulator.world_service import MAX_LINE, WorldService
from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.framing import Dialect, RequestDecoder, encode_reply, render_value
from hm_driver.protocol.vocabulary import error_reply

MAX_CLIENTS = 64
"""Most connections at a time, of both endpoints together."""
MAX_RECEIVED_A_TICK = 16
"""Most connections that are read from between two ticks."""
MAX_ACCEPTED_A_TICK = 8
"""Most connections that are accepted between two ticks."""
PATIENCE_NS = 10_000_000_000
"""How long a client may leave a request incomplete [ns]."""

_BACKLOG = 128
_HOUSEKEEPING_NS = 1_000_000_000
_RESET = struct.pack("ii", 1, 0)


class OnClientLost(Enum):
    """What the arm does when a client that commanded is gone; nobody knows what the real device does."""

    CONTINUE = "continue"
    STOP = "stop"


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """How the server fares."""

    time_s: float
    """Device time [s]."""
    state: str
    clients: int
    """Connections to the device."""
    ticks: int
    missed: int
    """Periods of 400 µs without a tick of their own."""
    given_up: int
    """Steps that were never run, so that device time lags."""
    requests: int
    """Requests answered."""
    refused: int
    """Commands answered by an error."""
    load: float
    """Share of one core that this thread used since the last status."""


class LogEntry(NamedTuple):
    """One line of the conversation."""

    time_s: float
    """Device time [s]."""
    client: int
    direction: str
    """``>`` request, ``<`` reply, ``+`` connected, ``-`` gone."""
    text: str


class EmulatorServer:
    """Runs a device and serves it; opens its ports in `open`, frees them in `close`.

    Args:
        device: The device.
        faults: What may go wrong.
        listen: Where clients of the device connect.
        world: Where the hand connects.
        on_client_lost: What the arm does when a client that commanded is gone.
        is_lockstep: Time passes only on request of the world endpoint.
        speed: Device seconds a wall second.
        log: Is handed every line of the conversation; it must not block.
        report: Is handed the status about every second; it must not block.
    """

    def __init__(
        self,
        device: EmulatedDevice,
        faults: FaultInjector,
        *,
        listen: Address,
        world: Address,
        on_client_lost: OnClientLost = OnClientLost.CONTINUE,
        is_lockstep: bool = False,
        speed: float = 1.0,
        log: Callable[[LogEntry], None] | None = None,
        report: Callable[[Status], None] | None = None,
    ) -> None:
        self._device = device
        self._faults = faults
        self._interpreter = Interpreter(device)
        self._world = WorldService(device, faults, is_lockstep=is_lockstep)
        self._addresses = (listen, world)
        self._on_client_lost = on_client_lost
        self._is_lockstep = is_lockstep
        self._grid = TickGrid(start_ns=time.monotonic_ns(), speed=speed)
        self._speed = speed
        self._log = log
        self._report = report
        self._listeners: list[socket.socket] = []
        self._connections: set[Connection] = set()
        self._ready: deque[Connection] = deque()
        self._readers: list[socket.socket | Connection | int] = []
        self._writers: list[Connection] = []
        self._late = LateReplies(faults)
        self._are_lists_stale = True
        self._is_work_left = False
        self._turn = 0
        self._accepted = 0
        self._resets = 0
        self._is_stopping = False
        self._next_housekeeping_ns = 0
        self._cpu_s = 0.0
        self._looked_s = 0.0
        self.url = ""
        """Address of the device, once open."""
        self.world_url = ""
        """Address of the world endpoint, once open."""

    def open(self) -> None:
        """Open both ports.

        Raises:
            ConfigurationError: A port is taken, or the address is not this machine's.
        """
        try:
            for field, address in zip(("listen", "world"), self._addresses, strict=True):
                self._listeners.append(_listen(field, address))
        except ConfigurationError:
            self.close()
            raise
        self.url, self.world_url = (
            f"tcp://{address.bracketed_host}:{listener.getsockname()[1]}"
            for address, listener in zip(self._addresses, self._listeners, strict=True)
        )

    def close(self) -> None:
        """Close everything; may be called twice."""
        for connection in self._connections:
            connection.link.close()
        self._connections.clear()
        for listener in self._listeners:
            listener.close()
        self._listeners.clear()

    def stop(self) -> None:
        """Have `run` return; may be called from a signal handler."""
        self._is_stopping = True

    def run(self, *, lifeline: int | None = None) -> None:
        """Serve until `stop` is called, or `lifeline`, a descriptor, has something to read.

        Args:
            lifeline: Read end of a pipe whose other end dies with whoever wants this server.
        """
        self._grid = TickGrid(start_ns=time.monotonic_ns(), speed=self._speed)
        self._cpu_s, self._looked_s = time.thread_time(), time.monotonic()
        while not self._is_stopping:
            if self._are_lists_stale:
                self._list_descriptors(lifeline)
            readable, writable, _ = select.select(self._readers, self._writers, (), self._wait_s())
            if not self._is_lockstep:
                due = self._grid.take_due(time.monotonic_ns())
                if due:
                    self._device.advance(due)
            if lifeline is not None and lifeline in readable:
                return
            if self._faults.link.resets != self._resets:
                self._reset_all()
            if readable or writable or self._ready or self._late:
                self._serve(readable, writable)
            if time.monotonic_ns() >= self._next_housekeeping_ns:
                self._keep_house()

    def _wait_s(self) -> float:
        if self._ready and not self._faults.link.is_frozen:
            return 0.0
        if self._is_lockstep:
            return 0.001 if self._late or self._ready else 1.0
        return max(0.0, (self._grid.next_ns - time.monotonic_ns()) * 1e-9)

    def _list_descriptors(self, lifeline: int | None) -> None:
        self._readers = [*self._listeners, *(c for c in self._connections if c.is_listened_to)]
        if lifeline is not None:
            self._readers.append(lifeline)
        self._writers = [connection for connection in self._connections if connection.outgoing]
        self._are_lists_stale = False

    def _serve(self, readable: list[socket.socket | Connection | int], writable: list[Connection]) -> None:
        now_ns = time.monotonic_ns()
        for connection in writable:
            self._flush(connection)
        if self._late:
            self._send_late(now_ns)
        for listener in self._listeners:
            if listener in readable:
                self._accept(listener)
        self._receive([entry for entry in readable if isinstance(entry, Connection)], now_ns)
        if self._faults.link.is_frozen:
            self._carry_out(lambda connection: connection.dialect_decoder() is None)
        else:
            self._carry_out(lambda _: True)

    def _receive(self, readable: list[Connection], now_ns: int) -> None:
        if len(readable) > MAX_RECEIVED_A_TICK:
            readable.sort(key=lambda connection: connection.number)
            self._turn = (self._turn + MAX_RECEIVED_A_TICK) % len(readable)
            readable = (readable[self._turn :] + readable[: self._turn])[:MAX_RECEIVED_A_TICK]
        for connection in readable:
            try:
                is_there = connection.receive(now_ns)
            except ProtocolError as error:
                self._refuse(connection, str(error))
                continue
            if not is_there:
                self._lose(connection)
            elif connection.requests:
                self._ready.append(connection)

    def _carry_out(self, may_go: Callable[[Connection], bool]) -> None:
        """Carry out requests in turn, until the next tick is due."""
        waiting = []
        was_left = self._is_work_left
        while self._ready:
            connection = self._ready.popleft()
            if not connection.requests or connection.outgoing:
                continue
            if not may_go(connection):
                waiting.append(connection)
                continue
            self._answer(connection, connection.requests.popleft())
            if connection.requests:
                self._ready.append(connection)
            elif connection.is_closing:
                self._end_if_done(connection)
            if not self._is_lockstep and time.monotonic_ns() >= self._grid.next_ns:
                break
        self._ready.extend(waiting)
        self._is_work_left = bool(self._ready)
        if was_left or self._is_work_left:
            self._are_lists_stale = True

    def _answer(self, connection: Connection, request: str) -> None:
        decoder = connection.dialect_decoder()
        if decoder is None:
            self._world.missed = self._grid.missed
            self._send(connection, self._world.answer(request.encode(), asker=connection))
            return
        dialect = decoder.dialect or Dialect.TEXT
        if not connection.has_commanded:
            connection.has_commanded = not all(
                part.lstrip().startswith("get") for part in request.split(";") if part.strip()
            )
        reply = self._interpreter.reply(request, dialect)
        if self._log is not None:
            self._note(connection, ">", request)
            self._note(connection, "<", reply.decode("ascii", "replace"))
        if self._faults.link.is_active or connection.late:
            self._late.keep(connection, reply, dialect, time.monotonic_ns())
        else:
            self._send(connection, reply)

    def _send(self, connection: Connection, data: bytes) -> None:
        if not connection.send(data):
            self._lose(connection)
        elif connection.outgoing:
            self._are_lists_stale = True

    def _send_late(self, now_ns: int) -> None:
        for connection, data in self._late.take_due(now_ns):
            self._send(connection, data)
            self._are_lists_stale = True

    def _flush(self, connection: Connection) -> None:
        if not connection.flush():
            self._lose(connection)
        elif not connection.outgoing:
            self._are_lists_stale = True
            if connection.requests:
                self._ready.append(connection)
            self._end_if_done(connection)

    def _accept(self, listener: socket.socket) -> None:
        is_world = listener is self._listeners[1]
        for _ in range(MAX_ACCEPTED_A_TICK):
            try:
                link, _peer = listener.accept()
            except OSError:
                return
            if len(self._connections) >= MAX_CLIENTS and not self._make_room():
                link.close()
                continue
            self._accepted += 1
            decoder = LineDecoder(limit=MAX_LINE) if is_world else RequestDecoder()
            try:
                connection = Connection(
                    link, number=self._accepted, decoder=decoder, now_ns=time.monotonic_ns()
                )
            except OSError:
                link.close()
                continue
            self._connections.add(connection)
            self._are_lists_stale = True
            self._note(connection, "+", "world" if is_world else "device")

    def _make_room(self) -> bool:
        """Drop the client that has been silent for longest without ever having asked anything."""
        mute = [connection for connection in self._connections if not connection.has_spoken]
        if not mute:
            return False
        self._lose(min(mute, key=lambda connection: connection.heard_ns))
        return True

    def _refuse(self, connection: Connection, reason: str) -> None:
        """Answer bytes that cannot be followed, and hang up."""
        decoder = connection.dialect_decoder()
        if decoder is None:
            self._send(connection, b'{"error": "a line is too long"}\n')
        else:
            dialect = decoder.dialect or Dialect.TEXT
            self._send(connection, encode_reply(dialect, [render_value(error_reply(reason), dialect)]))
        connection.requests.clear()
        connection.is_closing = True
        self._note(connection, "<", reason)
        self._end_if_done(connection)

    def _end_if_done(self, connection: Connection) -> None:
        if connection.is_closing and not connection.outgoing:
            self._lose(connection)

    def _lose(self, connection: Connection, *, is_reset: bool = False) -> None:
        if connection not in self._connections:
            return
        self._connections.discard(connection)
        self._late.forget(connection)
        self._are_lists_stale = True
        connection.requests.clear()
        with suppress(OSError):
            if is_reset:
                connection.link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            else:
                connection.link.shutdown(socket.SHUT_WR)
        connection.link.close()
        self._world.lost(connection)
        self._note(connection, "-", "")
        if connection.has_commanded and self._on_client_lost is OnClientLost.STOP:
            self._device.client_lost()

    def _reset_all(self) -> None:
        self._resets = self._faults.link.resets
        for connection in tuple(self._connections):
            if connection.dialect_decoder() is not None:
                self._lose(connection, is_reset=True)

    def _keep_house(self) -> None:
        now_ns = time.monotonic_ns()
        self._next_housekeeping_ns = now_ns + _HOUSEKEEPING_NS
        for connection in tuple(self._connections):
            if connection.is_mid_request and now_ns - connection.heard_ns > PATIENCE_NS:
                self._refuse(connection, "half a request and silence")
        if self._report is not None:
            self._report(self.status())

    def status(self) -> Status:
        """How the server fares."""
        cpu_s = time.thread_time()
        now_s = time.monotonic()
        load = (cpu_s - self._cpu_s) / max(1e-3, now_s - self._looked_s)
        self._cpu_s, self._looked_s = cpu_s, now_s
        return Status(
            time_s=round(self._device.time_s, 6),
            state=self._device.state.value,
            clients=sum(connection.dialect_decoder() is not None for connection in self._connections),
            ticks=self._grid.ticks,
            missed=self._grid.missed,
            given_up=self._grid.given_up,
            requests=self._interpreter.answered,
            refused=self._interpreter.refused,
            load=round(load, 4),
        )

    def _note(self, connection: Connection, direction: str, text: str) -> None:
        if self._log is not None:
            self._log(LogEntry(self._device.time_s, connection.number, direction, text.rstrip("\n")))


def _listen(field: str, address: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((address.host, address.port))
        listener.listen(_BACKLOG)
        listener.settimeout(0.0)
    except OSError as error:
        listener.close()
        advice = "choose another port, or port 0 for a free one"
        problem = f"cannot listen on {address}: {error.strerror or error}; {advice}"
        raise ConfigurationError(field, problem) from error
    return listener
