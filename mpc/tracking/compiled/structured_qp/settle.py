"""Entry to the structured QP of a joint; `mpc.tracking.compiled.arm.solve` is that of an arm.

`buffer` holds the path, `given` the new data of the step (`mpc.tracking.compiled.records`). A copy of this file is
used, for the reason in `mpc.codegen.modules`.
"""

from allocator.calculus import Array
from mpc.codegen.jit import compiled
from mpc.tracking.compiled.records import Indices, Signs, given_in, path_in, setting_in
from mpc.tracking.compiled.structured_qp.solve import decide


@compiled
def settle(numbers: Array, starts: Indices, given: Array, buffer: Array, guess: Signs, z: Array) -> tuple[bool, int]:
    """Return the results of `mpc.tracking.compiled.structured_qp.solve.decide`."""
    setting, (path, u) = setting_in(numbers, starts), path_in(buffer)
    _, _, _, reference, last = given_in(given)
    return decide(path, u, setting, reference, last, guess, z)
