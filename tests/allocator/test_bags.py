"""Recordings of robots: ROS 1, ROS 2 and MCAP with the message types that people have."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.bags import Quantity, read_topics, to_csv
from allocator.identification import read_samples

ANGLE = 0.01 * np.arange(50) - 0.2
TOPICS = "theta=/joint_states.position[1] pressure1=/one.fluid_pressure pressure2=/valves.data[0]:bar"
STEP, LATE = 10_000_000, 3_000_000  # [ns]


def messages(store):
    """Three public shapes: an array of names and numbers, a number with a header, a bare array with a layout."""
    make = store.types
    for k, theta in enumerate(ANGLE):
        stamp = make["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        seq = {"seq": k} if "seq" in make["std_msgs/msg/Header"].__dataclass_fields__ else {}
        header = make["std_msgs/msg/Header"](stamp=stamp, frame_id="", **seq)
        empty, both = np.zeros(0), np.array([7.0, theta])
        joints = make["sensor_msgs/msg/JointState"](header, ["a", "b"], both, empty, empty)
        yield "/joint_states", STEP * k + LATE, joints
        if k % 5 == 0:
            yield "/one", STEP * k, make["sensor_msgs/msg/FluidPressure"](header, 1e5 + k, 0.0)
            layout = make["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            yield "/valves", STEP * k, make["std_msgs/msg/Float64MultiArray"](layout, np.array([1.0 + k]))


def ros1(path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path / "arm.bag") as writer:
        known = {}
        for topic, time, message in messages(store):
            if topic not in known:
                known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(known[topic], time, store.serialize_ros1(message, message.__msgtype__))
    return path / "arm.bag"


def ros2(path, *, mcap=False):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(path / "arm", version=9, storage_plugin=plugin) as writer:
        known = {}
        for topic, time, message in messages(store):
            if topic not in known:
                known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(known[topic], time, store.serialize_cdr(message, message.__msgtype__))
    return next((path / "arm").glob("*.mcap")) if mcap else path / "arm"


@pytest.mark.parametrize("make", [ros1, ros2, lambda path: ros2(path, mcap=True)], ids=["ros1", "ros2", "mcap"])
def test_three_message_types_become_rows_at_the_times_of_the_first(tmp_path, make):
    found = read_topics(make(tmp_path), Quantity.parse(TOPICS))
    t, theta = found["theta"]
    np.testing.assert_allclose(theta, ANGLE)
    np.testing.assert_allclose(t, (STEP * np.arange(50) + LATE) * 1e-9)
    np.testing.assert_allclose(found["pressure2"][1], 1 + np.arange(0, 50, 5))


def test_other_topics_are_as_in_their_last_message(tmp_path):
    out = tmp_path / "log.csv"
    assert to_csv(ros1(tmp_path), Quantity.parse(TOPICS), out) == (50, 0)
    header, *rows = out.read_text().splitlines()
    assert header == "time [s],theta [rad],pressure1 [Pa],pressure2 [bar]"
    table = np.array([row.split(",") for row in rows], float)
    np.testing.assert_allclose(table[:, 3], 1 + np.arange(50) // 5 * 5)


def write_json(path, series):
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("j", "jsonschema", b"{}")
        for topic, rows in series.items():
            channel = writer.register_channel(topic, "json", schema)
            for time, message in rows:
                writer.add_message(channel, time, json.dumps(message).encode(), time)
        writer.finish()
    return path


def test_rows_without_a_recent_message_are_left_out(tmp_path):
    second = 1_000_000_000
    path = write_json(
        tmp_path / "a.mcap",
        {"/q": [(k * second // 10, {"v": k}) for k in range(60)], "/p": [(0, {"v": 1}), (4 * second, {"v": 2})]},
    )
    written, left = to_csv(path, Quantity.parse("theta=/q.v pressure1=/p.v"), tmp_path / "log.csv")
    assert (written, left) == (22, 38)  # 0 to 1.0 s and 4.0 to 5.0 s


def test_errors_name_the_topics_and_fields_that_there_are(tmp_path):
    path = write_json(tmp_path / "a.mcap", {"/q": [(0, {"v": 1})], "/p": [(0, {"w": 1})]})
    with pytest.raises(InvalidFile, match=r"topic /r is not in it; topics: /p \(j, 1\), /q \(j, 1\)"):
        read_topics(path, Quantity.parse("theta=/r.v"))
    with pytest.raises(InvalidFile, match="theta: no message has a number there; /p has w"):
        read_topics(path, Quantity.parse("theta=/p.v"))
    write_json(tmp_path / "c.mcap", {"/q": [(0, {"valves": [{"bar": 1.0}]})]})
    for field, said in (("valves[1].bar", "/q.valves has length 1"), ("valves[0].p", r"/q.valves\[0\] has bar")):
        with pytest.raises(InvalidFile, match=said):
            read_topics(tmp_path / "c.mcap", Quantity.parse(f"theta=/q.{field}"))
    with pytest.raises(InvalidInput, match=r"--topics theta: expected NAME=/topic.field\[0\]:unit"):
        Quantity.parse("theta")
    for content, said in ((b"no recording", "invalid magic"), (b"", "it ends too early")):
        (tmp_path / "b.mcap").write_bytes(content)
        with pytest.raises(InvalidFile, match=rf"is no MCAP file that can be read \(.*{said}.*`mcap recover`"):
            read_topics(tmp_path / "b.mcap", Quantity.parse("theta=/q.v"))
    (tmp_path / "none").mkdir()
    with pytest.raises(InvalidFile, match=r"is a folder without metadata\.yaml: it is no ROS 2 bag"):
        read_topics(tmp_path / "none", Quantity.parse("theta=/q.v"))
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "metadata.yaml").write_text("no: [")
    with pytest.raises(InvalidFile, match="is no ROS bag that can be read") as refusal:
        read_topics(tmp_path / "d", Quantity.parse("theta=/q.v"))
    assert "\n" not in str(refusal.value)


def test_messages_without_the_number_are_rows_without_it(tmp_path):
    rows = [(k * 10**7, {"v": None if k == 3 else k}) for k in range(5)]
    found = read_topics(write_json(tmp_path / "a.mcap", {"/q": rows}), Quantity.parse("theta=/q.v"))
    np.testing.assert_array_equal(found["theta"][1], [0, 1, 2, np.nan, 4])


def test_the_command_lists_topics_and_writes_a_log(tmp_path):
    from allocator.cli import app

    path = write_json(tmp_path / "a.mcap", {"/q": [(k * 10**7, {"v": k}) for k in range(5)]})
    listed = CliRunner().invoke(app, ["bag", str(path)])
    assert "/q: j, 5 messages" in listed.output
    out = tmp_path / "log.csv"
    wrote = CliRunner().invoke(app, ["bag", str(path), "--topics", "theta=/q.v:deg", "--out", str(out)])
    assert wrote.exit_code == 0
    assert out.read_text().splitlines()[0] == "time [s],theta [deg]"


def test_a_bag_goes_straight_into_the_readers_of_the_fits(tmp_path):
    turn = 10_000_000  # [ns]
    path = write_json(
        tmp_path / "a.mcap",
        {
            "/cell": [(k * turn, {"load": 100.0 + k}) for k in range(300)],
            "/valve": [(k * turn, {"bar": 1 + 0.01 * k, "stroke": 0.0001 * k}) for k in range(300)],
        },
    )
    topics = "force=/cell.load pressure=/valve.bar:bar shortening=/valve.stroke"
    found = read_samples(path, 0.3, topics=topics)
    np.testing.assert_allclose(found.force, 100.0 + np.arange(300))
    np.testing.assert_allclose(found.contraction, 0.0001 * np.arange(300) / 0.3)
    with pytest.raises(
        InvalidFile, match=r"--topics has to map quantities to its numbers; topics: /cell \(j, 300\), /valve"
    ):
        read_samples(path, 0.3)
    (tmp_path / "a.csv").write_text("force_N,pressure_bar,length_mm\n1,1,300\n")
    with pytest.raises(InvalidFile, match="is no recording, for which --topics is"):
        read_samples(tmp_path / "a.csv", 0.3, topics=topics)
    with pytest.raises(InvalidInput, match="a quantity is given twice"):
        read_samples(path, 0.3, topics="force=/cell.load force=/cell.load")
