"""The export takes allocator and controller from Python to the microcontroller, as plain C99.

    from mpc.export import export
    export("joint_in_c", controller=TrackingMPC(plant, N=10), precision="single")

Nothing is linked but math.h, nothing allocated, every loop bounded. The C files of this package (in `c/`) are exported
as they are; beside them are written tables of constants, the model, from CasADi's graph, and the allocation kernel,
from the text that Python itself runs, as is the solver of the QP: Riccati sweeps, an active set and an interior point
on the same recursions. In single precision, which has too few digits for the last, the core of DAQP solves what the
others do not: exact after finitely many iterations, and it says when it fails. The interior point in double precision
would cost a processor whose FPU is single some millions of instructions an iteration.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpc.export.entry import export
else:

    def __getattr__(name: str) -> object:
        """`export`, loaded when it is first used: the command line begins without it."""
        if name != "export":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from mpc.export.entry import export

        return export


__all__ = ["export"]
