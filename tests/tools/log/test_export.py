import csv
import importlib.util
import json
import sys

import numpy as np
import pyarrow.parquet
import pytest
from log_bench import write
from mcap.writer import Writer
from scipy.io import loadmat

import hm_driver.recording
from hm_driver.errors import RecordingError
from hm_driver.recording.messages import Field, Kind, VariableMessage
from hm_driver.recording.schemas import EVENT, Channel
from hm_driver.recording.writer import LogWriter
from tools.cli.main import run
from tools.log.export import Selection, export
from tools.log.mat_file import matlab_name


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("log") / "log.mcap")


@pytest.fixture(scope="module")
def truth(log):
    with hm_driver.recording.open(log) as recording:
        return {topic: recording.columns(topic) for topic in recording.topics}


def read_csv(path):
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, zip(*rows, strict=True), strict=True))


def test_a_csv_file_holds_every_digit_of_a_topic(tmp_path, log, truth):
    assert export(log, tmp_path / "a.csv", Selection(topics=("/device/state",))) == {tmp_path / "a.csv": 300}
    table = read_csv(tmp_path / "a.csv")
    assert list(table)[:3] == ["time_s", "log_time_ns", "sequence"]
    assert [float(one) for one in table["time_s"]] == [cycle / 1000 for cycle in range(300)]
    for name, values in truth["/device/state"].items():
        assert [type(values[0].item())(one) for one in table[name]] == values.tolist()


def test_several_topics_go_into_a_csv_file_each(tmp_path, log):
    written = export(log, tmp_path / "a.csv", Selection())
    names = ("device-command", "device-state", "events", "loop-timing", "teaching-arbitration")
    assert [path.name for path in written] == [f"a-{name}.csv" for name in names]
    assert set(tmp_path.iterdir()) == set(written)
    assert read_csv(tmp_path / "a-events.csv")["text"] == ("force 90 N",)


def test_a_vectors_name_stands_for_its_components_and_a_range_for_its_messages(tmp_path, log):
    words = ["log", "export", str(log), str(tmp_path / "a.csv"), "--column", "measured_force"]
    assert run([*words, "--start", "0.1", "--end", "0.2"]) == 0
    table = read_csv(tmp_path / "a.csv")
    axes = [f"measured_force.{axis}" for axis in "xyz"]
    assert list(table) == ["time_s", "log_time_ns", *axes]
    assert (len(table["time_s"]), table["time_s"][0], table["time_s"][-1]) == (100, "0.1", "0.199")


def test_a_parquet_file_has_exact_types_and_units(tmp_path, log, truth):
    export(log, tmp_path / "a.parquet", Selection())
    table = pyarrow.parquet.read_table(tmp_path / "a-teaching-arbitration.parquet")
    for name, values in truth["/teaching/arbitration"].items():
        np.testing.assert_array_equal(table[name].to_numpy(), values)
        assert table[name].to_numpy().dtype == values.dtype
    assert table.schema.field("force").metadata == {b"unit": b"N"}
    assert table.schema.metadata[b"topic"] == b"/teaching/arbitration"
    events = pyarrow.parquet.read_table(tmp_path / "a-events.parquet")
    assert events["text"].to_pylist() == ["force 90 N"]
    assert events["values"].to_pylist() == [[]]


def test_a_matlab_file_has_a_struct_a_topic_with_names_that_matlab_takes(tmp_path, log, truth):
    assert list(export(log, tmp_path / "a.mat", Selection()).values()) == [300 * 3 + 30 + 1]
    file = loadmat(tmp_path / "a.mat", simplify_cells=True)
    state = file["device_state"]
    np.testing.assert_array_equal(state["measured_force_z"], truth["/device/state"]["measured_force.z"])
    assert state["log_time_ns"].dtype == np.int64
    assert file["units"]["device_state"]["measured_force_z"] == "N"
    assert file["events"]["text"] == "force 90 N"
    columns = loadmat(tmp_path / "a.mat")["loop_timing"]["dt_s"][0, 0]
    assert columns.shape == (300, 1)


def test_matlab_names_are_valid_and_unique():
    assert matlab_name("/device/state", ()) == "device_state"
    assert matlab_name("end", ()) == "x_end"
    assert matlab_name("3d", ()) == "x_3d"
    assert matlab_name("a.b", ["a_b"]) == "a_b_2"
    long = matlab_name("n" * 80, ["n" * 63])
    assert len(long) == 63
    assert long.endswith("_2")


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mat"])
def test_lists_bytes_and_texts_are_exported(tmp_path, suffix):
    message = VariableMessage(
        "Odd",
        "Of everything.",
        (Field("a", Kind.DOUBLES, "A"), Field("b", Kind.BYTES, "B"), Field("c", Kind.TEXT, "C")),
    )
    with LogWriter(tmp_path / "odd.mcap", [Channel(40, "/odd", message)]) as writer:
        writer.add(40, 1, message.pack([1.5, 2.0], b"\x01\xff", "é,\n"))
        writer.add(40, 2, message.pack([], b"", ""))
    target = tmp_path / f"odd.{suffix}"
    export(tmp_path / "odd.mcap", target, Selection())
    if suffix == "csv":
        table = read_csv(target)
        assert (table["a"], table["b"], table["c"]) == (("[1.5, 2.0]", "[]"), ("01ff", ""), ("é,\n", ""))
    elif suffix == "parquet":
        rows = pyarrow.parquet.read_table(target).to_pylist()
        assert [(row["a"], row["b"], row["c"]) for row in rows] == [
            ([1.5, 2.0], b"\x01\xff", "é,\n"),
            ([], b"", ""),
        ]
    else:
        odd = loadmat(target, simplify_cells=True)["odd"]
        assert odd["a"][0].tolist() == [1.5, 2.0]
        assert odd["b"][0].tolist() == [1, 255]
        assert odd["c"][0] == "é,\n"


def test_what_viewers_show_is_exported_where_it_is_asked_for(tmp_path):
    from hm_driver.recording.derivation import LOG, LOG_CHANNEL, SCENE

    scene = Channel(9, "/scene", SCENE)
    with LogWriter(tmp_path / "log.mcap", [scene, LOG_CHANNEL]) as writer:
        message = SCENE.message_class()
        message.entities.add(id="arm")
        writer.add(9, 1, message.SerializeToString())
        writer.add(LOG_CHANNEL.id, 1, LOG.message_class(message="hello").SerializeToString())
    export(tmp_path / "log.mcap", tmp_path / "a.csv", Selection(topics=("/scene",)))
    assert json.loads(read_csv(tmp_path / "a.csv")["entities"][0])[0]["id"] == "arm"
    assert len(export(tmp_path / "log.mcap", tmp_path / "b.parquet", Selection())) == 2


def test_nothing_is_written_over_unless_it_is_told_to(tmp_path, log, capsys):
    (tmp_path / "a-events.csv").write_text("mine")
    words = ["log", "export", str(log), str(tmp_path / "a.csv")]
    assert run(words) == 1
    assert "a-events.csv exists already; give --force" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a-events.csv"]
    assert (tmp_path / "a-events.csv").read_text() == "mine"
    assert run([*words, "--force"]) == 0
    assert (tmp_path / "a-events.csv").read_text() != "mine"


@pytest.mark.parametrize(
    ("target", "options", "said"),
    [
        ("a.xlsx", {}, r"\.xlsx is none of \.csv, \.parquet and \.mat"),
        ("a", {}, "without a suffix"),
        ("a.csv", {"topics": ("/no",)}, "no channel /no; there are: /device/command"),
        ("a.csv", {"columns": ("forse",)}, r"no column forse; .*/device/state has sequence"),
        ("a.csv", {"start": 7.0}, r"outside of 0 to 0\.3 s"),
        ("no/a.csv", {}, "is no directory"),
    ],
)
def test_what_cannot_be_exported_is_refused_and_leaves_nothing(tmp_path, log, target, options, said):
    with pytest.raises(RecordingError, match=said):
        export(log, tmp_path / target, Selection(**options))
    assert list(tmp_path.iterdir()) == []


def test_topics_of_other_encodings_are_left_out_where_none_was_asked_for(tmp_path):
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(EVENT.full_name, "protobuf", EVENT.file_descriptor_set())
        events = writer.register_channel("/events", "protobuf", schema)
        notes = writer.register_channel("/notes", "json", 0)
        writer.add_message(notes, 1, b"{}", 1)
        writer.add_message(events, 2, EVENT.pack(0, 2, 2, "n", "t", []), 2)
        writer.finish()
    assert list(export(path, tmp_path / "a.csv", Selection()).values()) == [1]
    with pytest.raises(RecordingError, match="/notes is not protobuf but json"):
        export(path, tmp_path / "b.csv", Selection(topics=("/notes",)))
    assert run(["log", "plot", str(path), "level"]) == 0


def test_parquet_without_its_library_says_what_to_install(tmp_path, log, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(RecordingError, match=r'pip install "\.\[study\]"'):
        export(log, tmp_path / "a.parquet", Selection(topics=("/events",)))


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_frame_is_of_the_library_that_is_installed(log, truth, library):
    with hm_driver.recording.open(log) as recording:
        if importlib.util.find_spec(library) is None:
            with pytest.raises(RecordingError, match=f"pip install {library}"):
                recording.frame("/device/state", library=library)
            return
        frame = recording.frame("/device/state", 0.1, 0.2, library=library)
        assert list(frame.columns) == list(truth["/device/state"])
        assert frame["measured_force.z"].sum() == pytest.approx(300.0)
        assert list(recording.frame("/events", library=library)["text"]) == ["force 90 N"]


def test_a_frame_of_a_library_that_is_missing_or_unknown_is_refused(log, monkeypatch):
    monkeypatch.setitem(sys.modules, "polars", None)
    with hm_driver.recording.open(log) as recording:
        with pytest.raises(RecordingError, match="polars is not installed: pip install polars"):
            recording.frame("/device/state", library="polars")
        with pytest.raises(RecordingError, match="no frames of excel; there are those of pandas and polars"):
            recording.frame("/device/state", library="excel")
