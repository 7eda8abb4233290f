"""Export of allocation and controller to microcontrollers, as plain C99.

    from mpc.export import export
    export("joint_in_c", controller=TrackingMPC(plant, N=10), precision="single")

The code needs only math.h and no heap, and every loop is bounded. The C files of this package (in `c/`) are copied
unchanged. The others are generated: tables of constants, the model from CasADi's graph, and the allocation kernel, the
rest mode and the QP solver from the source that Python runs. The solver consists of Riccati sweeps and a dual
active-set method on the same recursions.
"""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from mpc.export.controller.tuning import write_tuning as write_tuning
    from mpc.export.entry import export as export
    from mpc.export.fmu import export_controller_fmu as export_controller_fmu
    from mpc.export.fmu import export_plant_fmu as export_plant_fmu
    from mpc.export.governor import export_governor as export_governor
    from mpc.export.mechanism import export_mechanism as export_mechanism
    from mpc.export.serial.firmware import Safety as Safety
    from mpc.export.serial.firmware import export_board as export_board
    from mpc.export.serial.simulated import SimulatedBoard as SimulatedBoard
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
