"""What a faulty link does to the bytes of one reply."""

from random import Random

from emulator.faults import LinkFaults
from hm_driver.protocol.framing import Dialect, encode_reply, render_value
from hm_driver.protocol.vocabulary import error_reply


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


def wait_s(link: LinkFaults, random: Random) -> float:
    """How long the reply waits before it leaves [s]."""
    return link.delay_s + (random.uniform(0.0, link.jitter_s) if link.jitter_s else 0.0)
