import multiprocessing
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from hm_driver.errors import LoopError
from hm_driver.realtime.latch import Latch, latch_size
from hm_driver.realtime.segment import SEGMENT_SIZE, Segment, Status, Trip, Word
from hm_driver.realtime.setpoint import LoopState, SetPoint
from hm_driver.realtime.shared import PREFIX, SharedBlock, remove_stale_blocks, shared_directory


def test_a_fresh_segment_is_that_of_a_loop_that_has_not_started():
    segment = Segment.in_memory()
    assert segment.status is Status.STARTING
    assert segment.trip is Trip.NONE
    assert segment.state() == LoopState()
    assert segment.set_point() == SetPoint()
    assert segment.text("error") == ""


def test_the_newest_set_point_is_read_and_counted():
    segment = Segment.in_memory()
    for sequence in (1.0, 2.0, 3.0):
        segment.publish(SetPoint(sequence=sequence, target_z=0.1 * sequence))
    assert segment.set_points.count == 3
    assert segment.set_point() == SetPoint(sequence=3.0, target_z=0.1 * 3.0)


def test_a_writer_that_died_half_way_leaves_the_last_whole_value_readable():
    block = bytearray(latch_size(3))
    latch = Latch(memoryview(block), 3)
    latch.write((1.0, 2.0, 3.0))
    latch.write((4.0, 5.0, 6.0))
    slot_of_the_next_value = 8 + (3 & 1) * 24
    block[slot_of_the_next_value : slot_of_the_next_value + 8] = b"\xff" * 8
    assert latch.read() == (4.0, 5.0, 6.0)


def test_a_reader_never_sees_a_mixture_of_two_values_of_a_thread():
    latch = Latch(memoryview(bytearray(latch_size(23))), 23)
    latch.write([0.0] * 23)
    done = threading.Event()

    def write() -> None:
        number = 0.0
        while not done.is_set():
            number += 1.0
            latch.write([number] * 23)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(5000):
            assert len(set(latch.read())) == 1
    finally:
        done.set()
        writer.join()


def _write_states(path: str) -> None:
    with SharedBlock.attach(path) as block:
        segment = Segment(block.buffer)
        number = 0.0
        while not segment.words[Word.STOP_REQUESTED]:
            number += 1.0
            segment.publish_state([number] * len(LoopState._fields))
        segment.status = Status.STOPPED
        segment.close()


def test_a_reader_never_sees_a_mixture_of_two_values_of_another_process():
    with SharedBlock.create(SEGMENT_SIZE, tag="test") as block:
        segment = Segment(block.buffer)
        child = multiprocessing.get_context("spawn").Process(target=_write_states, args=(str(block.path),))
        child.start()
        while not segment.states_published:
            assert child.is_alive()
        seen = {segment.state().cycle for _ in range(20_000) if len(set(segment.state())) == 1}
        mixtures = sum(len(set(segment.state())) != 1 for _ in range(20_000))
        segment.words[Word.STOP_REQUESTED] = 1
        child.join(10)
        assert mixtures == 0
        assert len(seen) > 10
        assert segment.status is Status.STOPPED
        segment.close()


def test_only_the_first_trip_is_kept():
    segment = Segment.in_memory()
    assert segment.set_trip(Trip.FORCE, "120 N is above 100 N", 7)
    assert not segment.set_trip(Trip.LINK, "later", 9)
    assert (segment.trip, segment.text("trip"), segment.words[Word.TRIP_NS]) == (
        Trip.FORCE,
        "120 N is above 100 N",
        7,
    )


def test_a_text_that_is_too_long_is_cut_at_a_whole_character():
    segment = Segment.in_memory()
    segment.write_text("error", "ä" * 3000)
    assert segment.text("error") == "ä" * 1020


def test_a_buffer_that_is_too_small_or_holds_something_else_is_refused():
    with pytest.raises(LoopError, match="takes"):
        Segment(bytearray(10))
    with pytest.raises(LoopError, match="no segment"):
        Segment(bytearray(b"\x01" * SEGMENT_SIZE))


def test_a_shared_block_is_seen_by_everyone_and_removed_by_its_owner_alone():
    owner = SharedBlock.create(64, tag="test")
    guest = SharedBlock.attach(owner.path)
    guest.buffer[3] = 42
    guest.close()
    assert owner.path.exists()
    assert owner.buffer[3] == 42
    owner.close()
    owner.close()
    assert not owner.path.exists()


def test_attaching_to_a_block_that_is_gone_says_so():
    with pytest.raises(LoopError, match="has ended"):
        SharedBlock.attach(shared_directory() / f"{PREFIX}0-none")


def test_a_block_left_by_a_killed_run_is_removed_by_the_next_one():
    code = (
        "from hm_driver.realtime.shared import SharedBlock; import os, sys;"
        "b = SharedBlock.create(64, tag='killed'); print(b.path, flush=True); os.kill(os.getpid(), 9)"
    )
    command = [sys.executable, "-c", code]
    killed = subprocess.run(command, capture_output=True, text=True, check=False)  # ours
    path = Path(killed.stdout.strip())
    assert path.exists()
    with SharedBlock.create(64, tag="test") as mine:
        assert not path.exists()
        assert mine.path not in remove_stale_blocks()
        assert mine.path.exists()
