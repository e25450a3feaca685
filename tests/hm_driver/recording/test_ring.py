import threading
import time
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hm_driver.errors import RecordingError
from hm_driver.recording.ring import HEADER_BYTES, Ring, WhenFull, ring_bytes


def take(reader, max_bytes=1 << 20):
    """Drain and release."""
    records = reader.drain(max_bytes)
    reader.release()
    return records


def pair(capacity=4096, **options):
    buffer = bytearray(ring_bytes(capacity))
    Ring.format(buffer)
    return Ring(buffer, **options), Ring(buffer)


def test_records_come_out_as_they_went_in():
    writer, reader = pair()
    writer.write(3, -5, b"abc", flags=9)
    writer.write(4, 10**18, b"")
    first, second = take(reader)
    assert first == (3, 9, -5, 0, b"abc")
    assert second == (4, 0, 10**18, 0, b"")
    assert take(reader) == []


def test_a_reserved_record_is_invisible_until_it_is_committed():
    writer, reader = pair()
    offset = writer.reserve(1, 0, 8)
    writer.data[offset : offset + 8] = b"12345678"
    assert take(reader) == []
    writer.commit()
    assert [record.payload for record in take(reader)] == [b"12345678"]


@settings(max_examples=60, deadline=None)
@given(
    capacity=st.integers(256, 1000),
    steps=st.lists(st.one_of(st.integers(0, 150), st.just(-1)), max_size=200),
)
def test_any_mix_of_writing_and_draining_loses_only_what_is_counted(capacity, steps):
    writer, reader = pair(capacity)
    expected, got, lost = deque(), [], 0
    for number, step in enumerate(steps):
        if step < 0:
            got += take(reader, 200)
        elif writer.write(1, number, bytes([number % 256]) * step):
            expected.append((number, bytes([number % 256]) * step))
        else:
            lost += 1
    while reader.used:
        got += take(reader, 200)
    assert [(record.log_time_ns, record.payload) for record in got] == list(expected)
    assert reader.dropped == lost
    sequences = [record.sequence for record in got]
    assert sequences == sorted(set(sequences))


def test_dropped_records_leave_a_gap_in_the_sequence_of_their_channel():
    writer, reader = pair(256)
    assert [writer.write(1, n, bytes(40)) for n in range(6)] == [True] * 4 + [False] * 2
    before = take(reader)
    writer.write(2, 7, b"x")
    writer.write(1, 8, b"x")
    after = take(reader)
    assert [record.sequence for record in before] == [0, 1, 2, 3]
    assert [(record.channel, record.sequence) for record in after] == [(2, 0), (1, 6)]
    assert reader.dropped == 2


def test_a_blocking_ring_waits_for_its_reader_and_loses_nothing():
    writer, reader = pair(512, when_full=WhenFull.BLOCK)
    got = []

    def drain():
        while len(got) < 500:
            got.extend(take(reader))
            time.sleep(0.0001)

    thread = threading.Thread(target=drain)
    thread.start()
    for number in range(500):
        assert writer.write(1, number, bytes(number % 200))
    thread.join()
    assert [record.log_time_ns for record in got] == list(range(500))
    assert writer.dropped == 0


def test_a_blocking_ring_without_a_reader_says_so():
    writer, _ = pair(256, when_full=WhenFull.BLOCK, patience_s=0.05)
    for number in range(4):
        writer.write(1, number, bytes(40))
    with pytest.raises(RecordingError, match="is the recorder alive"):
        writer.write(1, 4, bytes(40))


def test_a_record_that_can_never_fit_is_refused_or_dropped():
    blocking, _ = pair(256, when_full=WhenFull.BLOCK)
    with pytest.raises(RecordingError, match="make the ring larger"):
        blocking.write(1, 0, bytes(300))
    dropping, _ = pair(256)
    assert not dropping.write(1, 0, bytes(300))
    assert dropping.dropped == 1


def test_a_writer_that_starts_again_goes_on_behind_the_records_of_the_first():
    buffer = bytearray(ring_bytes(1024))
    Ring.format(buffer)
    Ring(buffer).write(1, 0, b"first")
    Ring(buffer).write(1, 1, b"second")
    assert [record.payload for record in take(Ring(buffer))] == [b"first", b"second"]


def test_memory_without_a_ring_and_damaged_records_are_refused():
    with pytest.raises(RecordingError, match="no formatted ring"):
        Ring(bytearray(1000))
    with pytest.raises(ValueError, match="or more"):
        Ring.format(bytearray(HEADER_BYTES))
    writer, reader = pair()
    writer.write(1, 0, b"abc")
    writer.data[0:4] = b"\xff\xff\x00\x00"
    with pytest.raises(RecordingError, match="damaged"):
        take(reader)


def test_closing_releases_the_memory_and_may_be_done_twice():
    buffer = bytearray(ring_bytes(256))
    Ring.format(buffer)
    with Ring(buffer) as ring:
        ring.write(1, 0, b"x")
    ring.close()
    buffer.append(0)  # raises while a view is still there


@pytest.mark.parametrize("when_full", list(WhenFull))
def test_a_series_leaves_the_ring_as_its_records_one_by_one_do(when_full):
    one, other = bytearray(ring_bytes(512)), bytearray(ring_bytes(512))
    rings = []
    for memory in (one, other):
        Ring.format(memory)
        rings.append((Ring(memory, when_full=when_full), Ring(memory)))
    (series, _), (single, _) = rings
    for k in range(40):
        payload = bytes(range(k, k + 42))
        series.write_series(7, 100 * k, 3, memoryview(payload), 14)
        for part in range(3):
            single.write(7, 100 * k + 3 * part, payload[14 * part : 14 * part + 14])
        assert one == other
        if when_full is WhenFull.BLOCK or k % 3 == 0:
            assert take(rings[0][1]) == take(rings[1][1])


def test_what_was_read_and_not_released_is_read_again_by_the_next_reader():
    memory = bytearray(ring_bytes(1024))
    Ring.format(memory)
    with Ring(memory) as writer:
        for number in range(3):
            writer.write(1, number, b"abc")
        with Ring(memory) as reader:
            assert len(reader.drain(1)) == 1
            reader.release()
            assert len(reader.drain()) == 2
            assert reader.unreleased > 0
        with Ring(memory) as successor:
            assert [record.sequence for record in successor.drain()] == [1, 2]
        assert writer.used == 2 * 32
