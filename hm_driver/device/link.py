"""One command out, one reply back, over any transport and in either dialect."""

import logging
import threading
import time
from collections.abc import Callable, Sequence

from hm_driver.errors import DeviceError, ProtocolError, TransportClosed, TransportError, TransportTimeout
from hm_driver.protocol.framing import MAX_REPLY_LENGTH, Dialect, ReplyDecoder, encode_request
from hm_driver.protocol.replies import is_error, parse_number, parse_word, read_reply, split_parts
from hm_driver.protocol.vocabulary import ERROR_MARK
from hm_driver.transport.contract import LinkStatistics, Transport
from hm_driver.transport.tcp import TcpTransport
from hm_driver.transport.urls import DeviceUrl, open_transport, parse_device_url

_log = logging.getLogger(__name__)

DETECTION_S = 1.0
"""How long a device may take to answer the question that finds its dialect [s]."""

LONGEST_REQUEST = 1000
"""Characters that `CommandLink.exchange_many` puts into one request; the device's limit is not known."""

_PARTS_OF_PATIENCE = 5
_LONGEST_LINE = 8192


class CommandLink:
    """A connection with at most one command in flight.

    Once a reply did not come in time, or what came was not one reply, the link is broken: what arrives later
    could be taken for the reply to another command. It is closed, and every later exchange raises
    `TransportClosed`, until `reconnect` is called. Threads that share a link wait for each other.

    Args:
        transport: An open transport; it belongs to the link from now on.
        dialect: What the device speaks.
        timeout_s: Longest wait for a reply [s]; can be changed at any time.
        reopen: Opens another transport to the same device, for `reconnect`.
    """

    def __init__(
        self,
        transport: Transport,
        dialect: Dialect,
        *,
        timeout_s: float = 1.0,
        reopen: Callable[[], Transport] | None = None,
    ) -> None:
        self.dialect = dialect
        self.timeout_s = timeout_s
        self.combined = False
        """Whether one request may hold several commands, as `probe_combined` found."""
        self._reopen = reopen
        self._transport = transport
        self._decoder = ReplyDecoder(dialect)
        self._in_flight = threading.Lock()
        self._line_due = b""
        self._line_timeout_s = -1.0
        self._sendall: Callable[[bytes], object] = transport.send
        self._recv: Callable[[int], bytes] = transport.receive
        self._broken_by = ""

    @property
    def url(self) -> str:
        """Where the link leads."""
        return self._transport.url

    @property
    def is_broken(self) -> bool:
        """Whether the link was closed, by `close` or by a failure."""
        return bool(self._broken_by)

    @property
    def statistics(self) -> LinkStatistics:
        """What went over the transport since it was opened."""
        return self._transport.statistics

    def exchange(self, request: str, *, timeout_s: float | None = None) -> str:
        """Send a request and return the reply as it came, without line end or header.

        Args:
            request: One command, or several joined by ``;`` where the device takes that.
            timeout_s: Longest wait for this reply, instead of the link's own [s].

        Raises:
            DeviceError: The device refused the command, or one of them.
            ProtocolError: What came is not one reply; the link is broken.
            TransportTimeout: No reply in time; the link is broken.
            TransportClosed: The peer is gone, or the link was broken before.
        """
        with self._in_flight:
            if self._broken_by:
                raise self._closed(request)
            data = encode_request(self.dialect, request)
            if self._line_due:
                self.receive_line()
            self._line_timeout_s = -1.0
            try:
                self._transport.send(data)
                reply = self._receive_reply(self.timeout_s if timeout_s is None else timeout_s)
            except (TransportError, ProtocolError) as error:
                self._break(str(error))
                raise error.about(request) from error
            except BaseException:
                self._break("an exchange was interrupted")
                raise
        if ERROR_MARK in reply:
            raise DeviceError(*_find_refused(request, reply))
        return reply

    def exchange_line(self, line: bytes) -> bytes:
        """Send a line of the text dialect and return the line that answers it; see `send_line`.

        Raises:
            TransportError: As `send_line` and `receive_line`.
            ProtocolError: As `receive_line`.
        """
        self.send_line(line)
        return self.receive_line()

    def send_line(self, line: bytes) -> None:
        """Send one line of the text dialect as it stands on the wire; the loop's short way.

        Line and reply carry their line end. Nothing else is looked at: neither the dialect, nor what the
        reply says, nor whether another thread uses the link; what goes over a socket is not counted. What
        `receive_line` did not fetch is dropped by the next `exchange`.

        Raises:
            TransportTimeout: The device took nothing in time; the link is broken.
            TransportClosed: The peer is gone, or the link was broken before.
        """
        if self._broken_by:
            raise self._closed(_readable(line))
        if self.timeout_s != self._line_timeout_s:
            self._find_short_way()
        self._line_due = line
        try:
            self._sendall(line)
        except TransportError as error:
            self._break(str(error))
            raise error.about(_readable(line)) from error
        except OSError as error:
            self._break(str(error))
            lost = TransportClosed(f"{self.url}: connection lost: {error}; reconnect")
            raise lost.about(_readable(line)) from error

    def receive_line(self) -> bytes:
        """Return the line that answers the one that was sent last.

        The time-out is waited for in five parts, so that a stall of the whole machine, which delays the
        device's answer too, counts as one of them.

        Raises:
            ProtocolError: What came is not one line; the link is broken.
            TransportTimeout: No reply in time; the link is broken.
            TransportClosed: The peer is gone, or the link was broken before.
        """
        try:
            try:
                reply = self._recv(_LONGEST_LINE)
            except (TransportTimeout, BlockingIOError):
                reply = self._receive_patiently(_PARTS_OF_PATIENCE - 1)
            except OSError:
                reply = b""
            if not reply:
                reply = self._transport.receive(0.0)  # says what is wrong
            if reply.find(b"\n") != len(reply) - 1:
                reply = self._complete_line(reply)
        except (TransportError, ProtocolError) as error:
            self._break(str(error))
            raise error.about(_readable(self._line_due)) from error
        self._line_due = b""
        return reply

    def exchange_joined(
        self, request: str, expected_parts: int, *, timeout_s: float | None = None
    ) -> list[str]:
        """Send commands that the caller joined by ``"; "`` and return the parts of the reply.

        The short way for a loop that joins its commands itself; text dialect only.

        Raises:
            ProtocolError: The reply has not `expected_parts` parts.
            HapticMasterError: As `exchange`.
        """
        parts = read_reply(split_parts, request, self.exchange(request, timeout_s=timeout_s))
        if len(parts) != expected_parts:
            raise ProtocolError(
                f"{request[:80]!r} was answered by {len(parts)} parts instead of {expected_parts}",
                command=request,
                received=";".join(parts),
            )
        return parts

    def ask(self, command: str, *, timeout_s: float | None = None) -> str:
        """Exchange one command and return the one part of its reply; raises as `exchange_joined`."""
        if self.dialect is Dialect.TEXT:
            return self.exchange_joined(command, 1, timeout_s=timeout_s)[0]
        return self.exchange(command, timeout_s=timeout_s)

    def exchange_many(self, commands: Sequence[str]) -> list[str]:
        """Exchange several commands, in one request where the device takes that; raises as `exchange_joined`.

        Where the device takes one command at a time, the first refused one ends the exchange.
        """
        if not self.combined or len(commands) < 2:
            return [self.ask(command) for command in commands]
        request = "; ".join(commands)
        if len(request) <= LONGEST_REQUEST:
            return self.exchange_joined(request, len(commands))
        half = len(commands) // 2
        return self.exchange_many(commands[:half]) + self.exchange_many(commands[half:])

    def probe_combined(self) -> bool:
        """Ask whether the device takes several commands, sets among them, in one request.

        Published programs combine questions; whether a set combines is not known of the device. The set
        that is tried sets the virtual mass to what it is. The answer is kept as `combined`.

        Raises:
            HapticMasterError: The device does not answer a single question either.
        """
        self.combined = False
        if self.dialect is Dialect.TEXT:
            inertia = self.ask("get inertia")
            parse_number(inertia)
            try:
                mass, _, state = self.exchange_joined(f"get inertia; set inertia {inertia}; get state", 3)
                self.combined = parse_number(mass) == parse_number(inertia) and parse_word(state).isalpha()
            except (TransportTimeout, ProtocolError, DeviceError) as error:
                _log.info("%s does not take several commands in one request: %s", self.url, error)
                if self._reopen is not None:
                    self.reconnect()  # nothing of the odd answer may be left on the way
        _log.info("%s: commands are sent %s", self.url, "combined" if self.combined else "one by one")
        return self.combined

    def reconnect(self) -> None:
        """Open the connection anew; nothing is sent again.

        Raises:
            TransportError: The device cannot be reached, or the link does not know how.
        """
        if self._reopen is None:
            raise TransportError(f"{self.url}: this link cannot be opened anew; make another one")
        self.close()
        transport = self._reopen()
        with self._in_flight:
            self._transport = transport
            self._decoder = ReplyDecoder(self.dialect)
            self._line_due = b""
            self._line_timeout_s = -1.0
            self._broken_by = ""

    def close(self) -> None:
        """Close the link, from any thread; closing again does nothing."""
        self._break("it was closed")

    def _find_short_way(self) -> None:
        """Take the socket's own calls where the link has one."""
        transport, self._line_timeout_s = self._transport, self.timeout_s
        part_s = self.timeout_s / _PARTS_OF_PATIENCE
        if isinstance(transport, TcpTransport):
            self._sendall, self._recv = transport.socket_calls(part_s)
        else:
            self._sendall, self._recv = transport.send, lambda _size: transport.receive(part_s)

    def _incomplete(self, received: bytes, timeout_s: float) -> TransportTimeout:
        return TransportTimeout(
            f"{self.url}: the reply was not complete within {timeout_s:g} s; reconnect",
            received=repr(received[:200]),
        )

    def _closed(self, command: str) -> TransportClosed:
        reason = f"{self.url}: the link is closed ({self._broken_by}); reconnect"
        return TransportClosed(reason, command=command)

    def _break(self, reason: str) -> None:
        self._broken_by = self._broken_by or reason
        self._transport.close()

    def _receive_patiently(self, parts: int) -> bytes:
        try:
            return self._transport.receive(self.timeout_s / _PARTS_OF_PATIENCE)
        except TransportTimeout:
            if parts > 1:
                return self._receive_patiently(parts - 1)
            raise TransportTimeout(f"{self.url}: no reply within {self.timeout_s:g} s") from None

    def _complete_line(self, reply: bytes) -> bytes:
        deadline = time.monotonic() + self.timeout_s
        while b"\n" not in reply:
            remaining_s = deadline - time.monotonic()
            if remaining_s <= 0.0 or len(reply) > MAX_REPLY_LENGTH:
                raise self._incomplete(reply, self.timeout_s)
            try:
                reply += self._transport.receive(remaining_s)
            except TransportTimeout as error:
                raise self._incomplete(reply, self.timeout_s) from error
        if reply.find(b"\n") != len(reply) - 1:
            raise ProtocolError(f"{self.url}: more than one reply to one request", received=repr(reply[:200]))
        return reply

    def _receive_reply(self, timeout_s: float) -> str:
        deadline = time.monotonic() + timeout_s
        decoder = self._decoder
        try:
            data = self._transport.receive(timeout_s)
        except TransportTimeout as error:
            raise TransportTimeout(f"{self.url}: no reply within {timeout_s:g} s; reconnect") from error
        texts = decoder.feed(data)
        while not texts:
            remaining_s = deadline - time.monotonic()
            if remaining_s <= 0.0:
                raise self._incomplete(data, timeout_s)
            try:
                more = self._transport.receive(remaining_s)
            except TransportTimeout as error:
                raise self._incomplete(data, timeout_s) from error
            data += more
            texts = decoder.feed(more)
        if len(texts) > 1 or not decoder.is_empty:
            raise ProtocolError(f"{self.url}: more than one reply to one request", received=";".join(texts))
        return texts[0]


def connect_link(url: str, *, timeout_s: float = 1.0) -> CommandLink:
    """Connect to a device and find out which dialect it speaks, by asking ``get state``.

    Without ``?dialect=`` each dialect is tried on a connection of its own, text first: text that is sent to
    a framed device reads as the announcement of 1.7 GB, so that connection is of no more use.

    Args:
        url: As `hm_driver.transport.urls.open_transport`, with ``?dialect=auto|text|framed``.
        timeout_s: Longest wait for the connection and, later, for each reply [s].

    Raises:
        ConfigurationError: The URL is wrong.
        TransportError: Nothing listens there.
        ProtocolError: What listens there is no HapticMASTER; the text says what was tried.
    """
    target = parse_device_url(url)
    problems = []
    for dialect in [target.dialect] if target.dialect else list(Dialect):
        link = _open_link(target, dialect, timeout_s)
        try:
            state = _ask_state(link)
        except (TransportTimeout, TransportClosed, ProtocolError) as error:
            link.close()
            problems.append(f"{dialect.value}: {error}")
            continue
        except BaseException:
            link.close()
            raise
        _log.info("%s speaks the %s dialect; state %s", url, dialect.value, state)
        return link
    where = f"{target.host}:{target.port}" if target.host else target.url
    raise ProtocolError(
        f"{where} is no HapticMASTER; 'get state' was tried in the dialects {'; '.join(problems)}. "
        "Check address and port, or name the dialect with ?dialect=text or ?dialect=framed"
    )


def _open_link(target: DeviceUrl, dialect: Dialect, timeout_s: float) -> CommandLink:
    def reopen() -> Transport:
        return open_transport(target, timeout_s=timeout_s)

    return CommandLink(reopen(), dialect, timeout_s=timeout_s, reopen=reopen)


def _ask_state(link: CommandLink) -> str:
    """Ask for the state; an answer that is not a word means that this is no HapticMASTER."""
    try:
        part = link.ask("get state", timeout_s=DETECTION_S)
    except DeviceError:
        return "unknown: it refused 'get state'"
    word = parse_word(part)
    is_quoted = part.startswith('"')
    if not word.isalpha() or is_quoted != (link.dialect is Dialect.FRAMED):
        raise ProtocolError(f"{part[:40]!r} is not a state", received=part)
    return word


def _readable(line: bytes) -> str:
    return line.decode(errors="replace").strip()


def _find_refused(request: str, reply: str) -> tuple[str, str]:
    """The command of a request that was refused, and its reply."""
    commands = request.split(";")
    parts = reply.split(";")
    if len(commands) == len(parts) - 1:
        for command, part in zip(commands, parts, strict=False):
            if is_error(part):
                return command.strip(), part
    return request, reply.strip('"; ')
