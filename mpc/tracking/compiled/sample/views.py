"""Views of the flat arrays of a joint's sample; `mpc.tracking.compiled.arm.module` copies this text for other sizes."""

from collections.abc import Callable

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.codegen.views import measure, viewer
from mpc.tracking import resting
from mpc.tracking.compiled.records import sizes_of
from mpc.tracking.compiled.sample.layout import Asked, Gains, Known, Made, Room, State
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, STIFFNESSES
from mpc.tracking.rest_memory import Memory

SIZES = sizes_of(JOINTS, NU, STIFFNESSES) | {"rest": resting.size(JOINTS, NU)}

asked_in: Callable[[Array], Asked] = viewer(Asked, SIZES)
gains_in: Callable[[Array], Gains] = viewer(Gains, SIZES)
known_in: Callable[[Array], Known] = viewer(Known, SIZES)
made_in: Callable[[Array], Made] = viewer(Made, SIZES)
memory_in: Callable[[Array, int, int], Memory] = inlined(resting.memory_in)
plan_length: Callable[[int], int] = measure(Made, SIZES)
room_in: Callable[[Array], Room] = viewer(Room, SIZES)
state_in: Callable[[Array, Array, int, int], State] = viewer(State, SIZES)
