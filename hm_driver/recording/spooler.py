"""Taking records out of rings and into a log. No process of its own: the recorder gives it one."""

from collections.abc import Iterable, Sequence

from hm_driver.recording.derivation import Deriver
from hm_driver.recording.ring import Record, Ring
from hm_driver.recording.schemas import Bundle
from hm_driver.recording.writer import LogWriter

_BATCH_BYTES = 1 << 20


class Spooler:
    """Drains rings into a writer, and counts what never arrived.

    Memory is given back to the writers of the rings once the records in it are in the file, so that a
    recorder that is killed loses nothing: the next one reads them again. A gap in a ring's sequence numbers
    becomes a gap in those of the file.

    Args:
        rings: The rings, as their reader.
        writer: Where the messages go.
        bundles: Bundles that may stand in the rings; they become messages of their channels.
        derivers: Make further messages of those in the rings.
        is_continued: Whether another reader emptied the rings before: sequence numbers go on from there.
    """

    def __init__(
        self,
        rings: Sequence[Ring],
        writer: LogWriter,
        bundles: Iterable[Bundle] = (),
        derivers: Iterable[Deriver] = (),
        *,
        is_continued: bool = False,
    ) -> None:
        self._rings = rings
        self._writer = writer
        self._slices = {bundle.id: bundle.slices for bundle in bundles}
        self._derivers: dict[int, list[Deriver]] = {}
        for deriver in derivers:
            for source in deriver.sources:
                self._derivers.setdefault(source, []).append(deriver)
        self._is_continued = is_continued
        self._expected: list[dict[int, int]] = [{} for _ in rings]
        self.lost = 0
        """Messages that the writers of the rings had to drop."""
        self.messages = 0
        """Messages taken out of the rings."""
        self.derived = 0
        """Messages made of others."""

    def spool(self) -> int:
        """Move what the rings hold, up to 1 MiB each, in the order of log time; returns the records moved.

        Raises:
            OSError: if the disk fails; what is not in the file stays in the rings.
            RecordingError: if a ring is damaged.
        """
        records: list[tuple[Record, int]] = []
        for ring, expected in zip(self._rings, self._expected, strict=True):
            records += self._taken(ring, expected)
        if len(self._rings) > 1:
            records.sort(key=_log_time)
        chunk, slices_of = self._writer.chunk, self._slices
        for (channel, _, log_time_ns, _, payload), skipped in records:
            slices = slices_of.get(channel)
            if slices is None:
                chunk.add(channel, log_time_ns, payload, skipped)
                if channel in self._derivers:
                    self._derive(channel, log_time_ns, payload)
            else:
                chunk.add_bundle(slices, log_time_ns, payload, skipped)
                for number, start, end in slices:
                    if number in self._derivers:
                        self._derive(number, log_time_ns, payload[start:end])
            self._writer.end_full_chunk()
        if any(ring.unreleased >= min(self._writer.chunk_bytes, ring.capacity // 4) for ring in self._rings):
            self.settle()
        return len(records)

    def _derive(self, channel: int, log_time_ns: int, payload: bytes) -> None:
        for deriver in self._derivers[channel]:
            for derived in deriver.derive(channel, log_time_ns, payload):
                self._writer.chunk.add(*derived)
                self.derived += 1

    def settle(self) -> None:
        """Bring what was read into the file and release its memory; raises OSError as `spool` does."""
        self._writer.end_chunk()
        for ring in self._rings:
            ring.release()

    def follow(self, writer: LogWriter) -> None:
        """Go on in another file: the one before is finished, and its sequence numbers go on."""
        writer.chunk.sequences = self._writer.chunk.sequences
        self._writer = writer

    def discard(self) -> int:
        """Empty the rings without writing, so that their writers go on; returns the messages thrown away."""
        thrown = 0
        for ring, expected in zip(self._rings, self._expected, strict=True):
            thrown += sum(self._messages_in(record.channel) for record, _ in self._taken(ring, expected))
            ring.release()
        return thrown

    def _messages_in(self, channel: int) -> int:
        return len(self._slices.get(channel, (None,)))

    def _taken(self, ring: Ring, expected: dict[int, int]) -> list[tuple[Record, int]]:
        """Records of a ring, each with how many records of its channel were lost before it."""
        taken = []
        for record in ring.drain(_BATCH_BYTES):
            channel, sequence = record.channel, record.sequence
            messages = self._messages_in(channel)
            self.messages += messages
            due = expected.get(channel)
            if due is None:
                due = self._begin(channel, sequence)
            gap = max(0, sequence - due)  # behind it is a writer that started again
            self.lost += gap * messages
            expected[channel] = sequence + 1
            taken.append((record, gap))
        return taken

    def _begin(self, channel: int, sequence: int) -> int:
        """The sequence number due first on a channel of a ring."""
        if not self._is_continued:
            return 0
        sequences = self._writer.chunk.sequences
        for number, _, _ in self._slices.get(channel, ((channel, 0, 0),)):
            sequences.setdefault(number, sequence)
        return sequence


def _log_time(taken: tuple[Record, int]) -> int:
    return taken[0].log_time_ns
