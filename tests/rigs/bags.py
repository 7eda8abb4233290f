"""Writers of recordings of a joint: a ROS 1 bag, a ROS 2 bag and an MCAP file of JSON.

`rows` are stamps [ns], angle [rad] and both pressures [Pa].
"""

import json

import numpy as np

TOPICS = "theta=/joint.position[0] pressure1=/valves.data[0] pressure2=/valves.data[1]"


def ros_messages(store, rows):
    make = store.types
    stamp = make["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    layout = make["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    header = make["std_msgs/msg/Header"]
    head = header(stamp=stamp, frame_id="", **({"seq": 0} if "seq" in header.__dataclass_fields__ else {}))
    for t, theta, P1, P2 in zip(*rows, strict=True):
        yield "/valves", int(t), make["std_msgs/msg/Float64MultiArray"](layout, np.array([P1, P2]))
        yield (
            "/joint",
            int(t),
            make["sensor_msgs/msg/JointState"](head, ["a"], np.array([theta]), np.zeros(0), np.zeros(0)),
        )


def write_all(writer, store, serialize, rows):
    known = {}
    for topic, time, message in ros_messages(store, rows):
        if topic not in known:
            known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
        writer.write(known[topic], time, serialize(message, message.__msgtype__))


def ros1(folder, rows):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(folder / "one.bag") as writer:
        write_all(writer, store, store.serialize_ros1, rows)
    return folder / "one.bag"


def ros2(folder, rows):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder / "two", version=9) as writer:
        write_all(writer, store, store.serialize_cdr, rows)
    return folder / "two"


def mcap(folder, rows):
    from mcap.writer import Writer

    with (folder / "three.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("j", "jsonschema", b"{}")
        joint, valves = (writer.register_channel(topic, "json", schema) for topic in ("/joint", "/valves"))
        for t, theta, P1, P2 in zip(*rows, strict=True):
            for channel, message in ((valves, {"data": [P1, P2]}), (joint, {"position": [theta]})):
                writer.add_message(channel, int(t), json.dumps(message).encode(), int(t))
        writer.finish()
    return folder / "three.mcap"
