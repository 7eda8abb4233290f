"""Drive a joint behind ROS 2 topics with rclpy. NOT TESTED BY US: it shows where calls go.

    python examples/bench_ros2.py     (where ROS 2 and antagonist are installed)

It subscribes /joint_states (position [rad] of the first joint) and /pressures (data: P1, P2 [Pa]), and publishes
/pressure_commands (data: P1, P2 [Pa]).
"""

import threading
import time
from math import nan

from mpc import KalmanObserver, Plant, TrackingMPC, sine
from mpc.bench import CallableDevice, Reading, RealTimeLoop


class Joint:
    """The newest message of every topic."""

    def __init__(self, node):
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        self.message = Float64MultiArray
        self.t, self.theta, self.P = 0.0, nan, (nan, nan)
        node.create_subscription(JointState, "joint_states", self.angle, 1)
        node.create_subscription(Float64MultiArray, "pressures", self.pressures, 1)
        self.commands = node.create_publisher(Float64MultiArray, "pressure_commands", 1)

    def angle(self, message):
        """Take an angle [rad], and when it came."""
        self.t, self.theta = time.monotonic(), message.position[0]

    def pressures(self, message):
        """Take the pressures [Pa]."""
        self.P = tuple(message.data)

    def read(self):
        """Return the newest angle and pressures."""
        return Reading(self.t, self.theta, self.P)  # an old time: no new angle, which the loop counts as silence

    def write(self, P1, P2):
        """Publish the commands [Pa]."""
        self.commands.publish(self.message(data=[P1, P2]))


if __name__ == "__main__":
    import rclpy

    rclpy.init()
    node = rclpy.create_node("antagonist")
    joint = Joint(node)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    plant = Plant.load("my_plant.toml")
    device = CallableDevice(joint.read, joint.write)
    print(RealTimeLoop(device, TrackingMPC(plant), KalmanObserver(plant, 0.01), sine(), log="run.csv").run().ending)
    rclpy.shutdown()
