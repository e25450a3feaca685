"""What a faulty link does to replies."""

from random import Random

from emulator.connection import Connection
from emulator.faults import FaultInjector, LinkFaults
from hm_driver.protocol.framing import Dialect, encode_reply, render_value
from hm_driver.protocol.vocabulary import error_reply

MERGE_PATIENCE_NS = 100_000_000
"""How long replies that are to be merged wait for each other [ns]."""


def spoil(reply: bytes, dialect: Dialect, link: LinkFaults, random: Random) -> bytes:
    """The reply as it leaves: as it is, an error, with one byte changed, or empty where it is lost."""
    if link.lost and random.random() < link.lost:
        return b""
    if link.error and random.random() < link.error:
        reply = encode_reply(dialect, [render_value(error_reply("injected fault"), dialect)])
    if link.corrupted and random.random() < link.corrupted:
        place = random.randrange(len(reply))
        changed = reply[place] ^ (1 << random.randrange(7))
        reply = reply[:place] + bytes((changed,)) + reply[place + 1 :]
    return reply


class LateReplies:
    """Replies that a faulty link keeps back: delayed, in two halves, or until there are several to send.

    Args:
        faults: What is wrong with the link.
    """

    def __init__(self, faults: FaultInjector) -> None:
        self._link = faults.link
        self._random = faults.random
        self._keepers: set[Connection] = set()

    def __len__(self) -> int:
        return len(self._keepers)

    def keep(self, connection: Connection, reply: bytes, dialect: Dialect, now_ns: int) -> None:
        """Keep a reply back for as long as the link's faults say, or lose it."""
        link = self._link
        reply = spoil(reply, dialect, link, self._random)
        if not reply:
            return
        wait_s = link.delay_s + (self._random.uniform(0.0, link.jitter_s) if link.jitter_s else 0.0)
        due = now_ns + round(wait_s * 1e9) + (MERGE_PATIENCE_NS if link.merged > 1 else 0)
        cut = len(reply) // 2 if link.split_s else len(reply)
        connection.late.append((due, reply[:cut]))
        if cut < len(reply):
            connection.late.append((due + round(link.split_s * 1e9), reply[cut:]))
        self._keepers.add(connection)

    def take_due(self, now_ns: int) -> list[tuple[Connection, bytes]]:
        """What is to be sent now; no reply overtakes one to an earlier request."""
        merged = self._link.merged
        due: list[tuple[Connection, bytes]] = []
        for connection in tuple(self._keepers):
            late = connection.late
            while late and (late[0][0] <= now_ns or 1 < merged <= len(late)):
                data = late.popleft()[1]
                while merged > 1 and late:
                    data += late.popleft()[1]
                due.append((connection, data))
            if not late:
                self._keepers.discard(connection)
        return due

    def forget(self, connection: Connection) -> None:
        """Drop what a connection that is gone was to get."""
        self._keepers.discard(connection)
