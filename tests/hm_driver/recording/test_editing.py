import pytest
from mcap.reader import make_reader

from hm_driver.errors import RecordingError
from hm_driver.recording.editing import cut, merge
from hm_driver.recording.messages import Field, FixedMessage, Kind
from hm_driver.recording.reader import Recording
from hm_driver.recording.schemas import DEVICE_STATE, DEVICE_STATE_CHANNEL, EVENT, EVENTS_CHANNEL, Channel
from hm_driver.recording.writer import Attachment, LogWriter

SECOND = 10**9


def write(path, cycles, *, channels=(DEVICE_STATE_CHANNEL, EVENTS_CHANNEL), lost=()):
    with LogWriter(
        path,
        channels,
        metadata={"session": {"seed": path.stem}},
        attachments=[Attachment(name="config.json", media_type="application/json", data=b"{}")],
        chunk_bytes=1024,
    ) as writer:
        skipped = 0
        for cycle in cycles:
            if cycle in lost:
                skipped += 1
                continue
            payload = DEVICE_STATE.pack(cycle, cycle, *[0.5 * cycle] * 9)
            writer.chunk.add(DEVICE_STATE_CHANNEL.id, cycle * SECOND, payload, skipped)
            skipped = 0
            if cycle % 10 == 0:
                writer.add(EVENTS_CHANNEL.id, cycle * SECOND, EVENT.pack(cycle, 0, 2, "n", f"{cycle}", []))
            writer.end_full_chunk()
    return path


def sequences(path, topic):
    with path.open("rb") as file:
        return [m.sequence for _, _, m in make_reader(file, validate_crcs=True).iter_messages(topics=topic)]


def test_a_cut_holds_the_messages_of_its_range_and_what_the_log_says_of_itself(tmp_path):
    source = write(tmp_path / "a.mcap", range(100))
    assert cut(source, tmp_path / "b.mcap", 20.0, 50.0) == 33
    with Recording(tmp_path / "b.mcap") as log:
        assert log.columns("/device/state")["sequence"].tolist() == list(range(20, 50))
        assert log.columns("/events")["text"].tolist() == ["20", "30", "40"]
        assert log.metadata["session"] == {"seed": "a"}
        assert log.metadata["cut"] == {"source": "a.mcap", "start_s": "20.0", "end_s": "50.0"}
        assert log.attachments == {"config.json": b"{}"}


def test_a_gap_stays_a_gap_in_a_cut(tmp_path):
    source = write(tmp_path / "a.mcap", range(60), lost={25, 26})
    cut(source, tmp_path / "b.mcap", 20.0, 30.0, topics=["/device/state"])
    assert sequences(tmp_path / "b.mcap", "/device/state") == [20, 21, 22, 23, 24, 27, 28, 29]
    with Recording(tmp_path / "b.mcap") as log:
        assert log.topics == ("/device/state",)


def test_a_range_outside_the_log_or_a_topic_that_is_not_there_leaves_no_file(tmp_path):
    source = write(tmp_path / "a.mcap", range(10))
    for arguments, reason in (((20.0, 30.0), "outside"), ((None, None), "there are")):
        with pytest.raises(RecordingError, match=reason):
            cut(source, tmp_path / "b.mcap", *arguments, topics=None if arguments[0] else ["/no"])
        assert not (tmp_path / "b.mcap").exists()


def test_a_log_that_exists_is_not_written_over(tmp_path):
    source = write(tmp_path / "a.mcap", range(10))
    before = source.read_bytes()
    with pytest.raises(RecordingError, match="exists already"):
        cut(source, source)
    assert source.read_bytes() == before


def test_merged_logs_are_one_in_the_order_of_time_with_what_each_says_of_itself(tmp_path):
    late = write(tmp_path / "late.mcap", range(50, 80))
    early = write(tmp_path / "early.mcap", range(40))
    assert merge([late, early], tmp_path / "all.mcap") == 30 + 3 + 40 + 4
    with Recording(tmp_path / "all.mcap") as log:
        assert log.columns("/device/state")["sequence"].tolist() == [*range(40), *range(50, 80)]
        assert log.metadata["session"] == {"seed": "early"}
        assert log.metadata["late/session"] == {"seed": "late"}
        assert set(log.attachments) == {"config.json", "late/config.json"}
    assert sequences(tmp_path / "all.mcap", "/device/state") == list(range(70))


def test_parts_are_merged_into_one_whole_file(tmp_path):
    write(tmp_path / "log.mcap", range(30))
    write(tmp_path / "log.part2.mcap", range(29, 50))
    merge([tmp_path / "log.mcap"], tmp_path / "whole.mcap")
    with Recording(tmp_path / "whole.mcap") as log:
        assert log.columns("/device/state")["sequence"].tolist() == list(range(50))


def test_topics_of_different_schemas_are_not_merged(tmp_path):
    write(tmp_path / "a.mcap", range(3))
    other = Channel(1, "/device/state", FixedMessage("Other", "Another.", (Field("x", Kind.DOUBLE, "X"),)))
    with LogWriter(tmp_path / "b.mcap", [other]) as writer:
        writer.add(1, 0, b"\x09" + bytes(8))
    with pytest.raises(RecordingError, match=r"hapticmaster\.DeviceState .* hapticmaster\.Other"):
        merge([tmp_path / "a.mcap", tmp_path / "b.mcap"], tmp_path / "c.mcap")
    assert not (tmp_path / "c.mcap").exists()
