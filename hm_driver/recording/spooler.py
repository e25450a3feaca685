"""Taking records out of rings and into a log. No process of its own: the recorder gives it one."""

from collections.abc import Iterable, Sequence
from operator import attrgetter

from hm_driver.recording.ring import Record, Ring
from hm_driver.recording.schemas import Bundle
from hm_driver.recording.writer import LogWriter

_BATCH_BYTES = 1 << 20


class Spooler:
    """Drains rings into a writer, and counts what never arrived.

    Args:
        rings: The rings, as their reader.
        writer: Where the messages go.
        bundles: Bundles that may stand in the rings; they become messages of their channels.
        is_continued: Whether another reader emptied the rings before: what it took is not counted as lost.
    """

    def __init__(
        self,
        rings: Sequence[Ring],
        writer: LogWriter,
        bundles: Iterable[Bundle] = (),
        *,
        is_continued: bool = False,
    ) -> None:
        self._rings = rings
        self._writer = writer
        self._slices = {bundle.id: bundle.slices for bundle in bundles}
        self._is_continued = is_continued
        self._expected: list[dict[int, int]] = [{} for _ in rings]
        self.lost = 0
        """Messages that the writers of the rings had to drop."""
        self.messages = 0
        """Messages taken out of the rings."""

    def spool(self) -> int:
        """Move what the rings hold, up to 1 MiB each, in the order of log time; returns the records moved.

        Raises:
            OSError: if the disk fails; the records of this call are lost.
            RecordingError: if a ring is damaged.
        """
        records: list[Record] = []
        for ring, expected in zip(self._rings, self._expected, strict=True):
            taken = ring.drain(_BATCH_BYTES)
            self._count_gaps(taken, expected)
            records += taken
        if len(self._rings) > 1:
            records.sort(key=attrgetter("log_time_ns"))
        chunk, slices_of = self._writer.chunk, self._slices
        for channel, _, log_time_ns, _, payload in records:
            slices = slices_of.get(channel)
            if slices is None:
                chunk.add(channel, log_time_ns, payload)
            else:
                chunk.add_bundle(slices, log_time_ns, payload)
            self._writer.end_full_chunk()
        return len(records)

    def discard(self) -> int:
        """Empty the rings without writing, so that their writers go on; returns the messages thrown away."""
        thrown = 0
        for ring, expected in zip(self._rings, self._expected, strict=True):
            taken = ring.drain(_BATCH_BYTES)
            self._count_gaps(taken, expected)
            thrown += sum(self._messages_in(record.channel) for record in taken)
        return thrown

    def _messages_in(self, channel: int) -> int:
        return len(self._slices.get(channel, (None,)))

    def _count_gaps(self, taken: Iterable[Record], expected: dict[int, int]) -> None:
        for record in taken:
            messages = self._messages_in(record.channel)
            self.messages += messages
            first = record.sequence if self._is_continued else 0
            gap = record.sequence - expected.get(record.channel, first)
            if gap > 0:  # a negative one is a writer that started again
                self.lost += gap * messages
            expected[record.channel] = record.sequence + 1
