import mmap
import os
import signal
import subprocess
import sys
import time
from random import Random

import pytest
from mcap.reader import make_reader

from hm_driver.errors import ConfigurationError, RecordingError
from hm_driver.recording import open as open_log
from hm_driver.recording.recorder import RecorderOptions, RecorderProcess, RingSource
from hm_driver.recording.ring import Ring, WhenFull, ring_bytes
from hm_driver.recording.schemas import EVENT, EVENTS_CHANNEL, LOOP_BUNDLE
from hm_driver.recording.writer import Attachment, Compression

EPOCH_NS = 1_800_000_000_000_000_000


def shared_file(path, capacity=1 << 20):
    path.write_bytes(bytes(ring_bytes(capacity)))
    with path.open("r+b") as file:
        mapping = mmap.mmap(file.fileno(), 0)
    Ring.format(mapping)
    return mapping


def loop_values(cycle):
    time_ns = EPOCH_NS + cycle * 1_000_000
    state = [cycle, time_ns] + [0.1 * cycle] * 9
    command = [cycle, time_ns] + [1.0] * 17
    return state + command + [cycle, time_ns, 1, 2, 3, 4, 0, 1e-3, 0]


def write_cycle(ring, cycle):
    payload = LOOP_BUNDLE.pack(*loop_values(cycle))
    return ring.write(LOOP_BUNDLE.id, EPOCH_NS + cycle * 1_000_000, payload)


def messages_of(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            (channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()
        ]


def wait_until(condition, timeout_s=20.0):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_what_was_written_into_the_rings_is_in_the_file(tmp_path):
    loop_memory, event_memory = shared_file(tmp_path / "loop"), shared_file(tmp_path / "events")
    recorder = RecorderProcess(
        tmp_path / "log.mcap",
        rings=[RingSource(tmp_path / "loop"), RingSource(tmp_path / "events")],
        metadata={"session": {"seed": "7"}},
        attachments=[Attachment("config.json", "application/json", b"{}")],
    )
    with recorder, Ring(loop_memory, when_full=WhenFull.BLOCK) as loop, Ring(event_memory) as events:
        for cycle in range(5000):
            write_cycle(loop, cycle)
            if cycle % 1000 == 0:
                time_ns = EPOCH_NS + cycle * 1_000_000
                events.write(EVENTS_CHANNEL.id, time_ns, EVENT.pack(cycle, time_ns, 2, "tick", "A tick", []))
        final = recorder.stop()
    assert (final.messages, final.lost, final.problem) == (15_005, 0, "")
    assert final.bytes == (tmp_path / "log.mcap").stat().st_size
    messages = messages_of(tmp_path / "log.mcap")
    assert len(messages) == 15_005
    states = [data for topic, _, data in messages if topic == "/device/state"]
    assert states == [LOOP_BUNDLE.pack(*loop_values(cycle))[:105] for cycle in range(5000)]
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file)
        assert [attachment.data for attachment in reader.iter_attachments()] == [b"{}"]
        names = {record.name: record.metadata for record in reader.iter_metadata()}
    assert names["session"] == {"seed": "7"}
    assert names["recording"] == {"messages": "15005", "lost": "0"}


def test_equal_input_gives_equal_messages(tmp_path):
    logs = []
    for name in ("a", "b"):
        memory = shared_file(tmp_path / name, capacity=1 << 16)
        recorder = RecorderProcess(tmp_path / f"{name}.mcap", rings=[RingSource(tmp_path / name)])
        with recorder, Ring(memory, when_full=WhenFull.BLOCK) as ring:
            for cycle in range(2000):
                write_cycle(ring, cycle)
            recorder.stop()
        logs.append(messages_of(tmp_path / f"{name}.mcap"))
    assert logs[0] == logs[1]


def test_dropped_records_are_counted_as_lost_messages(tmp_path):
    memory = shared_file(tmp_path / "ring", capacity=4096)
    with Ring(memory) as ring:
        written = sum(write_cycle(ring, cycle) for cycle in range(100))
        recorder = RecorderProcess(tmp_path / "log.mcap", rings=[RingSource(tmp_path / "ring")])
        with recorder:
            wait_until(lambda: recorder.status().messages == 3 * written)
            assert write_cycle(ring, 100)
            final = recorder.stop()
    assert final.lost == 3 * (100 - written)
    assert final.messages == 3 * (written + 1)


def test_ctrl_c_does_not_end_the_recorder(tmp_path):
    memory = shared_file(tmp_path / "ring")
    recorder = RecorderProcess(tmp_path / "log.mcap", rings=[RingSource(tmp_path / "ring")])
    with recorder, Ring(memory) as ring:
        os.kill(recorder.pid, signal.SIGINT)
        write_cycle(ring, 0)
        time.sleep(0.05)
        assert recorder.is_alive
        assert recorder.stop().messages == 3


def test_a_recorder_that_died_says_so_and_what_it_synced_is_there(tmp_path):
    memory = shared_file(tmp_path / "ring")
    options = RecorderOptions(sync_interval_s=0.05)
    recorder = RecorderProcess(tmp_path / "log.mcap", rings=[RingSource(tmp_path / "ring")], options=options)
    with recorder, Ring(memory) as ring:
        before = (tmp_path / "log.mcap").stat().st_size
        write_cycle(ring, 0)
        wait_until(lambda: (tmp_path / "log.mcap").stat().st_size > before)
        os.kill(recorder.pid, signal.SIGKILL)
        with pytest.raises(RecordingError, match="readable up to its last flush"):
            recorder.stop()


def test_a_recorder_that_died_goes_on_in_a_new_part_with_what_the_ring_held_meanwhile(tmp_path):
    memory = shared_file(tmp_path / "ring")
    recorder = RecorderProcess(tmp_path / "log.mcap", rings=[RingSource(tmp_path / "ring")])
    with recorder, Ring(memory) as ring:
        write_cycle(ring, 0)
        wait_until(lambda: not ring.used)
        assert not recorder.restart_if_dead()
        os.kill(recorder.pid, signal.SIGKILL)
        wait_until(lambda: not recorder.is_alive)
        write_cycle(ring, 1)
        assert recorder.restart_if_dead()
        final = recorder.stop()
    assert (final.path.name, final.messages, final.lost) == ("log.part2.mcap", 3, 0)
    assert len(messages_of(tmp_path / "log.part2.mcap")) == 3


def cycles_of(path):
    """Log times [ms since the epoch of the test] on the state's channel, also of a file without an end."""
    with open_log(path) as log:
        times = log.columns("/device/state", names=())["log_time_ns"]
    return [round((time_ns - EPOCH_NS) / 1e6) for time_ns in times.tolist()]


@pytest.mark.filterwarnings("ignore:.*:UserWarning")
def test_a_recorder_killed_again_and_again_loses_nothing_of_what_the_ring_held(tmp_path):
    memory = shared_file(tmp_path / "ring")
    options = RecorderOptions(sync_interval_s=0.02)
    recorder = RecorderProcess(tmp_path / "log.mcap", rings=[RingSource(tmp_path / "ring")], options=options)
    cycle = 0
    random = Random(5)
    with recorder, Ring(memory) as ring:
        for _ in range(6):
            for _ in range(random.randrange(1, 40)):
                assert write_cycle(ring, cycle)
                cycle += 1
                time.sleep(0.001)
            os.kill(recorder.pid, signal.SIGKILL)
            wait_until(lambda: not recorder.is_alive)
            assert recorder.restart_if_dead()
        final = recorder.stop()
    parts = [tmp_path / "log.mcap", *(tmp_path / f"log.part{n}.mcap" for n in range(2, 8))]
    assert final.path == parts[-1]
    assert cycles_of(parts[0]) == list(range(cycle))


def test_a_log_goes_on_in_another_part_when_it_has_its_size(tmp_path):
    memory = shared_file(tmp_path / "ring", 1 << 22)
    options = RecorderOptions(sync_interval_s=0.01, split_bytes=1 << 16, compression=Compression.NONE)
    recorder = RecorderProcess(
        tmp_path / "log.mcap",
        rings=[RingSource(tmp_path / "ring")],
        metadata={"session": {"seed": "7"}},
        options=options,
    )
    with recorder, Ring(memory) as ring:
        for cycle in range(600):
            assert write_cycle(ring, cycle)
            time.sleep(0.0005)
        final = recorder.stop()
    parts = sorted(tmp_path.glob("log*.mcap"), key=lambda path: path.stat().st_mtime_ns)
    assert len(parts) > 2
    assert (final.messages, final.lost) == (1800, 0)
    assert cycles_of(tmp_path / "log.mcap") == list(range(600))
    with open_log(tmp_path / "log.mcap") as log:
        assert log.parts == tuple(parts)
        assert log.counts["/loop/timing"] == 600
        assert log.metadata["session"] == {"seed": "7"}
    sequences = []
    for number, part in enumerate(parts, start=1):
        with part.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert {one.name: one.metadata for one in reader.iter_metadata()}["part"] == {
                "number": str(number),
                "log": "log.mcap",
            }
            sequences += [m.sequence for _, _, m in reader.iter_messages(topics="/device/state")]
    assert sequences == list(range(600))


def test_what_a_full_ring_dropped_is_a_gap_in_the_sequence_numbers(tmp_path):
    memory = shared_file(tmp_path / "ring", 1 << 12)
    with Ring(memory) as ring:
        kept = sum(write_cycle(ring, cycle) for cycle in range(50))
        recorder = RecorderProcess(tmp_path / "log.mcap", rings=[RingSource(tmp_path / "ring")])
        with recorder:
            wait_until(lambda: not ring.used)
            write_cycle(ring, 50)
            assert recorder.stop().lost == 3 * (50 - kept)
    with (tmp_path / "log.mcap").open("rb") as file:
        sequences = [m.sequence for _, _, m in make_reader(file).iter_messages(topics="/device/state")]
    assert sequences == [*range(kept), 50]


@pytest.mark.parametrize(
    ("field", "value"), [("split_bytes", 10), ("split_s", 0.0), ("sync_interval_s", 0.0), ("chunk_bytes", 1)]
)
def test_an_option_out_of_range_is_refused_by_its_name(field, value):
    with pytest.raises(ConfigurationError, match=field):
        RecorderOptions(**{field: value})


def test_the_file_is_finished_when_the_parent_is_killed(tmp_path):
    memory = shared_file(tmp_path / "ring")
    with Ring(memory) as ring:
        write_cycle(ring, 0)
    code = (
        "import os, signal, sys\n"
        "from hm_driver.recording.recorder import RecorderProcess, RingSource\n"
        "recorder = RecorderProcess(sys.argv[1], rings=[RingSource(sys.argv[2])])\n"
        "recorder.start()\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    script = tmp_path / "parent.py"
    script.write_text(code)
    log = tmp_path / "log.mcap"
    command = [sys.executable, str(script), str(log), str(tmp_path / "ring")]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    wait_until(lambda: log.read_bytes().endswith(b"\x89MCAP0\r\n") and log.stat().st_size > 8)
    assert len(messages_of(log)) == 3


def test_a_log_that_cannot_be_made_or_a_ring_that_is_not_there_is_refused(tmp_path):
    shared_file(tmp_path / "ring")
    (tmp_path / "taken.mcap").touch()
    for path, ring, reason in (
        (tmp_path / "taken.mcap", "ring", "exists already"),
        (tmp_path / "no" / "log.mcap", "ring", "cannot be made"),
        (tmp_path / "log.mcap", "nothing", "cannot be opened"),
    ):
        with pytest.raises(RecordingError, match=reason):
            RecorderProcess(path, rings=[RingSource(tmp_path / ring)]).start()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")  # noqa: PTH110 - a device
def test_a_full_disk_is_told_and_the_rings_are_still_emptied(tmp_path):
    from hm_driver.recording import recorder_main
    from hm_driver.recording.spooler import Spooler
    from hm_driver.recording.writer import LogWriter

    memory = shared_file(tmp_path / "ring")
    ring, writer = Ring(memory), LogWriter(tmp_path / "log.mcap", [EVENTS_CHANNEL])
    writer._file.close()
    writer._file = open("/dev/full", "wb", buffering=0)  # noqa: PTH123, SIM115 - closed by the writer
    job = recorder_main.RecorderJob(
        path=writer.path,
        rings=(),
        channels=(EVENTS_CHANNEL,),
        bundles=(),
        derivers=(),
        metadata={},
        attachments=(),
        options=RecorderOptions(),
    )
    session = recorder_main._Session(None, writer, Spooler([ring], writer), job)
    ring.write(EVENTS_CHANNEL.id, EPOCH_NS, EVENT.pack(0, EPOCH_NS, 2, "a", "b", []))
    session._spool()
    session._guarded(session._sync)
    assert "No space left" in session.status().problem
    ring.write(EVENTS_CHANNEL.id, EPOCH_NS, EVENT.pack(1, EPOCH_NS, 2, "a", "b", []))
    assert session._spool() == 1
    assert (ring.used, session.status().messages, session.status().lost) == (0, 0, 2)
