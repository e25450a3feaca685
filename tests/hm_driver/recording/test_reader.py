import random
import warnings

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

import hm_driver.recording
from hm_driver.errors import HapticMasterError, RecordingError
from hm_driver.recording.reader import Recording, RecordingWarning
from hm_driver.recording.recovery import recover
from hm_driver.recording.schemas import (
    DEVICE_CHANNELS,
    DEVICE_STATE,
    DEVICE_STATE_CHANNEL,
    EVENT,
    EVENTS_CHANNEL,
    Channel,
    Field,
    FixedMessage,
    Kind,
)
from hm_driver.recording.writer import Attachment, Compression, LogWriter

EPOCH_NS = 1_800_000_000_000_000_000
CYCLES = 3000


def state(cycle):
    return cycle, EPOCH_NS + cycle * 1_000_000, *(cycle * 0.5 + place for place in range(9))


def write_log(path, cycles=CYCLES, **options):
    writer = LogWriter(
        path,
        DEVICE_CHANNELS,
        metadata={"session": {"seed": "3"}},
        attachments=[Attachment("config.json", "application/json", b'{"a": 1}')],
        **options,
    )
    with writer:
        for cycle in range(cycles):
            time_ns = EPOCH_NS + cycle * 1_000_000
            writer.add(DEVICE_STATE_CHANNEL.id, time_ns, DEVICE_STATE.pack(*state(cycle)))
            if cycle % 500 == 0:
                event = EVENT.pack(cycle, time_ns, 2, "tick", f"tick {cycle}", [0.5] * (cycle // 500))
                writer.add(EVENTS_CHANNEL.id, time_ns, event)
    return path


@pytest.fixture(params=Compression)
def log(tmp_path, request):
    return write_log(tmp_path / "log.mcap", compression=request.param, chunk_bytes=20_000)


def test_what_two_parts_both_hold_is_read_once(tmp_path):
    def write(name, cycles):
        with LogWriter(tmp_path / name, DEVICE_CHANNELS) as writer:
            for cycle in cycles:
                payload = DEVICE_STATE.pack(cycle, cycle, *[0.5 * cycle] * 9)
                writer.add(DEVICE_STATE_CHANNEL.id, 1000 + cycle, payload)
                writer.add(EVENTS_CHANNEL.id, 1000 + cycle, EVENT.pack(cycle, 0, 2, "n", "t", []))
                if cycle % 4 == 3:
                    writer.end_chunk()

    write("log.mcap", range(12))
    write("log.part2.mcap", range(9, 20))
    write("log.part10.mcap", range(20, 22))
    write("log.part03.mcap", range(90, 92))
    write("other.part2.mcap", range(90, 92))
    with Recording(tmp_path / "log.mcap") as log:
        assert log.columns("/device/state")["sequence"].tolist() == list(range(22))
        assert log.columns("/events")["sequence"].tolist() == list(range(22))
        assert log.counts["/device/state"] == 22
        late = log.columns("/device/state", 15e-9, 21e-9)["sequence"].tolist()
        assert late == list(range(15, 21))
    with Recording(tmp_path / "log.part2.mcap") as log:
        assert log.columns("/device/state")["sequence"].tolist() == list(range(9, 20))


def test_columns_are_what_was_written(log):
    with hm_driver.recording.open(log) as recording:
        columns = recording.columns("/device/state")
        assert recording.counts["/device/state"] == CYCLES
        assert recording.duration_s == pytest.approx((CYCLES - 1) / 1000)
    cycles = np.arange(CYCLES)
    assert columns["sequence"].dtype == np.uint64
    np.testing.assert_array_equal(columns["log_time_ns"], EPOCH_NS + cycles * 1_000_000)
    np.testing.assert_array_equal(columns["time_ns"], columns["log_time_ns"])
    np.testing.assert_array_equal(columns["measured_force.z"], cycles * 0.5 + 8)
    assert list(columns) == ["log_time_ns", *DEVICE_STATE.columns]


def test_text_and_lists_are_columns_of_objects(log):
    with hm_driver.recording.open(log) as recording:
        events = recording.columns("/events")
    assert list(events["text"]) == [f"tick {cycle}" for cycle in range(0, CYCLES, 500)]
    assert [len(values) for values in events["values"]] == [0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(events["values"][2], [0.5, 0.5])


def test_a_time_range_is_half_open_and_in_seconds_of_the_log(log):
    with hm_driver.recording.open(log) as recording:
        columns = recording.columns("/device/state", 1.0, 1.01, names=["sequence"])
        assert list(columns) == ["log_time_ns", "sequence"]
        np.testing.assert_array_equal(columns["sequence"], np.arange(1000, 1010))
        assert len(recording.columns("/device/state", start=2.9)["sequence"]) == 100
        assert len(recording.columns("/loop/timing", 1.0, 2.0)["sequence"]) == 0


def test_metadata_attachments_and_units_are_there(log):
    with hm_driver.recording.open(log) as recording:
        assert recording.metadata["session"] == {"seed": "3"}
        assert recording.attachments == {"config.json": b'{"a": 1}'}
        summary = recording.describe("/device/state")
    assert (summary.schema, summary.units["measured_force.x"]) == ("hapticmaster.DeviceState", "N")


def test_what_is_not_there_is_refused_with_what_is(log, tmp_path):
    with hm_driver.recording.open(log) as recording:
        with pytest.raises(
            RecordingError, match=r"no channel /nothing; there are: /device/command, /device/state"
        ):
            recording.columns("/nothing")
        with pytest.raises(RecordingError, match=r"no column \['force'\]; there are"):
            recording.columns("/device/state", names=["force"])
        for start, end in ((5.0, None), (None, -1.0), (2.0, 1.0)):
            with pytest.raises(RecordingError, match=r"outside of 0 to 2\.999 s"):
                recording.columns("/device/state", start, end)
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "foreign.mcap").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    for name, reason in (("none", "cannot be opened"), ("empty", "is empty"), ("foreign", "is no MCAP file")):
        with pytest.raises(RecordingError, match=reason):
            hm_driver.recording.open(tmp_path / f"{name}.mcap")


def test_the_library_reads_our_file_with_every_checksum_right(log):
    with log.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_summary().statistics.message_count == CYCLES + 6
        messages = list(reader.iter_messages())
        assert len(messages) == CYCLES + 6
        assert [name.name for name in reader.iter_attachments()] == ["config.json"]


def test_a_file_cut_anywhere_gives_what_stands_before_the_cut_with_one_warning(tmp_path):
    whole = write_log(tmp_path / "whole.mcap", chunk_bytes=20_000).read_bytes()
    cut = tmp_path / "cut.mcap"
    got = []
    for size in (len(whole) - 1, len(whole) - 100, len(whole) * 3 // 4, len(whole) // 2, len(whole) // 3):
        cut.write_bytes(whole[:size])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with hm_driver.recording.open(cut) as recording:
                sequence = recording.columns("/device/state")["sequence"]
                assert recording.counts["/device/state"] == len(sequence)
                assert recording.attachments["config.json"] == b'{"a": 1}'
        assert [one.category for one in caught] == [RecordingWarning]
        np.testing.assert_array_equal(sequence, np.arange(len(sequence)))
        got.append(len(sequence))
    assert got[0] == got[1] == CYCLES
    assert got == sorted(got, reverse=True)
    assert got[3] > CYCLES // 4


def test_recovery_makes_a_whole_file_of_a_cut_one(tmp_path):
    whole = write_log(tmp_path / "whole.mcap", chunk_bytes=20_000).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    result = recover(tmp_path / "cut.mcap", tmp_path / "new.mcap")
    assert result.messages > CYCLES // 4
    assert "cut off" in result.damaged[0]
    with hm_driver.recording.open(tmp_path / "new.mcap") as recording:
        assert recording.damage == ""
        sequence = recording.columns("/device/state")["sequence"]
        assert recording.metadata["session"] == {"seed": "3"}
        assert recording.attachments["config.json"] == b'{"a": 1}'
    np.testing.assert_array_equal(sequence, np.arange(len(sequence)))
    with (tmp_path / "new.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == result.messages
    with pytest.raises(RecordingError, match="exists already"):
        recover(tmp_path / "cut.mcap", tmp_path / "new.mcap")


def test_flipped_bits_never_give_a_traceback_or_wrong_data(tmp_path):
    whole = write_log(tmp_path / "whole.mcap", cycles=400, chunk_bytes=10_000).read_bytes()
    truth = {cycle: state(cycle) for cycle in range(400)}
    random_bits = random.Random(5)
    for _ in range(150):
        damaged = bytearray(whole)
        damaged[random_bits.randrange(len(whole))] ^= 1 << random_bits.randrange(8)
        path = tmp_path / "damaged.mcap"
        path.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)
            try:
                with hm_driver.recording.open(path) as recording:
                    columns = recording.columns("/device/state")
                    assert recording.metadata is not None
                    assert recording.attachments in ({"config.json": b'{"a": 1}'}, {})
            except HapticMasterError:
                continue
        for cycle, *values in zip(*(columns[name] for name in DEVICE_STATE.columns), strict=True):
            assert tuple(values) == truth[cycle][1:]


def test_a_log_of_the_library_s_own_writer_is_read_whole_and_cut(tmp_path):
    path = tmp_path / "library.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2000, compression=CompressionType.LZ4)
        writer.start()
        schema = writer.register_schema(
            "hapticmaster.DeviceState", "protobuf", DEVICE_STATE.file_descriptor_set()
        )
        channel = writer.register_channel("/device/state", "protobuf", schema)
        text = writer.register_channel("/text", "json", 0)
        for cycle in range(200):
            time_ns = EPOCH_NS + cycle
            writer.add_message(channel, time_ns, DEVICE_STATE.pack(*state(cycle)), time_ns)
        writer.add_message(text, EPOCH_NS, b"{}", EPOCH_NS)
        writer.finish()
    with hm_driver.recording.open(path) as recording:
        np.testing.assert_array_equal(recording.columns("/device/state")["sequence"], np.arange(200))
        with pytest.raises(RecordingError, match="/text is not protobuf but json"):
            recording.columns("/text")
    path.write_bytes(path.read_bytes()[:8000])
    with pytest.warns(RecordingWarning), hm_driver.recording.open(path) as recording:
        sequence = recording.columns("/device/state")["sequence"]
    np.testing.assert_array_equal(sequence, np.arange(len(sequence)))
    assert len(sequence) > 20


def test_a_log_of_an_older_schema_opens_with_the_columns_it_has(tmp_path):
    older = FixedMessage("DeviceState", "Before force was logged.", DEVICE_STATE.fields[:3])
    channel = Channel(1, "/device/state", older)
    with LogWriter(tmp_path / "old.mcap", [channel]) as writer:
        writer.add(1, EPOCH_NS, older.pack(1, EPOCH_NS, 0.1, 0.2, 0.3))
    with hm_driver.recording.open(tmp_path / "old.mcap") as recording:
        columns = recording.columns("/device/state")
    assert "measured_force.x" not in columns
    assert columns["measured_position.z"][0] == 0.3


def test_messages_that_do_not_look_like_their_schema_are_parsed_one_by_one(tmp_path):
    message = FixedMessage("Pair", "Two.", (Field("a", Kind.DOUBLE, "One"), Field("b", Kind.DOUBLE, "Two")))
    with LogWriter(tmp_path / "log.mcap", [Channel(40, "/pair", message)]) as writer:
        full, swapped = message.pack(1.0, 2.0), message.pack(3.0, 4.0)[9:] + message.pack(3.0, 4.0)[:9]
        for place, payload in enumerate((full, swapped, full[9:])):
            writer.add(40, EPOCH_NS + place, payload)
    with hm_driver.recording.open(tmp_path / "log.mcap") as recording:
        columns = recording.columns("/pair")
    np.testing.assert_array_equal(columns["a"], [1.0, 3.0, 0.0])
    np.testing.assert_array_equal(columns["b"], [2.0, 4.0, 2.0])
