"""Controllers on hardware: devices, the real-time loop, its safety, its log, and measured stiffness."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.bench.cycle import Overrun as Overrun
    from mpc.bench.device import CallableDevice as CallableDevice
    from mpc.bench.device import DeviceLost as DeviceLost
    from mpc.bench.device import NoAnswer as NoAnswer
    from mpc.bench.device import Reading as Reading
    from mpc.bench.device import SimulatedClock as SimulatedClock
    from mpc.bench.devices.serial_line import SerialDevice as SerialDevice
    from mpc.bench.devices.simulated import SimulatedDevice as SimulatedDevice
    from mpc.bench.loop import RealTimeLoop as RealTimeLoop
    from mpc.bench.loop import replay as replay
    from mpc.bench.measuring.due import check_due as check_due
    from mpc.bench.measuring.experiment import Tones as Tones
    from mpc.bench.measuring.log import Samples as Samples
    from mpc.bench.measuring.log import from_log as from_log
    from mpc.bench.measuring.result import Felt as Felt
    from mpc.bench.measuring.result import MeasuredStiffness as MeasuredStiffness
    from mpc.bench.measuring.result import plot_measured as plot_measured
    from mpc.bench.measuring.session import Told as Told
    from mpc.bench.measuring.session import measure as measure
    from mpc.bench.measuring.session import shake as shake
    from mpc.bench.measuring.simulation import driven as driven
    from mpc.bench.measuring.strengths import Known as Known
    from mpc.bench.measuring.update import combined as combined
    from mpc.bench.measuring.update import update as update
    from mpc.bench.measuring.weighing import Weight as Weight
    from mpc.bench.safety import SafeStop as SafeStop
    from mpc.bench.safety import SoftStart as SoftStart
    from mpc.bench.safety import Watchdog as Watchdog
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
