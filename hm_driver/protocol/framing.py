"""Text to bytes and back, in the device's two dialects.

Framed (generation G2): a header of two big-endian uint32, the length and 0, then that many ASCII bytes.
Text (generation G3): an ASCII line. The first byte of a connection tells which one a client speaks: 0x00
begins a header, as no request is longer than 16 MB.
"""

import struct
from collections.abc import Sequence
from enum import Enum

from hm_driver.errors import ProtocolError
from hm_driver.protocol.commands import format_value
from hm_driver.protocol.vocabulary import ERROR_MARK, Value

HEADER = struct.Struct(">II")
"""Header of the framed dialect: length of the payload, 0."""

MAX_REQUEST_LENGTH = 4096
"""Longest request that a server takes, in bytes (a choice; published programs stay below 250)."""

MAX_REPLY_LENGTH = 65536
"""Longest reply that a client takes, in bytes."""

MAX_FRAMED_REPLY_LENGTH = 119
"""Longest payload of a framed reply: with its header it stays below 128 bytes.

A client in use reads the header as ASCII, which a length byte of 128 or more would break.
"""


class Dialect(Enum):
    """How the device frames and quotes; the values are the words of ``?dialect=``."""

    TEXT = "text"
    """Lines; every part of a reply is closed by ``;``."""
    FRAMED = "framed"
    """Length headers; words and truth values in double quotes."""


def encode_request(dialect: Dialect, text: str) -> bytes:
    """Bytes of one request.

    Raises:
        ProtocolError: The text is not one line of ASCII.
    """
    try:
        payload = text.encode("ascii")
    except UnicodeEncodeError:
        raise ProtocolError(f"request {text[:60]!r} has characters other than ASCII", received=text) from None
    if b"\n" in payload:
        raise ProtocolError(f"request {text[:60]!r} has more than one line", received=text)
    if dialect is Dialect.TEXT:
        return payload + b"\n"
    return HEADER.pack(len(payload), 0) + payload


def render_value(value: Value, dialect: Dialect) -> str:
    """Print one part of a reply: number, vector, truth value, word, message or error.

    Words, truth values and messages are quoted in the framed dialect.

    Raises:
        ProtocolError: NaN or infinity.
    """
    text = format_value(value)
    if dialect is Dialect.FRAMED and isinstance(value, (str, bool)):
        return f'"{text}"'
    return text


def encode_reply(dialect: Dialect, parts: Sequence[str]) -> bytes:
    """Bytes of one reply, from parts that `render_value` printed for the same dialect.

    An error text that is too long for a frame is shortened.

    Raises:
        ProtocolError: A framed reply has exactly one part, and its length is limited.
    """
    if dialect is Dialect.TEXT:
        return f"{';'.join(parts)};\n".encode("ascii")
    if len(parts) != 1:
        raise ProtocolError(f"a framed reply has one part, not {len(parts)}")
    payload = parts[0].encode("ascii")
    if len(payload) > MAX_FRAMED_REPLY_LENGTH:
        if ERROR_MARK.encode() not in payload:
            raise ProtocolError(
                f"a framed reply has at most {MAX_FRAMED_REPLY_LENGTH} bytes, not {len(payload)}",
                received=parts[0],
            )
        payload = payload.rstrip(b'"')[: MAX_FRAMED_REPLY_LENGTH - 4] + b'..."'
    return HEADER.pack(len(payload), 0) + payload


class RequestDecoder:
    r"""Server's side: bytes of one connection to the texts of requests; finds the dialect by the first byte.

    Keeps at most `limit` bytes and what was fed last. Bytes that are not ASCII are shown as ``\xNN`` in the
    text, so that a reply can name them. After a `ProtocolError` the stream cannot be followed: answer and
    close.
    """

    def __init__(self, *, limit: int = MAX_REQUEST_LENGTH) -> None:
        self.dialect: Dialect | None = None
        """What the client speaks; None before the first byte."""
        self._limit = limit
        self._buffer = b""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes, return the requests that they complete.

        Raises:
            ProtocolError: Neither dialect, a request above the limit, or a header that is none.
        """
        if self.dialect is Dialect.TEXT:
            buffer = self._buffer + data if self._buffer else data
            payloads, self._buffer = _split_lines(buffer, self._limit)
            return [payload.decode("ascii", "backslashreplace") for payload in payloads]
        if not data:
            return []
        if self.dialect is None:
            self.dialect = _detect(data[0])
            return self.feed(data)
        payloads, self._buffer = _split_frames(self._buffer + data, self._limit)
        return [payload.decode("ascii", "backslashreplace") for payload in payloads]


class ReplyDecoder:
    """Client's side: bytes of one connection to the texts of replies, without terminator.

    Args:
        dialect: What the device speaks.
        limit: Longest reply [bytes].
    """

    def __init__(self, dialect: Dialect, *, limit: int = MAX_REPLY_LENGTH) -> None:
        self.dialect = dialect
        self._limit = limit
        self._buffer = b""

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left of an incomplete reply."""
        return not self._buffer

    def feed(self, data: bytes) -> list[str]:
        """Take bytes, return the replies that they complete.

        Raises:
            ProtocolError: Not this dialect, not ASCII, or above the limit.
        """
        buffer = self._buffer + data if self._buffer else data
        split = _split_lines if self.dialect is Dialect.TEXT else _split_frames
        payloads, self._buffer = split(buffer, self._limit)
        try:
            return [payload.decode("ascii") for payload in payloads]
        except UnicodeDecodeError as error:
            raise ProtocolError(f"reply {error.object[:60]!r} is not ASCII") from error


def _detect(first: int) -> Dialect:
    if first == 0:
        return Dialect.FRAMED
    if 0x20 <= first < 0x7F or first in b"\t\r\n":
        return Dialect.TEXT
    raise ProtocolError(
        f"a connection cannot begin with byte 0x{first:02x}; accepted: 0x00 (a frame header) "
        "or a printable character"
    )


def _split_lines(buffer: bytes, limit: int) -> tuple[list[bytes], bytes]:
    """Complete lines, and the rest."""
    if buffer.find(b"\n") == len(buffer) - 1 <= limit and buffer[-2:] != b"\r\n":
        return ([buffer[:-1]], b"") if buffer else ([], b"")  # what nearly always comes: one whole line
    lines = buffer.split(b"\n")
    rest = lines.pop()
    if len(rest) > limit:
        raise _too_long(len(rest), limit)
    for index, line in enumerate(lines):
        if len(line) > limit:
            raise _too_long(len(line), limit)
        if line.endswith(b"\r"):
            lines[index] = line[:-1]
    return lines, rest


def _split_frames(buffer: bytes, limit: int) -> tuple[list[bytes], bytes]:
    """Payloads of complete frames, and the rest."""
    payloads = []
    start = 0
    while len(buffer) - start >= HEADER.size:
        length, zero = HEADER.unpack_from(buffer, start)
        if zero != 0:
            raise ProtocolError(
                f"second word of a frame header is 0x{zero:08x} instead of 0: this is no frame"
            )
        if length > limit:
            raise _too_long(length, limit)
        end = start + HEADER.size + length
        if len(buffer) < end:
            break
        payloads.append(buffer[start + HEADER.size : end])
        start = end
    return payloads, buffer[start:]


def _too_long(length: int, limit: int) -> ProtocolError:
    return ProtocolError(f"a message of at least {length} bytes is above the limit of {limit} bytes")
