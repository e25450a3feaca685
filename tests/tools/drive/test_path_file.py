import math

import pytest

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions
from tools.drive.options import MotionOptions
from tools.drive.path_file import load_path

GOOD = "time_s,x,y,z\n0,0,0,0\n1,0.02,0,0\n2,0,0,0\n"


@pytest.fixture
def load(tmp_path):
    """A function that loads a trajectory from a text."""

    def load(text, **motion):
        path = tmp_path / "path.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_path(path, ArmGeometry(), LimitOptions(), MotionOptions(**motion))

    return load


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        "# by hand\n\n" + GOOD + "\n# the end\n",
        GOOD.replace(",", " , "),
        GOOD.replace("0,0,0,0\n1", '"0",0,0,0\n1'),
        "time_s,x,y,z\n5,0,0,0\n6,0.02,0,0\n7,0,0,0\n",
        "time_s,x,y,z,vx,vy,vz\n0,0,0,0,0,0,0\n1,0.02,0,0,0,0,0\n2,0,0,0,0,0,0\n",
    ],
)
def test_what_says_the_same_is_the_same_trajectory(load, text):
    path = load(text)
    assert path.duration_s == 2.0
    assert path.at(1.0).position == pytest.approx((0.02, 0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty; its first line is time_s,x,y,z"),
        ("# nothing\n", "is empty"),
        ("time_s,x,y,z\n", "has 0 points; two are the least"),
        ("time_s,x,y,z\n0,0,0,0\n", "has 1 points"),
        ("t,x,y,z\n0,0,0,0\n1,0,0,0\n", "line 1: header: 't,x,y,z' must be time_s,x,y,z or"),
        ("0,0,0,0\n1,0,0,0\n", "line 1: header"),
        ("time_s;x;y;z\n0;0;0;0\n1;0;0;0\n", "a comma between columns, a point in numbers"),
        ("time_s,x,y,z,vx\n0,0,0,0,0\n1,0,0,0,0\n", "line 1: header"),
        (GOOD.replace("0.02", "0,02"), "line 3: columns: 5 values; the header names 4"),
        (GOOD.replace("1,0.02,0,0", "1,0.02,0"), "line 3: columns: 3 values"),
        (GOOD.replace("0.02", "abc"), "line 3: x: 'abc' is no finite number"),
        (GOOD.replace("0.02", "nan"), "line 3: x: 'nan' is no finite number"),
        (GOOD.replace("0.02", "inf"), "line 3: x"),
        (GOOD.replace("0.02", ""), "line 3: x: '' is no finite number"),
        (GOOD.replace("2,0,0,0", "1,0,0,0"), "line 4: time_s: 1 s is not after the 1 s of line 3"),
        (GOOD.replace("2,0,0,0", "0.5,0,0,0"), "line 4: time_s: 0.5 s is not after"),
        (GOOD.replace("0.02", "0.25"), "line 3: x,y,z: outside the workspace: r = 0.25 m is outside"),
        (GOOD.replace("0.02", "2e2"), "outside the workspace"),
        (
            GOOD.replace("0.02", "0.19"),
            "line 2: speed: 0.285 m/s from this line to the next; the limit is 0.25",
        ),
        ("time_s,x,y,z\n0,0,0,0\n4000,0.1,0,0\n", "line 3: time_s: 4000 s is longer than 3600 s"),
        (
            "time_s,x,y,z,vx,vy,vz\n0,0,0,0,0.1,0,0\n1,0.02,0,0,0,0,0\n",
            "line 2: vx,vy,vz: 0.1 m/s; it must begin and end at rest",
        ),
        (
            "time_s,x,y,z\n0,-0.2,-0.12,0\n9,-0.2,0.12,0\n",
            "x,y,z: the way leaves the workspace after",
        ),
        (
            "time_s,x,y,z\n0,-0.15,-0.05,0\n0.7,-0.15,0.05,0\n",
            "line 2: speed: joint phi would move at",
        ),
        (b"time_s,x,y,z\n0,0,0,\xff\n", "it is no text in UTF-8"),
    ],
)
def test_a_bad_file_is_refused_with_line_column_value_and_limit(load, text, told):
    with pytest.raises(ConfigurationError) as caught:
        load(text)
    assert told in str(caught.value)
    assert "path.csv" in str(caught.value)


def test_the_factor_that_a_fast_file_is_told_makes_it_pass(load):
    with pytest.raises(ConfigurationError, match="multiply the times by") as caught:
        load(GOOD.replace("0.02", "0.18"), speed_max=0.2)
    factor = float(str(caught.value).rsplit(" ", 1)[1])
    slower = "\n".join(
        line if number == 0 else f"{float(line.partition(',')[0]) * factor},{line.partition(',')[2]}"
        for number, line in enumerate(GOOD.replace("0.02", "0.18").strip().splitlines())
    )
    assert load(slower, speed_max=0.2).duration_s == pytest.approx(2.0 * factor)


def test_a_single_bad_point_among_many_is_found(load):
    rows = [f"{i / 1000:.3f},{0.01 if i == 1234 else 0.0},0,0" for i in range(3000)]
    with pytest.raises(ConfigurationError, match="speed") as caught:
        load("\n".join(["time_s,x,y,z", *rows]))
    assert any(f"line {line}:" in str(caught.value) for line in (1234, 1235, 1236))


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ConfigurationError, match=r"no\.csv: FILE: cannot be read: No such file"):
        load_path(tmp_path / "no.csv", ArmGeometry(), LimitOptions(), MotionOptions())


def test_a_circle_passes(load):
    rows = ["time_s,x,y,z"]
    for i in range(401):
        share = i / 400
        angle = 2 * math.pi * share**3 * (10 + share * (6 * share - 15))
        rows.append(f"{8 * share:.5f},{0.05 * math.cos(angle):.7f},{0.05 * math.sin(angle):.7f},0")
    path = load("\n".join(rows))
    assert path.at(4.0).position == pytest.approx((-0.05, 0.0, 0.0), abs=1e-6)
