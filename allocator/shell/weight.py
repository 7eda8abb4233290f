"""Torque that holds a machine against gravity: by its file, its MuJoCo model, or as a ready-made machine."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.shell.machine_options import MachineOptions

if TYPE_CHECKING:
    from allocator.mechanism.mechanism import Mechanism

Balance: TypeAlias = Callable[[Any], Array]
"""Torques [N·m] of the muscles that balance gravity, over angles (…) or postures (…, n) [rad]."""


def weight(options: MachineOptions) -> Balance:
    """Return the torques that balance the machine's gravity, and the springs of a MuJoCo model. Raises `InvalidFile`.

    Those of a joint are in [plant] of its file, those of several joints follow from [bodies].
    """
    from allocator.files.toml import Table
    from allocator.joint.gravity import Gravity
    from allocator.mechanism.bodies import BODIES, Bodies, check_bodies

    if options.is_mujoco:
        from allocator.mechanism.routes.mjcf import held_torque

        return held_torque(str(options.machine))
    if options.file is None:
        return BODIES[options.machine]().gravity_torque if options.machine in BODIES else np.zeros_like
    file = Table.read(options.file)
    bodies = file.table("bodies")
    if bodies is None:
        return Gravity.of_file(file).moment
    chain, mechanism = bodies.made(Bodies), cast("Mechanism", options.base)
    try:
        check_bodies(chain, mechanism)
    except InvalidInput as error:
        raise bodies.fault(error) from None
    return chain.gravity_torque


def of_gravity(held: Array) -> str:
    """Return a sentence on the torque (n,) [N·m] that balances gravity; "" if there is none."""
    row = np.atleast_1d(held)
    return f"{', '.join(f'{T:.3g}' for T in row)} N·m of the torque balance gravity" if row.any() else ""
