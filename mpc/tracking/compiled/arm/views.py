"""Views of an arm's records; `mpc.tracking.compiled.arm.module` copies this text for the sizes of an arm."""

from collections.abc import Callable

from allocator.calculus import Array
from mpc.codegen.views import viewer
from mpc.tracking.compiled.arm.records import ArmAlong, ArmInverse, ArmSetting, ArmTargets
from mpc.tracking.compiled.records import Given, Indices, sizes_of
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, MOVING, NU, STIFFNESSES

ARM = sizes_of(JOINTS, NU, STIFFNESSES) | {"moving": MOVING}

given_in: Callable[[Array], Given] = viewer(Given, ARM)
inverse_in: Callable[[Array], ArmInverse] = viewer(ArmInverse, ARM)
path_in: Callable[[Array], ArmAlong] = viewer(ArmAlong, ARM)
setting_in: Callable[[Array, Indices], ArmSetting] = viewer(ArmSetting, ARM)
targets_in: Callable[[Array], ArmTargets] = viewer(ArmTargets, ARM)
