"""TOML files of arms: a machine's file (see `allocator.machine_file`) with two more tables:

[bodies]                       # SI units, see `Bodies`
length = [0.31, 0.34]
…

[plant]                        # optional table; defaults are those of `Arm`
lag = 0.1                      # of the regulators [s], one or one per muscle
slew = 500000.0                # [Pa/s]
gas = true                     # motion compresses the gas in the muscles; true by default

[friction]                     # of the joints; optional table, see `mpc.model.friction.dahl`
mu = 0.02                      # [-] share of the muscles' torques; numbers are for all joints, or one each
coulomb = [0.5, 0.2]           # [N·m]
presliding = 0.0087            # [rad]

and those of the regulators, the sensors and a tuning, as in the file of a joint (`mpc.model.storage`,
`mpc.trials.tuned`).
"""

from dataclasses import fields

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import Table, section
from allocator.machine_file import described, dumps, machine_from
from allocator.mechanism import Mechanism
from allocator.mechanism.bodies import Bodies
from mpc.model.arm.model import Arm
from mpc.model.storage import numbers_in

_NUMBERS = ("lag", "slew", "gas")  # of [plant]


def save_arm(arm: Arm, path: FilePath) -> None:
    """Write an arm to `path`. Raises `InvalidInput` for bodies or routes without formulas, and `CannotWrite`."""
    write_text(path, arm_text(arm))


def arm_text(arm: Arm) -> str:
    """Return the text of an arm's file. Raises `InvalidInput` for bodies or routes without formulas."""
    if not isinstance(arm.bodies, Bodies):
        raise InvalidInput("an arm from a MuJoCo model cannot be written to a file; keep the MuJoCo model")
    lags = tuple(arm.lags.tolist())
    lag = lags[0] if len(set(lags)) == 1 else lags
    numbers: dict[str, object] = {"lag": lag, "slew": arm.slew, "gas": arm.gas is not None}
    bodies = {f.name: getattr(arm.bodies, f.name) for f in fields(Bodies)}
    lines = section("bodies", bodies, "SI units: m, kg, kg·m², N·m·s/rad, m/s²") + section("plant", numbers, "s, Pa/s")
    return dumps(arm.mechanism) + "\n".join(lines) + "\n"


def load_arm(path: FilePath) -> Arm:
    """Read an arm. Raises `InvalidFile` if the file does not contain one."""
    return arm_from(Table.read(path))


def arm_from(file: Table) -> Arm:
    """Return the arm of a file that was read. Raises `InvalidFile` if it does not contain one."""
    machine = machine_from(file)
    if not isinstance(machine, Mechanism):
        raise file.fault(f"holds {described(machine)}; expected an arm with [bodies]")
    bodies = file.needed("bodies", "an arm that can move").made(Bodies)
    numbers = numbers_in(file, _NUMBERS)
    try:
        return Arm(machine, bodies, **numbers)
    except (InvalidInput, TypeError) as error:
        raise InvalidFile(file.path, str(error)) from None
